use std::path::{Path, PathBuf};

use data::ReadError;
use nn::{ConfigError, WeightsError};

/// Why a training fails.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A recording could not be read.
    #[error(transparent)]
    Data(#[from] ReadError),
    /// The options contradict one another, or name an unknown data set.
    #[error("{0}")]
    Options(String),
    /// The model's configuration is invalid.
    #[error("model.{0}")]
    Model(#[source] ConfigError),
    /// The weights to begin with can't be used.
    #[error("begin_with {}: {source}", path.display())]
    BeginWith {
        /// The weights file.
        path: PathBuf,
        /// Why not.
        source: WeightsError,
    },
    /// The weights to begin with do not fit.
    #[error("begin_with {}: {problem}", path.display())]
    Unsuitable {
        /// The weights file.
        path: PathBuf,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// The data contain no agent with a known future.
    #[error("no {part} window has an agent with a known future below {}", root.display())]
    NoWindows {
        /// Part of the data sets.
        part: &'static str,
        /// Folder that was searched.
        root: PathBuf,
    },
    /// The tensors of a weights file or checkpoint could not be read or written.
    #[error("{}: {source}", path.display())]
    Tensors {
        /// The file.
        path: PathBuf,
        /// The tensor and its fault.
        source: TensorError,
    },
    /// The metadata of a weights file or checkpoint could not be read or written.
    #[error("{}: metadata `{key}`: {source}", path.display())]
    Metadata {
        /// The file.
        path: PathBuf,
        /// The key.
        key: &'static str,
        /// The fault of the JSON.
        source: serde_json::Error,
    },
    /// A checkpoint does not belong to these options.
    #[error("{}: {reason}", path.display())]
    Checkpoint {
        /// The checkpoint's file.
        path: PathBuf,
        /// The difference.
        reason: &'static str,
    },
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The scratch file of scenes could not be written or read.
    #[error("scratch file in {}: {source}", folder.display())]
    Scratch {
        /// Folder.
        folder: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The base control could not be fitted.
    #[error("the base control can't be fitted to {windows} windows: a feature is not finite")]
    Fit {
        /// Number of windows.
        windows: usize,
    },
    /// The loss was not finite several times in a row.
    #[error("the loss of step {step} is not finite; a lower learning rate may help")]
    Diverged {
        /// Update at which it happened.
        step: u64,
    },
}

/// Why the tensors of a file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum TensorError {
    /// The safetensors file is malformed, or lacks a tensor.
    #[error("safetensors: {0}")]
    Safetensors(#[from] safetensors::SafeTensorError),
    /// A tensor has another shape.
    #[error("tensor `{name}`: expected shape {expected:?}, found {found:?}")]
    Shape {
        /// Name of the tensor.
        name: String,
        /// Shape that the model needs.
        expected: Vec<usize>,
        /// Shape in the file.
        found: Vec<usize>,
    },
    /// A tensor has an element type other than f32 and f16.
    #[error("tensor `{name}`: expected F32 or F16, found {found:?}")]
    ElementType {
        /// Name of the tensor.
        name: String,
        /// Element type in the file.
        found: safetensors::Dtype,
    },
}

impl TensorError {
    /// Adds the file to the error.
    pub(crate) fn of(self, path: &Path) -> TrainError {
        TrainError::Tensors { path: path.to_owned(), source: self }
    }
}

impl TrainError {
    /// The error of weights to begin with that belong to another model.
    pub(crate) fn other_model(path: &Path) -> Self {
        Self::Unsuitable {
            path: path.to_owned(),
            problem: "its model is another one than the options ask for",
        }
    }
}
