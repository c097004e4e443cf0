//! Recordings from columns in memory.
//!
//! The columns become text in the project's own format, and its reader reads the text. So every rule of the
//! reader holds for arrays and data frames, too.

use std::collections::HashMap;
use std::fmt::Write as _;

use data::formats::csv;
use data::{Format, Input, ReadError, Role};
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::PyBytes;
use wire::WorldOrigin;

use crate::error::InputError;
use crate::recording::Recording;

/// The line of row 0: the header is line 1.
const FIRST_LINE: usize = 2;

/// The column of recordings that a name means, or else the column that the name may mean.
#[pyfunction]
pub fn column_of(name: &str) -> (Option<&'static str>, Option<&'static str>) {
    csv::column_of(name).map_or_else(|meant| (None, meant), |known| (Some(known), None))
}

/// A value as text. NaN and the largest number mean that the value is missing.
enum Column {
    Numbers(Vec<f64>),
    Nanoseconds(Vec<i64>),
    Identities(Vec<u64>),
    Words(Vec<u8>, Vec<String>),
}

impl Column {
    fn read(kind: &str, bytes: &[u8], words: &[String]) -> PyResult<Self> {
        fn each<T: bytemuck::AnyBitPattern>(bytes: &[u8]) -> Vec<T> {
            bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect()
        }
        Ok(match kind {
            "f8" => Self::Numbers(each(bytes)),
            "i8" => Self::Nanoseconds(each(bytes)),
            "u8" => Self::Identities(each(bytes)),
            "u1" => Self::Words(bytes.to_vec(), words.to_vec()),
            _ => return Err(InputError::new_err(format!("a column of kind {kind}"))),
        })
    }

    fn rows(&self) -> usize {
        match self {
            Self::Numbers(values) => values.len(),
            Self::Nanoseconds(values) => values.len(),
            Self::Identities(values) => values.len(),
            Self::Words(values, _) => values.len(),
        }
    }

    fn write(&self, row: usize, text: &mut String) -> std::fmt::Result {
        match self {
            // The shortest text that is read as the same number.
            Self::Numbers(values) if !values[row].is_nan() => write!(text, "{:?}", values[row]),
            Self::Nanoseconds(values) => {
                let (sign, value) = (if values[row] < 0 { "-" } else { "" }, values[row].unsigned_abs());
                write!(text, "{sign}{}.{:09}", value / 1_000_000_000, value % 1_000_000_000)
            }
            Self::Identities(values) if values[row] != u64::MAX => write!(text, "{}", values[row]),
            Self::Words(values, words) => {
                text.push_str(words.get(usize::from(values[row])).map_or("", |word| word));
                Ok(())
            }
            Self::Numbers(_) | Self::Identities(_) => Ok(()),
        }
    }
}

/// The text of columns in the project's own format. `columns` are name, kind and values of each; `words` are the
/// words that a column of kind `u1` numbers. All columns have the same number of rows.
#[pyfunction]
pub fn write_columns<'py>(
    py: Python<'py>,
    columns: Vec<(String, String, PyBackedBytes)>,
    words: Vec<String>,
) -> PyResult<Bound<'py, PyBytes>> {
    let text = py.detach(move || {
        let names: Vec<&str> = columns.iter().map(|(name, ..)| &**name).collect();
        let mut text = names.join(",") + "\n";
        let read = |(_, kind, bytes): &(String, String, PyBackedBytes)| Column::read(kind, bytes, &words);
        let columns: Vec<Column> = columns.iter().map(read).collect::<PyResult<_>>()?;
        for row in 0..columns.iter().map(Column::rows).min().unwrap_or(0) {
            for (place, column) in columns.iter().enumerate() {
                text.push_str(if place > 0 { "," } else { "" });
                column.write(row, &mut text).map_err(|why| crate::error::of(&why))?;
            }
            text.push('\n');
        }
        Ok::<_, PyErr>(text)
    })?;
    Ok(PyBytes::new(py, text.as_bytes()))
}

/// The recording of a text by [`write_columns`]. Errors name row and column; `labels` has other names of columns.
#[pyfunction]
pub fn parse_columns(
    py: Python<'_>,
    text: PyBackedBytes,
    name: String,
    labels: HashMap<String, String>,
    origin: (f64, f64),
) -> PyResult<Recording> {
    py.detach(move || {
        let origin = WorldOrigin::new([origin.0, origin.1])
            .ok_or_else(|| InputError::new_err(format!("origin = {origin:?}: not finite, or too far")))?;
        let input = Input { origin, ..Input::new(Role::Rows, &*name, &*text) };
        let recording = data::parse(Format::Csv, &[input])
            .map_err(|why| InputError::new_err(format!("{name}: {}", problem(&why, &labels))))?;
        Ok(Recording::new(data::Recording { name, ..recording }, None, origin))
    })
}

/// The error of the reader with the row in place of the line.
fn problem(why: &ReadError, labels: &HashMap<String, String>) -> String {
    let row = |line: usize| line.saturating_sub(FIRST_LINE);
    match why {
        ReadError::Value { line, field, value, problem, .. } => {
            let label = labels.get(*field).map_or(*field, |label| label);
            let value = if value.is_empty() { "nothing" } else { value };
            format!("row {}: {label} = {value}: {problem}", row(*line))
        }
        ReadError::Duplicate { line, id, first_line, .. } => {
            format!("row {}: id {id} stands in this frame already, in row {}", row(*line), row(*first_line))
        }
        ReadError::TimeGoesBack { line, id, stamp_s, before_line, before_s, .. } => {
            let id = id.map_or_else(String::new, |id| format!(" for id {id}"));
            let before = row(*before_line);
            format!(
                "row {}: time goes back{id}: {stamp_s:.3} s after {before_s:.3} s in row {before}: cut the frame \
                 there; if its rows are only out of order, sort them by their stamps",
                row(*line)
            )
        }
        ReadError::Empty { .. } => "no rows".to_owned(),
        other => other.to_string(),
    }
}
