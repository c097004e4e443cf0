use std::io;
use std::path::PathBuf;

use thiserror::Error;

use crate::frame::FrameError;

/// Why a recording can't be read.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The file can't be read.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The file is not an MCAP file.
    #[error("{}: not an MCAP file", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// The file is an MCAP file without the description of a run.
    #[error(
        "{}: it has no metadata \"{wanted}\": another program made it, it was cut off before them, or a tool left them \
         out (`mcap filter --include-metadata` keeps them)",
        path.display()
    )]
    NotOurs {
        /// The file.
        path: PathBuf,
        /// What is missing.
        wanted: &'static str,
    },
    /// The frames have another layout than this program's.
    #[error(
        "{}: a recording of wire schema {found}, this program reads {expected}: use the program that made it ({program})",
        path.display()
    )]
    Schema {
        /// The file.
        path: PathBuf,
        /// The file's version.
        found: u32,
        /// This program's.
        expected: u32,
        /// The program that wrote the file.
        program: String,
    },
    /// A part of the file differs from the written bytes.
    #[error("{}: byte {offset}: {what}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Offset of the part.
        offset: u64,
        /// What is wrong.
        what: String,
    },
    /// A message is not a frame of its topic.
    #[error("{}: chunk at byte {offset}, message {message}: {source}", path.display())]
    Frame {
        /// The file.
        path: PathBuf,
        /// Offset of its chunk.
        offset: u64,
        /// Index of the message within the chunk, from 0.
        message: usize,
        /// What is wrong.
        source: FrameError,
    },
}

/// Why a recording can't be started or finished.
#[derive(Debug, Error)]
#[error("{}: {source}", path.display())]
pub struct WriteError {
    /// The file.
    pub path: PathBuf,
    /// The system's error.
    pub source: io::Error,
}
