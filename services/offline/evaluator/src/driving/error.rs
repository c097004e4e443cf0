use std::path::PathBuf;

use data::ReadError;
use nn::WeightsError;
use ports::StageError;
use run::OptionError;

/// Why the evaluation fails.
#[derive(Debug, thiserror::Error)]
pub enum DrivingError {
    /// A folder can't be listed.
    #[error("{path}: {source}")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// No source has this name.
    #[error("{name}: no such source; there are {known}")]
    UnknownSource {
        /// The name that was given.
        name: String,
        /// Names of the known sources.
        known: String,
    },
    /// A recording can't be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Weights can't be used.
    #[error("{path}: {source}")]
    Weights {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: WeightsError,
    },
    /// A bag's forecasts can't be compared with ours.
    #[error("{0}")]
    Against(String),
    /// The stages can't be set up.
    #[error(transparent)]
    Stages(#[from] StageError),
    /// The stages' options can't be recorded.
    #[error(transparent)]
    Run(#[from] OptionError),
}
