use std::path::PathBuf;

use thiserror::Error;

/// The reason why a recording could not be read.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The file or its folder can't be opened or read.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is larger than any recording.
    #[error("{path}: {bytes} bytes, at most {most} are read")]
    TooLarge {
        /// The file.
        path: String,
        /// Size.
        bytes: u64,
        /// The limit.
        most: u64,
    },
    /// The file has more rows than are kept.
    #[error("{path}:{line}: more than {most} rows")]
    TooManyRows {
        /// The file.
        path: String,
        /// The first line beyond the limit, from 1.
        line: usize,
        /// The limit.
        most: usize,
    },
    /// The file is binary.
    #[error("{path}:{line}: not text: byte {byte} of the line is not UTF-8")]
    NotText {
        /// The file.
        path: String,
        /// The line, from 1.
        line: usize,
        /// The offending byte's place in its line, from 1.
        byte: usize,
    },
    /// A row has too few or too many columns.
    #[error("{path}:{line}:1: {found} columns, expected {expected}: \"{text}\"")]
    Columns {
        /// The file.
        path: String,
        /// The line, from 1.
        line: usize,
        /// Columns of the row.
        found: usize,
        /// Columns of the format.
        expected: usize,
        /// The row, shortened.
        text: String,
    },
    /// A value does not have the kind or the range that its column requires.
    #[error("{path}:{line}:{column}: {field} = \"{value}\": {problem}")]
    Value {
        /// The file.
        path: String,
        /// The line, from 1.
        line: usize,
        /// Where the value begins in its line, in bytes from 1.
        column: usize,
        /// The column's name.
        field: &'static str,
        /// The value, shortened.
        value: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A message of a bag has a value that it must not have.
    #[error("{path}: message {message}: {field} = \"{value}\": {problem}")]
    Message {
        /// The file.
        path: String,
        /// The message's place in the file, from 1.
        message: usize,
        /// The field.
        field: &'static str,
        /// The value, shortened.
        value: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A bag can't be read, or has no objects.
    #[error("{path}: {problem}")]
    Bag {
        /// The file.
        path: String,
        /// What is wrong.
        problem: String,
    },
    /// The file violates the rules of its notation.
    #[error("{path}:{line}:{column}: {problem}")]
    Syntax {
        /// The file.
        path: String,
        /// The line, from 1.
        line: usize,
        /// The column, from 1.
        column: usize,
        /// What is wrong.
        problem: String,
    },
    /// One object has two rows at the same time.
    #[error("{path}:{line}: id {id} stands in this frame already, in {first_path}:{first_line}")]
    Duplicate {
        /// The file.
        path: String,
        /// The line of the second row, from 1.
        line: usize,
        /// The object.
        id: u64,
        /// The file of the first row.
        first_path: String,
        /// The line of the first row, from 1.
        first_line: usize,
    },
    /// The time of an object goes back, in a file whose rows are in order otherwise.
    #[error(
        "{path}:{line}: time goes back{}: {stamp_s:.3} s after {before_s:.3} s in line {before_line}: was the clock \
         set back, or the recording played again? Cut the file there; if its rows are only out of order, sort \
         them by their stamps",
        id.map_or_else(String::new, |id| format!(" for id {id}"))
    )]
    TimeGoesBack {
        /// The file.
        path: String,
        /// The line of the row that goes back, from 1.
        line: usize,
        /// The object, if the rows have identities.
        id: Option<u64>,
        /// The row's stamp.
        stamp_s: f64,
        /// The line of the object's previous row, from 1.
        before_line: usize,
        /// The stamp of that row.
        before_s: f64,
    },
    /// The file has no rows.
    #[error("{path}: no rows")]
    Empty {
        /// The file.
        path: String,
    },
    /// A file that belongs to the recording is missing.
    #[error("{path}: needs {role}, and there is none{searched}")]
    Missing {
        /// The file that was opened.
        path: String,
        /// The missing content.
        role: &'static str,
        /// The searched place as ` at PATH`, or empty.
        searched: String,
    },
    /// A frame rate was given for a format whose files contain their times, or whose rate is fixed.
    #[error(
        "{path}: {format} has a time for every frame, and takes no frame rate: that is for {}",
        names.join(", ")
    )]
    FrameRate {
        /// The file.
        path: String,
        /// Format.
        format: &'static str,
        /// The formats that accept a frame rate.
        names: Vec<&'static str>,
    },
    /// An origin was given for a format whose positions are not in their own world frame.
    #[error("{path}: {format} has its origin at the scene, and takes no --origin")]
    Origin {
        /// The file.
        path: String,
        /// Format.
        format: &'static str,
    },
    /// The content fits no format, or more than one.
    #[error("{path}: {problem}; name the format (one of {known})")]
    UnknownFormat {
        /// The file.
        path: String,
        /// What the content has instead of a known format.
        problem: String,
        /// The names of all formats.
        known: String,
    },
}

/// The place of an error in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ErrorPlace {
    /// The file.
    pub path: String,
    /// The line, or for bags the message, from 1.
    pub line: Option<usize>,
    /// The value, shortened.
    pub value: Option<String>,
}

impl ReadError {
    /// The place of the error, for programs that show it.
    #[must_use]
    pub fn place(&self) -> ErrorPlace {
        let (path, line, value) = match self {
            Self::Io { path, .. } => {
                return ErrorPlace { path: path.display().to_string(), line: None, value: None };
            }
            Self::TooLarge { path, .. }
            | Self::Bag { path, .. }
            | Self::Empty { path }
            | Self::Missing { path, .. }
            | Self::FrameRate { path, .. }
            | Self::Origin { path, .. }
            | Self::UnknownFormat { path, .. } => (path, None, None),
            Self::TooManyRows { path, line, .. }
            | Self::NotText { path, line, .. }
            | Self::Syntax { path, line, .. } => (path, Some(*line), None),
            Self::Columns { path, line, text, .. } => (path, Some(*line), Some(text.clone())),
            Self::Value { path, line, value, .. } | Self::Message { path, message: line, value, .. } => {
                (path, Some(*line), Some(value.clone()))
            }
            Self::Duplicate { path, line, id, .. } => (path, Some(*line), Some(id.to_string())),
            Self::TimeGoesBack { path, line, stamp_s, .. } => (path, Some(*line), Some(stamp_s.to_string())),
        };
        ErrorPlace { path: path.clone(), line, value }
    }
}
