use std::fmt::Write as _;
use std::path::Path;

use config::PipelineError;
use miette::GraphicalReportHandler;
use nn::WeightsError;
use onboard::ChainError;
use ports::{PortError, SpaceError, StageError};
use recorder::is_standard_output;
use run::{Exit, OptionError};
use thiserror::Error;
use wire::StageId;

/// Why a verb did not do what was asked, and with which exit code it ends.
#[derive(Debug, Error)]
pub enum Failure {
    /// The command line asks for what can't be.
    #[error("{0}")]
    Usage(String),
    /// A recording, map or weights file can't be used.
    #[error("{0}")]
    Data(String),
    /// pipeline.toml can't be used.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A setting or the run's record can't be used.
    #[error("{0}")]
    Config(String),
    /// There is no room or no right for the run's files.
    #[error(transparent)]
    Space(#[from] SpaceError),
    /// A port or something else of the system is missing.
    #[error("{0}")]
    Unavailable(String),
    /// A stage ended by itself.
    #[error(transparent)]
    Stage(#[from] StageDeath),
    /// Something was checked and is not as it should be.
    #[error("{0}")]
    Failed(String),
}

/// A stage that ended before the run did.
#[derive(Debug, Error)]
#[error("the {} {how}", stage.name())]
pub struct StageDeath {
    /// The stage.
    pub stage: StageId,
    /// How it ended, to follow its name.
    pub how: String,
    /// Its exit code, where it is one of [`Exit`].
    pub exit: Option<Exit>,
    /// The last lines that it wrote to standard error.
    pub last_words: Vec<String>,
}

impl Failure {
    /// A file can't be used.
    pub fn data(error: impl std::fmt::Display) -> Self {
        Self::Data(error.to_string())
    }

    /// A file can't be read or written.
    pub fn file(path: &Path, error: &std::io::Error) -> Self {
        Self::Data(format!("{}: {error}", path.display()))
    }

    /// What `--out` names can't be written.
    pub fn output(path: &Path, error: &std::io::Error) -> Self {
        Self::file(if is_standard_output(path) { Path::new("standard output") } else { path }, error)
    }

    /// Weights can't be used.
    pub fn weights(path: &Path, error: &WeightsError) -> Self {
        match error {
            WeightsError::Unreadable { .. } => Self::data(error),
            _ => Self::Data(format!("{}: {error}", path.display())),
        }
    }

    /// The exit code that stands for it.
    pub fn exit(&self) -> Exit {
        match self {
            Self::Usage(_) => Exit::Usage,
            Self::Data(_) => Exit::Data,
            Self::Pipeline(_) | Self::Config(_) => Exit::Config,
            Self::Space(_) | Self::Unavailable(_) => Exit::Unavailable,
            Self::Stage(StageDeath {
                exit: Some(exit @ (Exit::Data | Exit::Config | Exit::Unavailable)),
                ..
            }) => *exit,
            Self::Stage(_) | Self::Failed(_) => Exit::Failed,
        }
    }

    /// Tells it on standard error.
    pub fn tell(&self) {
        let mut text = String::new();
        // Writing to a string does not fail.
        let _ = match self {
            Self::Pipeline(error) => GraphicalReportHandler::new().render_report(&mut text, error),
            Self::Stage(death) => {
                let words: String =
                    death.last_words.iter().fold(String::new(), |all, line| all + "\n  " + line);
                write!(text, "error: {death}{words}")
            }
            other => write!(text, "error: {other}"),
        };
        eprintln!("{text}");
    }
}

impl From<PortError> for Failure {
    fn from(error: PortError) -> Self {
        Self::Unavailable(error.to_string())
    }
}

impl From<OptionError> for Failure {
    fn from(error: OptionError) -> Self {
        Self::Config(error.to_string())
    }
}

impl From<ChainError> for Failure {
    fn from(error: ChainError) -> Self {
        match error {
            ChainError::Weights(error) => Self::data(error),
            ChainError::Start(error) => Self::data(error),
            ChainError::Options(error) => error.into(),
            ChainError::Stage(error) => error.into(),
        }
    }
}

impl From<StageError> for Failure {
    fn from(error: StageError) -> Self {
        match error.exit() {
            Exit::Data => Self::Data(error.to_string()),
            Exit::Config => Self::Config(error.to_string()),
            Exit::Unavailable => Self::Unavailable(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}
