//! Packs whole matrices.

use super::{PANEL, Panels};
use crate::buffer::Buffer;

/// Consecutive columns of a row-major matrix.
#[derive(Clone, Copy, Debug)]
pub struct Columns<'a> {
    /// Values, starting with the first row's first column.
    pub values: &'a [f32],
    /// Number of rows.
    pub rows_len: usize,
    /// Number of columns.
    pub cols_len: usize,
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
        let Columns { values, rows_len, cols_len, stride } = matrix;
        let mut panels = Self::empty(rows_len, cols_len);
        for (number, panel) in panels.values.chunks_exact_mut(rows_len * PANEL).enumerate() {
            let first = number * PANEL;
            let len = PANEL.min(cols_len - first);
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
        let Columns { values, rows_len, cols_len, stride } = matrix;
        let mut panels = Self::empty(cols_len, rows_len);
        for (number, panel) in panels.values.chunks_exact_mut(cols_len * PANEL).enumerate() {
            let first = number * PANEL;
            for column in 0..PANEL.min(rows_len - first) {
                let row = &values[(first + column) * stride..][..cols_len];
                for (packed, value) in panel.as_chunks_mut::<PANEL>().0.iter_mut().zip(row) {
                    packed[column] = *value;
                }
            }
        }
        panels
    }

    fn empty(in_len: usize, out_len: usize) -> Self {
        assert!(in_len > 0 && out_len > 0, "a {in_len} × {out_len} matrix");
        let panels_len = out_len.div_ceil(PANEL);
        Self {
            values: Buffer::zeroed(panels_len * in_len * PANEL),
            bias: Buffer::zeroed(panels_len * PANEL),
            taps_len: 1,
            in_len,
            out_len,
            panels_len,
        }
    }
}
