//! Row-major matrices and the three products that a linear layer needs.

use nn::kernels::product::{Columns, Gather, PANEL, Panels, Product};

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
    /// If `values` does not fill the matrix.
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

    pub(crate) fn rows_of(&self, rows: std::ops::Range<usize>) -> Self {
        let values = self.values[rows.start * self.cols..rows.end * self.cols].to_vec();
        Self { rows: rows.len(), cols: self.cols, values }
    }

    /// The rows with these indices.
    pub(crate) fn gather(&self, rows: &[u32]) -> Self {
        let mut values = Vec::with_capacity(rows.len() * self.cols);
        rows.iter().for_each(|&row| values.extend_from_slice(self.row(row as usize)));
        Self::new(rows.len(), self.cols, values)
    }

    /// Adds each row of `from` to the row of `self` with its index: the backward pass of [`Matrix::gather`].
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
    /// If `values` does not fill the matrix.
    pub(crate) fn new(values: &'a [f32], rows: usize, cols: usize) -> Self {
        assert_eq!(values.len(), rows * cols, "values of a {rows} × {cols} matrix");
        Self { values, rows, cols, stride: cols }
    }

    pub(crate) fn row(&self, row: usize) -> &'a [f32] {
        &self.values[row * self.stride..][..self.cols]
    }

    pub(crate) fn columns(self, start: usize, len: usize) -> Self {
        assert!(start + len <= self.cols, "columns {start}..{} of {}", start + len, self.cols);
        Self { values: self.values.get(start..).unwrap_or_default(), cols: len, ..self }
    }

    fn columns_of(self) -> Columns<'a> {
        Columns { values: self.values, row_count: self.rows, col_count: self.cols, stride: self.stride }
    }

    fn is_empty(self) -> bool {
        self.rows == 0 || self.cols == 0
    }
}

/// Some columns of a row-major matrix, mutable.
pub(crate) struct ViewMut<'a> {
    values: &'a mut [f32],
    rows: usize,
    cols: usize,
    stride: usize,
}

impl<'a> ViewMut<'a> {
    /// # Panics
    /// If `values` does not fill the matrix.
    pub(crate) fn new(values: &'a mut [f32], rows: usize, cols: usize) -> Self {
        assert_eq!(values.len(), rows * cols, "values of a {rows} × {cols} matrix");
        Self { values, rows, cols, stride: cols }
    }

    pub(crate) fn columns(self, start: usize, len: usize) -> Self {
        assert!(start + len <= self.cols, "columns {start}..{} of {}", start + len, self.cols);
        Self { values: self.values.get_mut(start..).unwrap_or_default(), cols: len, ..self }
    }

    /// Stores the rows of a product, which are `stride` floats apart.
    fn take(&mut self, product: &[f32], stride: usize, into: Into) {
        for (row, product) in product.chunks_exact(stride).enumerate() {
            let out = &mut self.values[row * self.stride..][..self.cols];
            match into {
                Into::Replace => out.copy_from_slice(&product[..self.cols]),
                Into::Add => out.iter_mut().zip(product).for_each(|(sum, value)| *sum += value),
            }
        }
    }
}

/// Whether a product replaces its target or is added to it.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Into {
    Replace,
    Add,
}

/// Rows of the batch per block of a matrix gradient. Their panels stay in the cache.
const SUMMED: usize = 256;

/// A linear layer: `out` `[n, o]` of `x` `[n, i]` · `w` `[o, i]`ᵀ.
pub(crate) fn forward(x: View<'_>, w: View<'_>, out: ViewMut<'_>, into: Into) {
    assert_eq!((x.cols, x.rows, w.rows), (w.cols, out.rows, out.cols), "shapes of a linear layer");
    multiply(x, || Panels::of_rows(w.columns_of()), out, into);
}

/// The layer's gradient by the input: `out` `[n, i]` of `dy` `[n, o]` · `w` `[o, i]`.
pub(crate) fn by_input(dy: View<'_>, w: View<'_>, out: ViewMut<'_>, into: Into) {
    assert_eq!(
        (dy.cols, dy.rows, w.cols),
        (w.rows, out.rows, out.cols),
        "shapes of a linear layer's backward pass"
    );
    multiply(dy, || Panels::of_columns(w.columns_of()), out, into);
}

/// The layer's gradient by the matrix, added to `out` `[o, i]`: `dy` `[n, o]`ᵀ · `x` `[n, i]`.
pub(crate) fn by_matrix(dy: View<'_>, x: View<'_>, mut out: ViewMut<'_>) {
    assert_eq!((dy.rows, dy.cols, x.cols), (x.rows, out.rows, out.cols), "shapes of a matrix's gradient");
    if dy.is_empty() || x.is_empty() {
        return;
    }
    let stride = x.cols.next_multiple_of(PANEL);
    let mut sum = vec![0.0; dy.cols * stride];
    let mut next = sum.clone();
    for start in (0..x.rows).step_by(SUMMED) {
        let part = View { values: &x.values[start * x.stride..], rows: SUMMED.min(x.rows - start), ..x };
        Product {
            input: &dy.values[start * dy.stride..],
            gather: Gather::Columns { stride: dy.stride },
            panels: &Panels::of_columns(part.columns_of()),
            residual: Some(&sum),
            relu: false,
            out: &mut next,
        }
        .run();
        std::mem::swap(&mut sum, &mut next);
    }
    out.take(&sum, stride, Into::Add);
}

fn multiply(x: View<'_>, panels: impl FnOnce() -> Panels, mut out: ViewMut<'_>, into: Into) {
    if x.is_empty() || out.cols == 0 {
        return;
    }
    let panels = panels();
    if into == Into::Replace && out.stride == panels.out_stride() && out.cols == out.stride {
        return run(x.values, x.stride, &panels, &mut out.values[..out.rows * out.cols]);
    }
    let mut product = vec![0.0; x.rows * panels.out_stride()];
    run(x.values, x.stride, &panels, &mut product);
    out.take(&product, panels.out_stride(), into);
}

fn run(input: &[f32], stride: usize, panels: &Panels, out: &mut [f32]) {
    Product { input, gather: Gather::Rows { stride }, panels, residual: None, relu: false, out }.run();
}

/// The layer's gradient by the bias, added to `out` `[o]`: the column sums of `dy` `[n, o]`.
pub(crate) fn by_bias(dy: &Matrix, out: &mut [f32]) {
    for row in dy.values.chunks_exact(dy.cols.max(1)) {
        out.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::check::values;

    fn random(rows: usize, cols: usize, seed: u64) -> Matrix {
        Matrix::new(rows, cols, values(rows * cols, 1.0, seed))
    }

    fn sum(terms: impl Iterator<Item = (f32, f32)>) -> f32 {
        terms.map(|(a, b)| a * b).sum()
    }

    /// Compares every product of a layer with its definition, between columns that must stay unchanged.
    #[test]
    fn products_agree_with_their_definition() {
        for (n, o, i) in [(1, 1, 1), (5, 17, 3), (300, 20, 33), (13, 64, 128), (600, 5, 128)] {
            let (x, w, dy) = (random(n, i, 1), random(o, i, 2), random(n, o, 3));
            let framed = |rows: usize, cols: usize| Matrix::new(rows, cols + 4, vec![7.0; rows * (cols + 4)]);
            let (mut y, mut dx, mut dw) = (framed(n, o), framed(n, i), framed(o, i));
            forward(x.view(), w.view(), y.view_mut().columns(2, o), Into::Add);
            by_input(dy.view(), w.view(), dx.view_mut().columns(2, i), Into::Replace);
            by_matrix(dy.view(), x.view(), dw.view_mut().columns(2, i));
            let agrees = |name: &str, ours: &Matrix, base: f32, theirs: &dyn Fn(usize, usize) -> f32| {
                for row in 0..ours.rows {
                    for (col, &value) in ours.row(row).iter().enumerate() {
                        let inside = (2..ours.cols - 2).contains(&col);
                        let expected = if inside { base + theirs(row, col - 2) } else { 7.0 };
                        assert!(
                            (value - expected).abs() < 1e-3,
                            "{name}[{row}, {col}]: {value}, not {expected}"
                        );
                    }
                }
            };
            agrees("y", &y, 7.0, &|r, c| sum((0..i).map(|k| (x.row(r)[k], w.row(c)[k]))));
            agrees("dx", &dx, 0.0, &|r, c| sum((0..o).map(|k| (dy.row(r)[k], w.row(k)[c]))));
            agrees("dw", &dw, 7.0, &|r, c| sum((0..n).map(|k| (dy.row(k)[r], x.row(k)[c]))));
        }
    }
}
