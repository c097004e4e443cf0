//! Saves the learned state of a run for later runs, every minute and at the end.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use console::failure::Failure;
use recorder::WholeFile;
use run::Run;

use crate::files::within;

/// The environment variable in which systemd names the folder of `StateDirectory=`.
const FOLDER_VARIABLE: &str = "STATE_DIRECTORY";
/// Name of the file in this folder.
const FILE: &str = "learned-state";
/// Interval between two saves. A loss of power costs at most this time of learning.
const INTERVAL: Duration = Duration::from_mins(1);
/// Lowers the priority of the thread that saves.
const NICE: i32 = 10;

/// The file in the service's folder of state; `None` if systemd names no folder.
pub fn file_of_service() -> Option<PathBuf> {
    let folders = std::env::var(FOLDER_VARIABLE).ok()?;
    let first = folders.split(':').next().filter(|first| !first.is_empty())?;
    Some(Path::new(first).join(FILE))
}

/// Saves the learned state of a run in a thread of its own.
#[derive(Debug)]
pub struct SavedState {
    run: Run,
    path: PathBuf,
    weights_sha256: String,
    /// Ends the thread if it is dropped.
    end: SyncSender<()>,
}

impl SavedState {
    /// Starts the thread.
    ///
    /// # Errors
    /// [`Failure::Unavailable`] if the thread can't be started.
    pub fn start(run: &Run, path: PathBuf, weights_sha256: String) -> Result<Self, Failure> {
        let (end, ended) = sync_channel(0);
        let saver = Self { run: run.clone(), path, weights_sha256, end };
        let (run, path, sha256) = (run.clone(), saver.path.clone(), saver.weights_sha256.clone());
        let work = move || {
            // On Linux this changes the thread alone.
            let _ = rustix::process::nice(NICE);
            let mut last = None;
            while ended.recv_timeout(INTERVAL) == Err(RecvTimeoutError::Timeout) {
                let why = save(&run, &path, &sha256).err();
                if let Some(why) = why.as_ref().filter(|why| last.as_ref() != Some(*why)) {
                    tracing::warn!(target: "launcher", "the learned state can't be saved: {why}");
                }
                last = why;
            }
        };
        std::thread::Builder::new().name("state".to_owned()).spawn(work).map_err(Failure::unavailable)?;
        Ok(saver)
    }

    /// Saves the state at the end of the run, once its stages have ended. Waits for the disk for at most ten
    /// seconds.
    ///
    /// # Errors
    /// [`Failure::Data`] if the file can't be written.
    pub fn end(self) -> Result<(), Failure> {
        let Self { run, path, weights_sha256, end } = self;
        drop(end);
        let file = path.clone();
        within(&path, move || save(&run, &file, &weights_sha256).map_err(Failure::data))
    }
}

/// Replaces the file as a whole. A run that has learned nothing leaves it unchanged.
fn save(run: &Run, path: &Path, weights_sha256: &str) -> Result<(), String> {
    let Some(state) = sampler::state::snapshot(run, weights_sha256)? else { return Ok(()) };
    let write = || {
        let mut file = WholeFile::create(path)?;
        file.write_all(&state)?;
        file.finish()
    };
    write().map_err(|error: std::io::Error| format!("{}: {error}", path.display()))
}
