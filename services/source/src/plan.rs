//! When the first tick went out, in a file of the run: a source that is restarted goes on by it.

use std::path::PathBuf;

use ports::StageError;
use run::Run;

/// Name of the file in the run's directory.
const NAME: &str = "source-start";

/// The file, which holds a number of nanoseconds on `CLOCK_MONOTONIC` as text.
#[derive(Debug)]
pub(crate) struct Plan(PathBuf);

impl Plan {
    pub fn of(run: &Run) -> Self {
        Self(run.root.join(NAME))
    }

    /// What the source before has written, if it has released a tick.
    pub fn start_ns(&self) -> Option<u64> {
        std::fs::read_to_string(&self.0).ok()?.trim().parse().ok()
    }

    /// Replaces the file as a whole: a source that is killed meanwhile leaves the old one.
    pub fn write(&self, start_ns: u64) -> Result<(), StageError> {
        let partial = self.0.with_extension("partial");
        let written = std::fs::write(&partial, start_ns.to_string());
        written
            .and_then(|()| std::fs::rename(&partial, &self.0))
            .map_err(|source| StageError::File { path: self.0.clone(), source })
    }
}
