use std::error::Error as StdError;
use std::fmt::Display;

use ports::PortError;
use run::{Exit, OptionError};
use thiserror::Error;
use wire::StageId;

/// The underlying error, from any crate.
pub type Cause = Box<dyn StdError + Send + Sync>;

/// Why a run can't be supervised.
#[derive(Debug, Error)]
pub enum Error {
    /// An order can't be used.
    #[error("{0}")]
    Usage(String),
    /// An answer can't be read or written.
    #[error(transparent)]
    Data(Cause),
    /// An option of a stage can't be used.
    #[error(transparent)]
    Option(#[from] OptionError),
    /// The program of a stage can't be used.
    #[error(transparent)]
    Config(Cause),
    /// A port can't be opened or used.
    #[error(transparent)]
    Port(#[from] PortError),
    /// Another resource of the system is missing.
    #[error(transparent)]
    Unavailable(Cause),
    /// A stage ended before the run did.
    #[error(transparent)]
    Death(#[from] StageDeath),
}

/// A stage that ended before the run did.
#[derive(Debug, Error)]
#[error("the {} {how}", stage.name())]
pub struct StageDeath {
    /// The stage.
    pub stage: StageId,
    /// How the stage ended, phrased to follow its name.
    pub how: String,
    /// Exit code, if [`Exit`] has it.
    pub exit: Option<Exit>,
    /// The last lines of the stage's output.
    pub last_lines: Vec<String>,
}

impl StageDeath {
    /// Describes how the stage ended, with the last line of its output.
    pub fn how_and_why(&self) -> String {
        let last = self.last_lines.last().map(|line| line.trim_start_matches("error: "));
        last.map_or_else(|| self.how.clone(), |why| format!("{}: {why}", self.how))
    }
}

/// An error with its subject, such as the path of a file.
#[derive(Debug, Error)]
#[error("{about}: {source}")]
struct About {
    about: String,
    source: Cause,
}

/// Returns an error with its subject.
pub fn cause_about(about: impl Display, source: impl Into<Cause>) -> Cause {
    About { about: about.to_string(), source: source.into() }.into()
}

impl Error {
    pub(crate) fn data(error: impl Into<Cause>) -> Self {
        Self::Data(error.into())
    }

    pub(crate) fn config(error: impl Into<Cause>) -> Self {
        Self::Config(error.into())
    }

    pub(crate) fn config_about(about: impl Display, error: impl Into<Cause>) -> Self {
        Self::Config(cause_about(about, error))
    }

    pub(crate) fn unavailable(error: impl Into<Cause>) -> Self {
        Self::Unavailable(error.into())
    }

    pub(crate) fn unavailable_about(about: impl Display, error: impl Into<Cause>) -> Self {
        Self::Unavailable(cause_about(about, error))
    }
}
