//! Gradients by a matrix, summed block by block.

use std::ops::Range;

use nn::kernels::product::{Columns, Gather, PANEL, Panels, Product};

/// A sum of products dyᵀ x.
pub(super) struct MatrixSum {
    /// `[rows, columns of x padded to whole panels]`.
    sum: Vec<f32>,
    next: Vec<f32>,
    stride: usize,
}

impl MatrixSum {
    pub(super) fn zeros(row_count: usize, col_count: usize) -> Self {
        let stride = col_count.next_multiple_of(PANEL);
        let zeros = vec![0.0; row_count * stride];
        Self { sum: zeros.clone(), next: zeros, stride }
    }

    /// Adds dyᵀ x. Rows of dy are `stride` floats apart. Columns of dy beyond the sum's rows are ignored.
    pub(super) fn add(&mut self, dy: &[f32], stride: usize, x: Columns<'_>) {
        if x.row_count == 0 {
            return;
        }
        Product {
            input: dy,
            gather: Gather::Columns { stride },
            panels: &Panels::of_columns(x),
            residual: Some(&self.sum),
            relu: false,
            out: &mut self.next,
        }
        .run();
        std::mem::swap(&mut self.sum, &mut self.next);
    }

    /// Adds these rows of the sum to `columns` of a gradient with the same number of rows.
    pub(super) fn add_to(&self, rows: Range<usize>, gradient: &mut [f32], columns: Range<usize>) {
        let row_len = gradient.len() / rows.len();
        let sums = self.sum[rows.start * self.stride..rows.end * self.stride].chunks_exact(self.stride);
        for (gradient, sums) in gradient.chunks_exact_mut(row_len).zip(sums) {
            let gradient = &mut gradient[columns.clone()];
            gradient.iter_mut().zip(sums).for_each(|(gradient, sum)| *gradient += sum);
        }
    }
}

/// Some columns of a matrix with these values and rows of length `row_len`.
pub(super) fn columns(values: &[f32], row_len: usize, start: usize, len: usize) -> Columns<'_> {
    let row_count = values.len() / row_len;
    Columns { values: values.get(start..).unwrap_or_default(), row_count, col_count: len, stride: row_len }
}
