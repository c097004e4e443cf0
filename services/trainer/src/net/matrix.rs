//! Row-major matrices and the three products that a linear layer needs.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

/// A matrix, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Matrix {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) values: Vec<f32>,
}

impl Matrix {
    pub(crate) fn zeros(rows: usize, cols: usize) -> Self {
        Self { rows, cols, values: vec![0.0; rows * cols] }
    }

    /// # Panics
    /// Where `values` does not fill the matrix.
    pub(crate) fn new(rows: usize, cols: usize, values: Vec<f32>) -> Self {
        assert_eq!(values.len(), rows * cols, "values of a {rows} × {cols} matrix");
        Self { rows, cols, values }
    }

    pub(crate) fn row(&self, row: usize) -> &[f32] {
        &self.values[row * self.cols..][..self.cols]
    }

    pub(crate) fn row_mut(&mut self, row: usize) -> &mut [f32] {
        &mut self.values[row * self.cols..][..self.cols]
    }

    pub(crate) fn view(&self) -> View<'_> {
        View { values: &self.values, rows: self.rows, cols: self.cols, stride: self.cols }
    }

    pub(crate) fn view_mut(&mut self) -> ViewMut<'_> {
        ViewMut { rows: self.rows, cols: self.cols, stride: self.cols, values: &mut self.values }
    }

    /// The rows with these numbers.
    pub(crate) fn gather(&self, rows: &[u32]) -> Self {
        let values = rows.iter().flat_map(|&row| self.row(row as usize)).copied().collect();
        Self::new(rows.len(), self.cols, values)
    }

    /// Adds each row of `from` to the row of `self` with its number: the way back of [`Matrix::gather`].
    pub(crate) fn scatter_add(&mut self, rows: &[u32], from: &Self) {
        for (row, from) in rows.iter().zip(from.values.chunks_exact(from.cols.max(1))) {
            self.row_mut(*row as usize).iter_mut().zip(from).for_each(|(sum, value)| *sum += value);
        }
    }

    /// Adds a matrix of the same shape.
    pub(crate) fn add(&mut self, other: &Self) {
        assert_eq!((self.rows, self.cols), (other.rows, other.cols), "shapes of a sum");
        self.values.iter_mut().zip(&other.values).for_each(|(sum, value)| *sum += value);
    }
}

/// Some columns of a row-major matrix.
#[derive(Clone, Copy)]
pub(crate) struct View<'a> {
    values: &'a [f32],
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    stride: usize,
}

impl<'a> View<'a> {
    /// # Panics
    /// Where `values` does not fill the matrix.
    pub(crate) fn new(values: &'a [f32], rows: usize, cols: usize) -> Self {
        assert_eq!(values.len(), rows * cols, "values of a {rows} × {cols} matrix");
        Self { values, rows, cols, stride: cols }
    }

    /// The columns from `start` on.
    pub(crate) fn columns(self, start: usize, len: usize) -> Self {
        assert!(start + len <= self.cols, "columns {start}..{} of {}", start + len, self.cols);
        Self { values: self.values.get(start..).unwrap_or_default(), cols: len, ..self }
    }

    fn faer(self) -> MatRef<'a, f32> {
        let needed = self.rows.saturating_sub(1) * self.stride + if self.rows == 0 { 0 } else { self.cols };
        // The last row may end before its stride does.
        MatRef::from_row_major_slice_with_stride(&self.values[..needed], self.rows, self.cols, self.stride)
    }
}

/// Some columns of a row-major matrix that is written to.
pub(crate) struct ViewMut<'a> {
    values: &'a mut [f32],
    rows: usize,
    cols: usize,
    stride: usize,
}

impl<'a> ViewMut<'a> {
    /// # Panics
    /// Where `values` does not fill the matrix.
    pub(crate) fn new(values: &'a mut [f32], rows: usize, cols: usize) -> Self {
        assert_eq!(values.len(), rows * cols, "values of a {rows} × {cols} matrix");
        Self { values, rows, cols, stride: cols }
    }

    /// The columns from `start` on.
    pub(crate) fn columns(self, start: usize, len: usize) -> Self {
        assert!(start + len <= self.cols, "columns {start}..{} of {}", start + len, self.cols);
        Self { values: self.values.get_mut(start..).unwrap_or_default(), cols: len, ..self }
    }

    fn faer(self) -> MatMut<'a, f32> {
        let needed = self.rows.saturating_sub(1) * self.stride + if self.rows == 0 { 0 } else { self.cols };
        MatMut::from_row_major_slice_with_stride_mut(
            &mut self.values[..needed],
            self.rows,
            self.cols,
            self.stride,
        )
    }
}

/// Whether a product replaces its target or is added to it.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Into {
    Replace,
    Add,
}

impl Into {
    const fn faer(self) -> Accum {
        match self {
            Self::Replace => Accum::Replace,
            Self::Add => Accum::Add,
        }
    }
}

/// A linear layer: `out` `[n, o]` of `x` `[n, i]` · `w` `[o, i]`ᵀ.
pub(crate) fn forward(x: View<'_>, w: View<'_>, out: ViewMut<'_>, into: Into) {
    matmul(out.faer(), into.faer(), x.faer(), w.faer().transpose(), 1.0, Par::Seq);
}

/// Its gradient by the input: `out` `[n, i]` of `dy` `[n, o]` · `w` `[o, i]`.
pub(crate) fn by_input(dy: View<'_>, w: View<'_>, out: ViewMut<'_>, into: Into) {
    matmul(out.faer(), into.faer(), dy.faer(), w.faer(), 1.0, Par::Seq);
}

/// Its gradient by the matrix, added to `out` `[o, i]`: `dy` `[n, o]`ᵀ · `x` `[n, i]`.
pub(crate) fn by_matrix(dy: View<'_>, x: View<'_>, out: ViewMut<'_>) {
    matmul(out.faer(), Accum::Add, dy.faer().transpose(), x.faer(), 1.0, Par::Seq);
}

/// Its gradient by the bias, added to `out` `[o]`: the column sums of `dy` `[n, o]`.
pub(crate) fn by_bias(dy: &Matrix, out: &mut [f32]) {
    for row in dy.values.chunks_exact(dy.cols.max(1)) {
        out.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
}
