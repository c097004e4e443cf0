use std::path::PathBuf;
use std::process::ExitCode;

use config::{Exit, Run};
use rustix::process::{Signal, getppid, set_parent_process_death_signal};
use tracing_subscriber::EnvFilter;

use crate::StageError;

/// The environment variable that names the run's record, for stages that get no `--run`.
pub const RUN_VARIABLE: &str = "STGDAT_RUN";

/// The main function of a stage's own program: `program [--run FILE]`.
pub fn stage_main(stage: fn(&Run) -> Result<(), StageError>) -> ExitCode {
    begin_logging();
    let mut arguments = std::env::args_os().skip(1);
    let path = match (arguments.next(), arguments.next(), arguments.next()) {
        (None, ..) => std::env::var_os(RUN_VARIABLE).map(PathBuf::from),
        (Some(flag), Some(path), None) if flag == "--run" => Some(path.into()),
        _ => None,
    };
    let Some(path) = path else {
        eprintln!(
            "usage: --run FILE, or {RUN_VARIABLE}=FILE; `stgdat run` starts the stages and writes the file"
        );
        return Exit::Usage.into();
    };
    die_with_parent();
    let outcome = Run::read(&path).map_err(StageError::config).and_then(|run| stage(&run));
    match outcome {
        Ok(()) => Exit::Done.into(),
        Err(error) => {
            tracing::error!("{error}");
            error.exit().into()
        }
    }
}

/// Asks the kernel to kill this process when its parent dies, so that no stage outlives its launcher.
pub fn die_with_parent() {
    // Refused only for signals that do not exist.
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    // A parent that died before the call leaves the process to init.
    if getppid().is_none_or(|parent| parent.is_init()) {
        tracing::warn!("the launcher is gone, or this stage was started without one");
    }
}

/// Writes the process's log to standard error: warnings, or what `RUST_LOG` asks for.
pub fn begin_logging() {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    // Fails where a test or an embedding program has set one up already, which is as good.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false)
        .try_init();
}
