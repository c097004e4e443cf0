//! Taking over from a process that still runs: a stage is replaced between two ticks.
//!
//! The new process starts beside the old one, loads what it needs, opens its inputs, and says so on the
//! launcher's socket. The launcher ends the old process, waits until its place on its topics is free, and
//! answers; only then the new one opens its output. It goes on after the newest tick that the old one has sent,
//! which it reads off that output: what the old one left undone lies in its own queues.
//!
//! A *spare* is such a process whose turn comes when the old one dies. While it waits, however long, it follows
//! that output: a stage that takes its state from there keeps it so at hand, and computes nothing.

use std::io::{BufRead as _, BufReader, ErrorKind, Write as _};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use wire::StageId;

use crate::{PortError, Stop};

/// The environment variable with the launcher's socket, set for a process that is to replace one that still runs.
///
/// A program that does not use [`Stage`](crate::Stage) does by itself what that does: once it is warm it
/// connects, writes the line `ready STAGE INCARNATION`, and opens its outputs when the line `go` has come.
pub const STANDBY_VARIABLE: &str = "STGDAT_STANDBY";

/// The line that the launcher sends to a process whose turn it is.
pub const GO: &str = "go";

/// Interval between looks whether the process was asked to end.
const LOOK: Duration = Duration::from_millis(100);

/// Whether this process has had its turn.
static HAD_TURN: AtomicBool = AtomicBool::new(false);

/// Whether this process is to replace one that still runs, and has not had its turn.
pub(crate) fn is_standby() -> bool {
    !HAD_TURN.load(Relaxed) && std::env::var_os(STANDBY_VARIABLE).is_some()
}

/// Waits, in a process that is to replace one that still runs, until that one has ended; returns at once in any
/// other, and after the first time.
///
/// [`Stage::publish`](crate::Stage::publish) does so by itself. A stage calls it where it has no output, or reads
/// what the old process leaves at its end.
///
/// # Errors
/// [`PortError::Node`] if the launcher is gone, [`PortError::NotNeeded`] if the process is asked to end
/// before its turn.
pub fn await_turn(stage: StageId, stop: &Stop) -> Result<(), PortError> {
    await_turn_and(stage, stop, || Ok(()))
}

/// The same, and does `meanwhile` at least ten times a second.
pub(crate) fn await_turn_and(
    stage: StageId,
    stop: &Stop,
    mut meanwhile: impl FnMut() -> Result<(), PortError>,
) -> Result<(), PortError> {
    if !is_standby() {
        return Ok(());
    }
    let path = PathBuf::from(std::env::var_os(STANDBY_VARIABLE).unwrap_or_default());
    let failed = |error: std::io::Error| PortError::of_node("taking over from the process before")(error);
    let mut launcher = UnixStream::connect(path).map_err(failed)?;
    launcher.set_read_timeout(Some(LOOK)).map_err(failed)?;
    writeln!(launcher, "ready {} {}", stage.name(), crate::incarnation()).map_err(failed)?;
    let mut answer = String::new();
    let mut lines = BufReader::new(launcher);
    loop {
        if stop.requested() {
            return Err(PortError::NotNeeded);
        }
        meanwhile()?;
        match lines.read_line(&mut answer) {
            Ok(_) if answer.trim_end() == GO => break,
            Ok(_) => return Err(failed(ErrorKind::UnexpectedEof.into())),
            Err(error) => match error.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => {}
                _ => return Err(failed(error)),
            },
        }
    }
    HAD_TURN.store(true, Relaxed);
    Ok(())
}
