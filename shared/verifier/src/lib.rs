//! Recomputes golden vectors with the code that runs on board. `stgdat verify FOLDER` calls it.
//!
//! The input is a folder of golden vectors: inputs, and the results of an independent implementation. The
//! output is one [`Comparison`] per vector. A folder has one of two forms, recognised by its files: the
//! tensors of a `model`, or the numbers of `tracking`.

mod comparison;
mod model;
mod tracking;

use std::error::Error;
use std::path::Path;

use nn::WeightsError;
use thiserror::Error;

pub use comparison::Comparison;

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
        "{path}: there are no golden vectors: neither {} of a model nor a folder {} of tracking",
        model::FILES.join(", "), tracking::PARTS.join(", ")
    )]
    NoVectors {
        /// The folder.
        path: String,
    },
}

impl VerifyError {
    fn unreadable(path: &Path, source: std::io::Error) -> Self {
        Self::Unreadable { path: path.display().to_string(), source }
    }

    fn malformed(path: &Path, reason: impl Into<String>) -> Self {
        Self::Malformed { path: path.display().to_string(), reason: reason.into(), source: None }
    }

    /// A malformed file that `source` refuses. `context` precedes the text of `source`.
    fn caused(path: &Path, context: &str, source: impl Error + Send + Sync + 'static) -> Self {
        let reason = if context.is_empty() { source.to_string() } else { format!("{context}: {source}") };
        Self::Malformed { path: path.display().to_string(), reason, source: Some(Box::new(source)) }
    }
}

/// Compares every number of a golden folder.
///
/// # Errors
/// [`VerifyError`] if a file cannot be read or is malformed, or if the parts of the folder do not fit
/// together. Also if no code computes the numbers of a file.
pub fn verify(folder: &Path) -> Result<Vec<Comparison>, VerifyError> {
    std::fs::read_dir(folder).map_err(|source| VerifyError::unreadable(folder, source))?;
    if tracking::PARTS.iter().any(|part| folder.join(part).is_dir()) {
        tracking::verify(folder)
    } else if model::FILES.iter().any(|file| folder.join(file).exists()) {
        model::verify(folder)
    } else {
        Err(VerifyError::NoVectors { path: folder.display().to_string() })
    }
}
