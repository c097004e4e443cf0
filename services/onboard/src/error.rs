use nn::{StartError, WeightsError};
use ports::StageError;
use run::OptionError;
use thiserror::Error;

/// Why the stages can't be set up in one process.
#[derive(Debug, Error)]
pub enum ChainError {
    /// The weights do not hold the model.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// A stage that runs the network on workers can't start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// A stage's options can't be used.
    #[error(transparent)]
    Options(#[from] OptionError),
    /// A stage's map or retrieval memory can't be used.
    #[error(transparent)]
    Stage(#[from] StageError),
}

impl From<ChainError> for StageError {
    fn from(error: ChainError) -> Self {
        match error {
            ChainError::Weights(error) => Self::data(error),
            ChainError::Start(error @ StartError::Precision(_)) => Self::config(error),
            ChainError::Start(error) => Self::data(error),
            ChainError::Options(error) => error.into(),
            ChainError::Stage(error) => error,
        }
    }
}
