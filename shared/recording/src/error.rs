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
    /// It is no MCAP file.
    #[error("{}: not an MCAP file", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// It is an MCAP file, but the description of a run is missing.
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
    /// Its frames have another layout than this program's.
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
        /// What wrote the file.
        program: String,
    },
    /// A part of the file is not what was written.
    #[error("{}: byte {offset}: {what}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where the part begins.
        offset: u64,
        /// What is wrong.
        what: String,
    },
    /// A message is no frame of its topic.
    #[error("{}: chunk at byte {offset}, message {message}: {source}", path.display())]
    Frame {
        /// The file.
        path: PathBuf,
        /// Where its chunk begins.
        offset: u64,
        /// Its number within the chunk, from 0.
        message: usize,
        /// What is wrong.
        source: FrameError,
    },
}

/// Why a recording can't be begun or ended.
#[derive(Debug, Error)]
#[error("{}: {source}", path.display())]
pub struct WriteError {
    /// The file.
    pub path: PathBuf,
    /// The system's error.
    pub source: io::Error,
}
