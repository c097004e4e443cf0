//! Packs whole matrices.

use super::shape::{PANEL, Panels};
use crate::buffer::Buffer;

/// Consecutive columns of a row-major matrix.
#[derive(Clone, Copy, Debug)]
pub struct Columns<'a> {
    /// Values, starting with the first row's first column.
    pub values: &'a [f32],
    /// Number of rows.
    pub row_count: usize,
    /// Number of columns.
    pub col_count: usize,
    /// Distance between rows, in floats.
    pub stride: usize,
}

impl Panels {
    /// Packs a matrix W for x · W: one output per column, without bias.
    ///
    /// # Panics
    /// If the matrix is empty or exceeds its values.
    #[must_use]
    pub fn of_columns(matrix: Columns<'_>) -> Self {
        let Columns { values, row_count, col_count, stride } = matrix;
        let mut panels = Self::empty(row_count, col_count);
        for (number, panel) in panels.values.chunks_exact_mut(row_count * PANEL).enumerate() {
            let first = number * PANEL;
            let len = PANEL.min(col_count - first);
            for (row, packed) in panel.as_chunks_mut::<PANEL>().0.iter_mut().enumerate() {
                packed[..len].copy_from_slice(&values[row * stride + first..][..len]);
            }
        }
        panels
    }

    /// Packs a matrix W for x · Wᵀ: one output per row, without bias.
    ///
    /// # Panics
    /// If the matrix is empty or exceeds its values.
    #[must_use]
    pub fn of_rows(matrix: Columns<'_>) -> Self {
        let Columns { values, row_count, col_count, stride } = matrix;
        let mut panels = Self::empty(col_count, row_count);
        for (number, panel) in panels.values.chunks_exact_mut(col_count * PANEL).enumerate() {
            let first = number * PANEL;
            for column in 0..PANEL.min(row_count - first) {
                let row = &values[(first + column) * stride..][..col_count];
                for (packed, value) in panel.as_chunks_mut::<PANEL>().0.iter_mut().zip(row) {
                    packed[column] = *value;
                }
            }
        }
        panels
    }

    fn empty(in_len: usize, out_len: usize) -> Self {
        assert!(in_len > 0 && out_len > 0, "a {in_len} × {out_len} matrix");
        let panel_count = out_len.div_ceil(PANEL);
        Self {
            values: Buffer::zeroed(panel_count * in_len * PANEL),
            bias: Buffer::zeroed(panel_count * PANEL),
            tap_count: 1,
            in_len,
            out_len,
            panel_count,
        }
    }
}
