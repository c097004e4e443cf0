use std::path::PathBuf;

/// Why a training run ended early.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// A recording could not be read.
    #[error(transparent)]
    Data(#[from] data::ReadError),
    /// The options contradict one another or the model cannot have them.
    #[error("{0}")]
    Options(String),
    /// The data hold no agent whose future is known.
    #[error("no {part} window has an agent with a known future below {}", root.display())]
    NoWindows {
        /// Part of the data sets.
        part: &'static str,
        /// Folder that was searched.
        root: PathBuf,
    },
    /// A safetensors file is malformed, or lacks a tensor.
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
    /// A tensor holds something else than f32 or f16.
    #[error("tensor `{name}`: expected F32 or F16, found {found}")]
    ElementType {
        /// Name of the tensor.
        name: String,
        /// Element type in the file.
        found: String,
    },
    /// A checkpoint does not belong to these options.
    #[error("{}: {reason}", path.display())]
    Checkpoint {
        /// The checkpoint's file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The scratch file that scenes wait in could not be written or read.
    #[error("scratch file in {}: {source}", folder.display())]
    Scratch {
        /// The folder that it lies in.
        folder: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The GPU that was asked for can't be used.
    #[error("gpu: {reason}")]
    Gpu {
        /// What the system said.
        reason: String,
    },
    /// The loss left the numbers several times in a row.
    #[error("the loss of step {step} is not finite; a lower learning rate may help")]
    Diverged {
        /// Update at which it happened.
        step: u64,
    },
}
