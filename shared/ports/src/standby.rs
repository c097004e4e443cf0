//! Taking over from a running process: a stage is replaced between two ticks.
//!
//! 1. The new process starts while the old one runs. It loads its data, opens its inputs, and sends `ready`
//!    on the launcher's socket.
//! 2. The launcher ends the old process, waits until its places on the topics are free, and answers `go`.
//! 3. The new process opens its output. It reads the newest tick of the old process from that output and
//!    continues after it. The ticks that the old process left unfinished are in the new process's own queues.
//!
//! A *spare* is a new process whose turn comes when the old one dies. While it waits, for any time, it
//! follows the old process's output. A stage that takes its state from there keeps that state current and
//! computes nothing.

use std::io::{BufRead as _, BufReader, ErrorKind, Write as _};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use wire::StageId;

use crate::{PortError, Stop};

/// The environment variable with the launcher's socket, set for a process that replaces a running one.
///
/// A program that does not use [`Stage`](crate::Stage) must do the same itself: when it is warm it connects,
/// writes the line `ready STAGE INCARNATION`, and opens its outputs after the line `go` has arrived.
pub const STANDBY_VARIABLE: &str = "STGDAT_STANDBY";

/// The line that the launcher sends to a process when its turn comes.
pub const GO: &str = "go";

/// Interval between checks whether the process was asked to end.
const LOOK: Duration = Duration::from_millis(100);

/// Whether this process has had its turn.
static HAD_TURN: AtomicBool = AtomicBool::new(false);

/// Whether this process replaces a running one, and has not had its turn.
pub(crate) fn is_standby() -> bool {
    !HAD_TURN.load(Relaxed) && std::env::var_os(STANDBY_VARIABLE).is_some()
}

/// Waits, in a process that replaces a running one, until that one has ended. Returns at once in any other
/// process, and after the first call.
///
/// [`Stage::publish`](crate::Stage::publish) calls this function. A stage calls it itself if it has no
/// output, or if it reads data that the old process leaves at its end.
///
/// # Errors
/// [`PortError::Node`] if the launcher has ended, [`PortError::NotNeeded`] if the process is asked to end
/// before its turn.
pub fn await_turn(stage: StageId, stop: &Stop) -> Result<(), PortError> {
    await_turn_and(stage, stop, || Ok(()))
}

/// As [`await_turn`], and calls `meanwhile` at least ten times a second.
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
