//! Failures of verbs: their messages and exit codes.

use std::error::Error;
use std::fmt::Display;
use std::path::Path;

use nn::WeightsError;
use ports::{LogFormat, PortError, SpaceError, StageError, priority};
use recorder::is_standard_output;
use run::{Exit, OptionError};
use rustix::io::Errno;
use rustix::process::{Resource, getrlimit};
pub use supervisor::StageDeath;
use supervisor::{Cause, cause_about};
use thiserror::Error;
use tracing::Level;

use crate::mistake::SourceError;
use crate::{color, log};

/// Why a verb failed, which determines its exit code.
#[derive(Debug, Error)]
pub enum Failure {
    /// The command line is wrong.
    #[error("{0}")]
    Usage(String),
    /// A recording, map or weights file can't be used, or an output file can't be written.
    #[error(transparent)]
    Data(Cause),
    /// pipeline.toml or the specification of a fault run can't be used.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// An option of a stage can't be used.
    #[error(transparent)]
    Option(#[from] OptionError),
    /// The configuration or the run's record can't be used.
    #[error(transparent)]
    Config(Cause),
    /// The run's files lack space or permission.
    #[error(transparent)]
    Space(#[from] SpaceError),
    /// A port can't be opened or used.
    #[error(transparent)]
    Port(#[from] PortError),
    /// Another resource of the system is missing.
    #[error(transparent)]
    Unavailable(Cause),
    /// A stage ended before the run did.
    #[error(transparent)]
    Death(#[from] StageDeath),
    /// A stage that runs in this process failed.
    #[error(transparent)]
    Stage(#[from] StageError),
    /// A check failed.
    #[error("{0}")]
    Failed(String),
}

impl Failure {
    /// A file can't be used.
    pub fn data(error: impl Into<Cause>) -> Self {
        Self::Data(error.into())
    }

    /// A file can't be used, and the error does not name the file.
    pub fn file(path: &Path, error: impl Into<Cause>) -> Self {
        Self::data_about(path.display(), error)
    }

    /// Data can't be used; `about` names the subject of the error.
    pub fn data_about(about: impl Display, error: impl Into<Cause>) -> Self {
        Self::Data(cause_about(about, error))
    }

    /// The file of `--out` can't be written.
    pub fn output(path: &Path, error: std::io::Error) -> Self {
        Self::file(if is_standard_output(path) { Path::new("standard output") } else { path }, error)
    }

    /// Weights can't be used.
    pub fn weights(path: &Path, error: WeightsError) -> Self {
        match error {
            WeightsError::Unreadable { .. } => Self::data(error),
            _ => Self::file(path, error),
        }
    }

    /// The configuration can't be used.
    pub fn config(error: impl Into<Cause>) -> Self {
        Self::Config(error.into())
    }

    /// The configuration can't be used; `about` names the subject of the error.
    pub fn config_about(about: impl Display, error: impl Into<Cause>) -> Self {
        Self::Config(cause_about(about, error))
    }

    /// A resource of the system is missing.
    pub fn unavailable(error: impl Into<Cause>) -> Self {
        Self::Unavailable(error.into())
    }

    /// A system resource is missing; `about` names the subject of the error.
    pub fn unavailable_about(about: impl Display, error: impl Into<Cause>) -> Self {
        Self::Unavailable(cause_about(about, error))
    }

    /// Returns the exit code of this failure.
    pub const fn exit(&self) -> Exit {
        match self {
            Self::Usage(_) => Exit::Usage,
            Self::Data(_) => Exit::Data,
            Self::Source(_) | Self::Option(_) | Self::Config(_) => Exit::Config,
            Self::Space(_) | Self::Port(_) | Self::Unavailable(_) => Exit::Unavailable,
            Self::Death(StageDeath {
                exit: Some(exit @ (Exit::Data | Exit::Config | Exit::Unavailable)),
                ..
            }) => *exit,
            Self::Death(_) | Self::Failed(_) => Exit::Failed,
            Self::Stage(error) => error.exit(),
        }
    }

    /// Prints the failure on standard error, whatever `RUST_LOG` selects.
    pub fn print(&self) {
        match log::format() {
            LogFormat::Text => log::write(None, &format!("{}{}\n", priority(Level::ERROR), self.message())),
            LogFormat::Json => tracing::error!("{}", self.message()),
        }
    }

    /// Returns the message. It includes the last output lines of a dead stage, and underlying errors if they
    /// add information.
    pub fn message(&self) -> String {
        let mut text = String::new();
        match self {
            Self::Source(error) => return color::report(error),
            Self::Death(death) => {
                text = format!("error: {death}");
                death.last_lines.iter().for_each(|line| text += &format!("\n  {line}"));
            }
            other => text += &format!("error: {other}"),
        }
        let mut source = self.source();
        while let Some(error) = source {
            let below = error.to_string();
            // Most errors already contain the text of the underlying error.
            if !text.contains(&below) {
                text += &format!("\n  caused by: {below}");
            }
            source = error.source();
        }
        if text.contains(&format!("(os error {})", Errno::MFILE.raw_os_error())) {
            let most = getrlimit(Resource::Nofile).current.map_or_else(String::new, |most| most.to_string());
            text +=
                &format!("\n  a process may open {most} files and sockets: raise the limit (ulimit -n 1024)");
        }
        text
    }
}

impl From<supervisor::Error> for Failure {
    fn from(error: supervisor::Error) -> Self {
        use supervisor::Error;
        match error {
            Error::Usage(text) => Self::Usage(text),
            Error::Data(cause) => Self::Data(cause),
            Error::Option(error) => Self::Option(error),
            Error::Config(cause) => Self::Config(cause),
            Error::Port(error) => Self::Port(error),
            Error::Unavailable(cause) => Self::Unavailable(cause),
            Error::Death(death) => Self::Death(death),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wire::StageId;

    #[derive(Debug, Error)]
    #[error("the checksum is wrong")]
    struct Vague(#[source] std::io::Error);

    #[test]
    fn the_errors_below_are_printed_where_they_say_more() {
        let missing = || std::io::Error::from(std::io::ErrorKind::NotFound);
        let file = Failure::file(Path::new("a.csv"), missing());
        assert_eq!(file.message(), format!("error: a.csv: {}", missing()));
        assert!(file.source().is_some(), "the source is kept");
        let vague = Failure::data(Vague(missing()));
        assert_eq!(vague.message(), format!("error: the checksum is wrong\n  caused by: {}", missing()));
    }

    #[test]
    fn a_dead_stage_ends_the_run_with_its_own_exit_code() {
        let death = |exit| StageDeath {
            stage: StageId::Decoder,
            how: "ended".to_owned(),
            exit,
            last_lines: vec!["no weights".to_owned()],
        };
        let failure = Failure::from(death(Some(Exit::Data)));
        assert_eq!(failure.exit(), Exit::Data);
        assert_eq!(failure.message(), "error: the decoder ended\n  no weights");
        // Ends other than a refusal by the stage itself.
        for exit in [None, Some(Exit::Done), Some(Exit::Interrupted)] {
            assert_eq!(Failure::from(death(exit)).exit(), Exit::Failed);
        }
    }
}
