use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use run::{Exit, Run};
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

use crate::{LogFormat, StageError, begin_logging, choose_run, escaped, living_runs};

/// The environment variable that names the run's record, for programs without `--run`.
pub const RUN_VARIABLE: &str = "STGDAT_RUN";

/// Name of the record in a run's folder.
pub const RECORD: &str = "run";

/// The environment variable that holds the launcher's process number.
pub const LAUNCHER_VARIABLE: &str = "STGDAT_LAUNCHER";
/// Environment variable that keeps a stage from locking its memory.
pub const UNLOCKED_VARIABLE: &str = "STGDAT_UNLOCKED";

/// The environment variable with the stage's number of earlier starts; 0 if it is not set.
pub const INCARNATION_VARIABLE: &str = "STGDAT_INCARNATION";

/// The stage's number of earlier starts, as the launcher has set it.
#[must_use]
pub fn incarnation() -> u32 {
    std::env::var(INCARNATION_VARIABLE).ok().and_then(|number| number.parse().ok()).unwrap_or(0)
}

/// The main function of a program that joins a run: `program [--run RUN]`. `RUN` is the name or folder of a run,
/// or its record. Without it, [`RUN_VARIABLE`] names the run: the launcher sets it for stages. If the variable is
/// not set either, the program joins the only running pipeline of this user.
pub fn stage_main(stage: fn(&Run) -> Result<(), StageError>) -> ExitCode {
    begin_logging(LogFormat::of_environment());
    let mut arguments = std::env::args_os().skip(1);
    let named = match (arguments.next(), arguments.next(), arguments.next()) {
        (None, ..) => std::env::var_os(RUN_VARIABLE).map(PathBuf::from),
        (Some(flag), Some(run), None) if flag == "--run" => Some(run.into()),
        _ => return refuse("usage: [--run RUN], the name, folder or record of a run"),
    };
    let path = match record_of(named) {
        Ok(path) => path,
        Err(text) => return refuse(&text),
    };
    let run = || Run::read(&path).map_err(StageError::config);
    let outcome = die_with_launcher().and_then(|()| stage(&run()?));
    match outcome {
        Ok(()) => Exit::Done.into(),
        Err(error) => {
            tracing::error!("{error}");
            error.exit().into()
        }
    }
}

/// The record of the named run; without a name, of the only running pipeline.
fn record_of(named: Option<PathBuf>) -> Result<PathBuf, String> {
    match named {
        Some(path) if path.is_file() => Ok(path),
        named => {
            let runs = living_runs().map_err(|error| error.to_string())?;
            Ok(choose_run(runs, named.as_deref(), |run| run.name.clone())?.root.join(RECORD))
        }
    }
}

/// Prints why the program can't start.
fn refuse(text: &str) -> ExitCode {
    // Standard error may have no reader.
    let _ = writeln!(std::io::stderr(), "{}", escaped(text, false));
    Exit::Usage.into()
}

/// Asks the kernel to kill this process when its launcher dies, so that no stage outlives it.
///
/// # Errors
/// [`StageError::LauncherGone`] if the launcher has died already.
pub fn die_with_launcher() -> Result<(), StageError> {
    let launcher = std::env::var(LAUNCHER_VARIABLE).ok().and_then(|pid| Pid::from_raw(pid.parse().ok()?));
    if launcher.is_none() {
        return Ok(());
    }
    // Fails only for signals that do not exist.
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    if getppid() == launcher { Ok(()) } else { Err(StageError::LauncherGone) }
}
