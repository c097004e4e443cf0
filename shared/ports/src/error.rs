use run::{Exit, OptionError};
use thiserror::Error;
use wire::Rejected;

/// A port or the transport under it is broken: the process can't go on.
#[derive(Debug, Error)]
#[error("{what} of topic \"{topic}\": {reason}")]
pub struct PortError {
    /// What was tried.
    pub what: &'static str,
    /// The topic.
    pub topic: &'static str,
    /// What the transport says.
    pub reason: String,
}

impl PortError {
    /// Turns an error of the transport into one that names the topic.
    pub(crate) fn of<E: std::fmt::Debug>(what: &'static str, topic: &'static str) -> impl FnOnce(E) -> Self {
        move |error| Self { what, topic, reason: format!("{error:?}") }
    }
}

/// Why a stage ends before it is told to.
#[derive(Debug, Error)]
pub enum StageError {
    /// A port or the transport under it is broken.
    #[error(transparent)]
    Port(#[from] PortError),
    /// A recording, map or weights file can't be used.
    #[error("{0}")]
    Data(String),
    /// The run's record or a setting can't be used.
    #[error("{0}")]
    Config(String),
    /// Another stage does not answer, or the launcher is gone.
    #[error("{0}")]
    Stuck(String),
}

impl StageError {
    /// A recording, map or weights file can't be used.
    pub fn data(error: impl std::fmt::Display) -> Self {
        Self::Data(error.to_string())
    }

    /// The run's record or a setting can't be used.
    pub fn config(error: impl std::fmt::Display) -> Self {
        Self::Config(error.to_string())
    }

    /// The exit code that tells the launcher what kind of failure it was.
    #[must_use]
    pub const fn exit(&self) -> Exit {
        match self {
            Self::Port(_) => Exit::Unavailable,
            Self::Data(_) => Exit::Data,
            Self::Config(_) => Exit::Config,
            Self::Stuck(_) => Exit::Failed,
        }
    }
}

impl From<OptionError> for StageError {
    fn from(error: OptionError) -> Self {
        Self::config(error)
    }
}

/// Tells of a frame that was refused; nobody else will.
pub(crate) fn log_refused(topic: &'static str, seq: u64, why: &Rejected) {
    tracing::warn!(topic, seq, "frame refused: {why}");
}
