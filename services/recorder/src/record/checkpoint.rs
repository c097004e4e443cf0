//! The data with which a recorder continues after a previous one has died.
//!
//! The stage writes it once a second, so a death loses at most one second of the report. Forecasts that wait
//! for their truth are omitted because they are large. They count as uncovered.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{Recorder, RecorderOptions, Sums};
use crate::accuracy::ScorerCheckpoint;
use crate::report::ReportError;

/// The state of a [`Recorder`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Checkpoint {
    sums: Sums,
    scorer: ScorerCheckpoint,
}

impl Checkpoint {
    /// Writes it as JSON. The file is written atomically.
    ///
    /// # Errors
    /// [`ReportError::File`] with the path.
    pub fn write(&self, path: &Path) -> Result<(), ReportError> {
        let file = |source| ReportError::File { path: path.display().to_string(), source };
        let json = serde_json::to_vec(self).map_err(|error| file(error.into()))?;
        crate::whole_file::write_state(path, &json).map_err(file)
    }

    /// Reads the result of [`Checkpoint::write`].
    ///
    /// # Errors
    /// [`ReportError`] if the file cannot be read or has other content.
    pub fn read(path: &Path) -> Result<Self, ReportError> {
        let shown = || path.display().to_string();
        let json = std::fs::read(path).map_err(|source| ReportError::File { path: shown(), source })?;
        serde_json::from_slice(&json).map_err(|source| ReportError::Format { path: shown(), source })
    }
}

impl Recorder {
    /// All sums so far.
    #[must_use]
    pub fn checkpoint(&self) -> Checkpoint {
        Checkpoint { sums: self.sums.clone(), scorer: self.scorer.checkpoint() }
    }

    /// A recorder that continues from the counts of one that died. Ticks before the first one that it
    /// receives are counted as not recorded.
    #[must_use]
    pub fn resume(options: RecorderOptions, kept: Checkpoint) -> Self {
        let Checkpoint { sums, scorer } = kept;
        let worst = sums.worst.with_room();
        let arrivals = sums.arrivals.with_limit(options.silence_ns);
        Self {
            sums: Sums { worst, arrivals, ..sums },
            scorer: scorer.into(),
            resumed: true,
            ..Self::new(options)
        }
    }
}
