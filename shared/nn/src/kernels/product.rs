//! The product of gathered rows with packed panels: one kernel for linear layers and convolutions.
//!
//! ```text
//! out[q, o] = ( Σ_tap Σ_c  input[row(q, tap), c] · W[o, tap, c] + bias[o] + residual[q, o] )⁺
//! ```
//!
//! A linear layer has one tap, and row q of its output reads row q of its input. A convolution has one tap
//! per cell of its kernel and reads the input *in place* (indirect convolution: no im2col copy). A tap that
//! reads only padding is *dead* for that output and is skipped. If a register tile mixes outputs for which a
//! tap is live and dead, the dead ones read a shared row of zeros.
//!
//! W is packed as `[⌈out / 16⌉][tap][in][16]`, so that the innermost loop reads it sequentially. Each output
//! is one chain of multiply-adds in the order of (tap, c). Its bits therefore depend neither on the tile's
//! shape nor on the other rows of a batch.

mod pack;
mod shape;
#[cfg(test)]
mod tests;
mod tile;

pub use pack::Columns;

pub use shape::{Gather, PANEL, Panels, Product, Taps};

use super::dispatch;
use tile::Checked;

impl Product<'_> {
    /// Computes all rows of `out`.
    ///
    /// # Panics
    /// If the lengths of the slices do not match.
    pub fn run(self) {
        let stride = self.panels.out_stride();
        let row_count = self.out.len() / stride;
        assert_eq!(self.out.len(), row_count * stride, "whole rows of output");
        assert!(self.residual.is_none_or(|r| r.len() == self.out.len()), "residual like output");
        if row_count == 0 {
            return;
        }
        match self.gather {
            Gather::Rows { stride } => {
                assert_eq!(self.panels.tap_count, 1);
                let last = (row_count - 1).checked_mul(stride);
                let end = last.and_then(|last| last.checked_add(self.panels.in_len));
                assert!(end.is_some_and(|end| end <= self.input.len()), "rows of input");
            }
            Gather::Columns { stride } => {
                assert_eq!(self.panels.tap_count, 1);
                let last = (self.panels.in_len - 1).checked_mul(stride);
                let end = last.and_then(|last| last.checked_add(row_count));
                assert!(end.is_some_and(|end| end <= self.input.len()), "columns of input");
            }
            Gather::Taps { taps, image_count, zeros } => {
                assert_eq!(self.panels.tap_count, taps.tap_count);
                assert_eq!(taps.out_positions().checked_mul(image_count), Some(row_count), "rows of output");
                let in_rows = taps.in_positions.checked_mul(image_count);
                let len = in_rows.and_then(|rows| rows.checked_mul(self.panels.in_len));
                assert!(len.is_some_and(|len| len <= self.input.len()), "input maps");
                assert!(zeros.len() >= self.panels.in_len);
            }
        }
        dispatch(Checked { product: self, row_count });
    }
}
