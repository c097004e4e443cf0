//! The bridge between two boxes as a program: a stage of pipeline.toml, or `stgdat bridge`.

use std::error::Error;
use std::io::Write as _;
use std::process::ExitCode;
use std::time::Duration;

use bridge::command::{Arguments, Verb};
use bridge::lines::line;
use bridge::play::{Scene, play};
use bridge::receiver::{Link, Receiver};
use clap::Parser as _;
use ports::{LogFormat, Stop};
use run::Exit;
use wire::StageId;

/// The events of the log unless `RUST_LOG` selects others.
const EVENTS: &str = "warn,bridge=info";
/// Frames that wait to be printed.
const INBOX_MAX: usize = 2;
/// Longest wait for a frame.
const WAIT: Duration = Duration::from_millis(100);

fn main() -> ExitCode {
    match std::env::var(run::STAGE_VARIABLE) {
        Ok(stage) if stage == StageId::Source.name() => ports::stage_main(bridge::source::run),
        Ok(_) => ports::stage_main(bridge::publish::run),
        Err(_) => command(&Arguments::parse()),
    }
}

fn command(arguments: &Arguments) -> ExitCode {
    ports::begin_command_logging(LogFormat::of_environment(), EVENTS, std::io::stderr);
    match execute(&arguments.verb) {
        Ok(()) => Exit::Done.into(),
        Err(error) => {
            // Standard error may have no reader.
            let _ = writeln!(std::io::stderr(), "error: {}", ports::escaped(&error.to_string(), false));
            Exit::Unavailable.into()
        }
    }
}

fn execute(verb: &Verb) -> Result<(), Box<dyn Error>> {
    let stop = Stop::on_signals()?;
    match verb {
        Verb::Send { address, run, modes, protection } => {
            let runs = ports::living_runs()?;
            let run = ports::choose_run(runs, run.as_deref(), |run| run.name.clone())?;
            Ok(bridge::publish::follow(&run.root, address, protection, *modes, &stop)?)
        }
        Verb::Receive { address, content, frames, protection, ages } => {
            print(protection.link(address.clone(), (*content).into(), ages)?, *frames, &stop)
        }
        Verb::Play { address, recording, agents, ticks, origin, protection } => {
            let (recording, agents, ticks, origin) = (recording.clone(), *agents, *ticks, *origin);
            Ok(play(&Scene { recording, agents, ticks, origin }, address, protection, &stop)?)
        }
    }
}

/// Prints frames until there were `frames_max`, nobody reads them, or `stop` is requested.
fn print(link: Link, frames_max: Option<u64>, stop: &Stop) -> Result<(), Box<dyn Error>> {
    let receiver = Receiver::start(link, INBOX_MAX)?;
    let mut output = std::io::stdout().lock();
    let mut printed = 0;
    while !stop.requested() && frames_max.is_none_or(|most| printed < most) {
        for received in receiver.take(WAIT) {
            if writeln!(output, "{}", line(&received)).and_then(|()| output.flush()).is_err() {
                return Ok(());
            }
            printed += 1;
            if frames_max == Some(printed) {
                break;
            }
        }
    }
    tracing::info!("{}; {} dropped before they were printed", receiver.counts(), receiver.dropped());
    Ok(())
}
