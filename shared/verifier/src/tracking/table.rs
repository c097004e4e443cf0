use std::num::ParseFloatError;
use std::path::{Path, PathBuf};

use crate::VerifyError;

/// A CSV file with a header line.
pub(super) struct Table {
    path: PathBuf,
    columns: Vec<String>,
    /// Line number and text of each row.
    rows: Vec<(usize, String)>,
}

impl Table {
    pub(super) fn read(path: &Path) -> Result<Self, VerifyError> {
        let text = read(path)?;
        let mut lines = lines(&text);
        let head = lines.next().ok_or_else(|| VerifyError::malformed(path, "the file is empty"))?;
        let columns = cells(head.1).map(str::to_owned).collect();
        let rows = lines.map(|(line, text)| (line, text.to_owned())).collect();
        Ok(Self { path: path.to_owned(), columns, rows })
    }

    /// The numbers of some columns, row by row.
    pub(super) fn numbers(&self, names: &[impl AsRef<str>]) -> Result<Vec<Vec<f64>>, VerifyError> {
        let columns = names.iter().map(|name| self.column(name.as_ref())).collect::<Result<Vec<_>, _>>()?;
        let row = |(line, text): &(usize, String)| {
            let cells = self.cells(*line, text)?;
            columns.iter().map(|column| number(&self.path, *line, cells[*column])).collect()
        };
        self.rows.iter().map(row).collect()
    }

    /// The numbers of a fixed set of columns, row by row.
    pub(super) fn number_rows<const N: usize>(&self, names: [&str; N]) -> Result<Vec<[f64; N]>, VerifyError> {
        let rows = self.numbers(&names)?;
        Ok(rows.into_iter().map(|row| std::array::from_fn(|column| row[column])).collect())
    }

    /// The whole numbers of a column.
    pub(super) fn whole_numbers(&self, name: &str) -> Result<Vec<u64>, VerifyError> {
        let whole = |(row, cell): (usize, &str)| {
            cell.parse().map_err(|_| self.malformed(row, format!("{name} \"{cell}\" is not a whole number")))
        };
        self.texts(name)?.into_iter().enumerate().map(whole).collect()
    }

    /// The cells of a column.
    pub(super) fn texts(&self, name: &str) -> Result<Vec<&str>, VerifyError> {
        let column = self.column(name)?;
        self.rows.iter().map(|(line, text)| Ok(self.cells(*line, text)?[column])).collect()
    }

    pub(super) fn malformed(&self, row: usize, reason: impl AsRef<str>) -> VerifyError {
        malformed(&self.path, self.rows[row].0, reason)
    }

    pub(super) fn malformed_file(&self, reason: impl Into<String>) -> VerifyError {
        VerifyError::malformed(&self.path, reason)
    }

    fn column(&self, name: &str) -> Result<usize, VerifyError> {
        let place = self.columns.iter().position(|column| column == name);
        place.ok_or_else(|| malformed(&self.path, 1, format!("there is no column {name}")))
    }

    fn cells<'a>(&self, line: usize, text: &'a str) -> Result<Vec<&'a str>, VerifyError> {
        let cells: Vec<_> = cells(text).collect();
        if cells.len() == self.columns.len() {
            return Ok(cells);
        }
        let reason = format!("{} cells where the head line has {}", cells.len(), self.columns.len());
        Err(malformed(&self.path, line, reason))
    }
}

/// A matrix from a CSV file without a header line, row by row.
#[derive(Debug, PartialEq)]
pub(super) struct Matrix {
    pub(super) row_count: usize,
    pub(super) column_count: usize,
    numbers: Vec<f64>,
}

impl Matrix {
    pub(super) fn read(path: &Path) -> Result<Self, VerifyError> {
        let text = read(path)?;
        let mut matrix = Self { row_count: 0, column_count: 0, numbers: Vec::new() };
        for (line, text) in lines(&text) {
            let before = matrix.numbers.len();
            for cell in cells(text) {
                matrix.numbers.push(number(path, line, cell)?);
            }
            let column_count = matrix.numbers.len() - before;
            if matrix.row_count > 0 && column_count != matrix.column_count {
                let reason = format!("{column_count} cells where the first row has {}", matrix.column_count);
                return Err(malformed(path, line, reason));
            }
            matrix.row_count += 1;
            matrix.column_count = column_count;
        }
        Ok(matrix)
    }

    pub(super) fn at(&self, row: usize, column: usize) -> f64 {
        self.numbers[row * self.column_count + column]
    }

    pub(super) fn numbers(&self) -> &[f64] {
        &self.numbers
    }
}

fn read(path: &Path) -> Result<String, VerifyError> {
    std::fs::read_to_string(path).map_err(|source| VerifyError::unreadable(path, source))
}

/// Number and text of each line that is not blank.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty())
}

fn cells(line: &str) -> impl Iterator<Item = &str> {
    line.split(',').map(str::trim)
}

fn number(path: &Path, line: usize, cell: &str) -> Result<f64, VerifyError> {
    cell.parse().map_err(|error: ParseFloatError| VerifyError::Malformed {
        path: path.display().to_string(),
        reason: format!("line {line}: \"{cell}\" is not a number"),
        source: Some(Box::new(error)),
    })
}

fn malformed(path: &Path, line: usize, reason: impl AsRef<str>) -> VerifyError {
    VerifyError::malformed(path, format!("line {line}: {}", reason.as_ref()))
}
