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
    /// The file as a whole can't be used: its size, its kind, its content, or files that belong to it.
    #[error("{path}: {problem}")]
    File {
        /// The file.
        path: String,
        /// What is wrong.
        problem: String,
    },
    /// A line can't be used: it is not text, or beyond the limit.
    #[error("{path}:{line}: {problem}")]
    Line {
        /// The file.
        path: String,
        /// The line, from 1.
        line: usize,
        /// What is wrong.
        problem: String,
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
    /// The error of a file that can't be used as a whole.
    pub(crate) fn file(path: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::File { path: path.into(), problem: problem.into() }
    }

    /// The error of a file that is larger than is read.
    pub(crate) fn too_large(path: impl Into<String>, bytes: u64, most: u64) -> Self {
        Self::file(path, format!("{bytes} bytes, at most {most} are read"))
    }

    /// The error of a file at `path` without content that belongs to it. `searched` is the place as
    /// ` at PATH`, or empty.
    pub(crate) fn missing(path: impl Into<String>, role: &str, searched: &str) -> Self {
        Self::file(path, format!("needs {role}, and there is none{searched}"))
    }

    /// The place of the error, for programs that show it.
    #[must_use]
    pub fn place(&self) -> ErrorPlace {
        let (path, line, value) = match self {
            Self::Io { path, .. } => {
                return ErrorPlace { path: path.display().to_string(), line: None, value: None };
            }
            Self::File { path, .. } | Self::Empty { path } => (path, None, None),
            Self::Line { path, line, .. } | Self::Syntax { path, line, .. } => (path, Some(*line), None),
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
