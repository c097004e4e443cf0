//! The bridge to ROS 2 as a program: a stage of pipeline.toml, or `stgdat ros2`.

use std::error::Error;
use std::io::Write as _;
use std::process::ExitCode;

use clap::Parser as _;
use ports::{LogFormat, Stop};
use ros2::command::Arguments;
use run::Exit;
use wire::StageId;

/// The events of the log unless `RUST_LOG` selects others.
const EVENTS: &str = "warn,ros2=info";

fn main() -> ExitCode {
    match std::env::var(run::STAGE_VARIABLE) {
        Ok(stage) if stage == StageId::Source.name() => ports::stage_main(ros2::source::run),
        Ok(_) => ports::stage_main(ros2::publish::run),
        Err(_) => follow(&Arguments::parse()),
    }
}

/// Publishes a running pipeline.
fn follow(arguments: &Arguments) -> ExitCode {
    ports::begin_command_logging(LogFormat::of_environment(), EVENTS, std::io::stderr);
    let publish = || -> Result<(), Box<dyn Error>> {
        let stop = Stop::on_signals()?;
        let runs = ports::living_runs()?;
        let run = ports::choose_run(runs, arguments.run.as_deref(), |run| run.name.clone())?;
        Ok(ros2::publish::follow(&run.root, &arguments.options, &stop)?)
    };
    match publish() {
        Ok(()) => Exit::Done.into(),
        Err(error) => {
            // Standard error may have no reader.
            let _ = writeln!(std::io::stderr(), "error: {}", ports::escaped(&error.to_string(), false));
            Exit::Unavailable.into()
        }
    }
}
