//! Recomputes golden vectors with the code that runs on board. `stgdat verify FOLDER` calls it.
//!
//! The input is a folder of golden vectors: inputs, and the results of an independent implementation. The
//! output is one [`Comparison`] per vector. A folder has one of two forms, recognised by its files: the
//! tensors of a `model`, or the numbers of `tracking`.

mod comparison;
mod error;
mod model;
mod tracking;

use std::path::Path;

pub use comparison::Comparison;
pub use error::VerifyError;

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
        Err(VerifyError::NoVectors {
            path: folder.display().to_string(),
            files: model::FILES.join(", "),
            folders: tracking::PARTS.join(", "),
        })
    }
}
