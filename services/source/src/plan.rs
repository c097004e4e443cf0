//! Persists the time of the first tick in a file of the run, so that a restarted source resumes the same
//! schedule.

use std::path::PathBuf;

use ports::StageError;
use run::Run;

/// Name of the file in the run's directory.
const NAME: &str = "source-start";

/// The file. It holds a time on `CLOCK_MONOTONIC` as text, in nanoseconds.
#[derive(Debug)]
pub(crate) struct Plan(PathBuf);

/// The time of a run's first tick on `CLOCK_MONOTONIC`, shifted by later stalls; `None` if no tick was
/// released.
#[must_use]
pub fn start_ns(run: &Run) -> Option<u64> {
    Plan::of(run).start_ns()
}

impl Plan {
    pub fn of(run: &Run) -> Self {
        Self(run.root.join(NAME))
    }

    /// The start time that a previous source wrote; `None` if no tick was released.
    pub fn start_ns(&self) -> Option<u64> {
        std::fs::read_to_string(&self.0).ok()?.trim().parse().ok()
    }

    /// Replaces the file atomically. If the source is killed during the write, the old file remains.
    pub fn write(&self, start_ns: u64) -> Result<(), StageError> {
        let partial = self.0.with_extension("partial");
        let written = std::fs::write(&partial, start_ns.to_string());
        written
            .and_then(|()| std::fs::rename(&partial, &self.0))
            .map_err(|source| StageError::File { path: self.0.clone(), source })
    }
}
