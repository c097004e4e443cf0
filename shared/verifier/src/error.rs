use std::error::Error;
use std::path::Path;

use nn::WeightsError;
use thiserror::Error;

/// Why a folder cannot be verified.
#[derive(Debug, Error)]
pub enum VerifyError {
    /// A file can't be read.
    #[error("{path}: {source}")]
    Unreadable {
        /// The file.
        path: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// A file does not have the form that its name requires.
    #[error("{path}: {reason}")]
    Malformed {
        /// The file.
        path: String,
        /// The reason.
        reason: String,
        /// The underlying error, if there is one. `reason` contains its text.
        source: Option<Box<dyn Error + Send + Sync>>,
    },
    /// The weights can't be used.
    #[error("{path}: {source}")]
    Weights {
        /// The file.
        path: String,
        /// The reason.
        source: WeightsError,
    },
    /// The folder has neither form.
    #[error(
        "{path}: there are no golden vectors: neither {files} of a model nor a folder {folders} of tracking"
    )]
    NoVectors {
        /// The folder.
        path: String,
        /// The files of a model.
        files: String,
        /// The folders of tracking.
        folders: String,
    },
}

impl VerifyError {
    pub(crate) fn unreadable(path: &Path, source: std::io::Error) -> Self {
        Self::Unreadable { path: path.display().to_string(), source }
    }

    pub(crate) fn malformed(path: &Path, reason: impl Into<String>) -> Self {
        Self::Malformed { path: path.display().to_string(), reason: reason.into(), source: None }
    }

    /// A malformed file that `source` refuses. `context` precedes the text of `source`.
    pub(crate) fn caused(path: &Path, context: &str, source: impl Error + Send + Sync + 'static) -> Self {
        let reason = if context.is_empty() { source.to_string() } else { format!("{context}: {source}") };
        Self::Malformed { path: path.display().to_string(), reason, source: Some(Box::new(source)) }
    }
}
