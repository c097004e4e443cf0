//! Files of a site, such as context maps and retrieval memories: safetensors, written atomically.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensorError, TensorView};
use thiserror::Error;

/// Why a file could not be read or written.
#[derive(Debug, Error)]
pub enum FileError {
    /// The operating system reported an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The file is not a safetensors file, or lacks a tensor.
    #[error("{}: not a {what}: {source}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The expected content.
        what: &'static str,
        /// The reason.
        source: SafeTensorError,
    },
    /// The tensors of the file do not form the expected content.
    #[error("{}: not a {what}: {reason}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// The expected content.
        what: &'static str,
        /// The reason.
        reason: String,
    },
}

/// A file and its expected content.
#[derive(Clone, Copy, Debug)]
pub struct Target<'a> {
    /// The file.
    pub path: &'a Path,
    /// The expected content, as errors name it.
    pub what: &'static str,
}

impl Target<'_> {
    /// Writes the file atomically: a reader never sees half of it. If the path is a link, its target is
    /// written and the link remains.
    ///
    /// # Errors
    /// [`FileError::Io`] if the folder cannot be written.
    pub fn write(self, bytes: &[u8]) -> Result<(), FileError> {
        let path = fs::canonicalize(self.path).unwrap_or_else(|_| self.path.to_owned());
        let mut partial = path.clone().into_os_string();
        // Two processes that write the same file use separate partial files.
        partial.push(format!(".{}.partial", std::process::id()));
        let written = File::create(&partial)
            .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
            .and_then(|()| fs::rename(&partial, path));
        written.map_err(|source| {
            // The partial file is useless. The first error is the one to report.
            let _ = fs::remove_file(&partial);
            self.io(source)
        })
    }

    /// Reads the file unless it has more than `bytes_max` bytes.
    ///
    /// # Errors
    /// [`FileError::Io`] if the file cannot be read, [`FileError::Content`] if it is larger.
    pub fn read(self, bytes_max: u64) -> Result<Vec<u8>, FileError> {
        let mut bytes = Vec::new();
        let file = File::open(self.path).map_err(|source| self.io(source))?;
        file.take(bytes_max + 1).read_to_end(&mut bytes).map_err(|source| self.io(source))?;
        if bytes.len() as u64 > bytes_max {
            return Err(self.content(format!("more than {bytes_max} bytes, which the largest has")));
        }
        Ok(bytes)
    }

    fn io(self, source: io::Error) -> FileError {
        FileError::Io { path: self.path.into(), source }
    }

    /// The error of a file that is not a safetensors file or lacks a tensor.
    #[must_use]
    pub fn format(self, source: SafeTensorError) -> FileError {
        FileError::Format { path: self.path.into(), what: self.what, source }
    }

    /// The error of a file whose tensors do not form the expected content.
    #[must_use]
    pub fn content(self, reason: String) -> FileError {
        FileError::Content { path: self.path.into(), what: self.what, reason }
    }
}

/// The numbers of a tensor of this shape. Any values are accepted.
///
/// # Errors
/// A text, if the tensor has another type or shape.
pub fn numbers(name: &str, view: &TensorView<'_>, shape: &[usize]) -> Result<Vec<f32>, String> {
    if view.dtype() != Dtype::F32 || view.shape() != shape {
        return Err(format!("{name} is {:?} {:?}, expected F32 {shape:?}", view.dtype(), view.shape()));
    }
    let (words, _) = view.data().as_chunks::<4>();
    Ok(words.iter().map(|word| f32::from_le_bytes(*word)).collect())
}

/// Like [`numbers`], with finite values only.
///
/// # Errors
/// Like [`numbers`], or if a value is not finite.
pub fn finite_numbers(name: &str, view: &TensorView<'_>, shape: &[usize]) -> Result<Vec<f32>, String> {
    let numbers = numbers(name, view, shape)?;
    match numbers.iter().position(|x| !x.is_finite()) {
        Some(at) => Err(format!("{name}[{at}] is {}", numbers[at])),
        None => Ok(numbers),
    }
}
