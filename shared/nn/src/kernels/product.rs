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
#[cfg(test)]
mod tests;
mod tile;

pub use pack::Columns;

use super::dispatch;
use crate::buffer::Buffer;
use tile::Checked;

/// Columns of a panel.
pub const PANEL: usize = 16;
/// Maximum number of taps of a convolution: 7 × 7.
pub(crate) const TAPS_MAX: usize = 49;
/// Marks a tap that reads padding.
const DEAD: u32 = u32::MAX;

/// A matrix in the kernel's reading order, with a bias.
pub struct Panels {
    values: Buffer,
    bias: Buffer,
    tap_count: usize,
    in_len: usize,
    out_len: usize,
    panel_count: usize,
}

impl Panels {
    /// Packs the matrix whose entry (out, tap, in) is `weight(out, tap, in)`. Outputs are padded with zeros
    /// to whole panels.
    ///
    /// # Panics
    /// If a length is 0 or there are more than 49 taps.
    #[must_use]
    pub fn pack(
        [out_len, tap_count, in_len]: [usize; 3],
        weight: impl Fn(usize, usize, usize) -> f32,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        assert!((1..=TAPS_MAX).contains(&tap_count) && in_len > 0 && out_len > 0);
        let panel_count = out_len.div_ceil(PANEL);
        let mut values = Buffer::zeroed(panel_count * tap_count * in_len * PANEL);
        let mut padded_bias = Buffer::zeroed(panel_count * PANEL);
        for out in 0..out_len {
            let (panel, column) = (out / PANEL, out % PANEL);
            padded_bias[out] = bias(out);
            for tap in 0..tap_count {
                for c in 0..in_len {
                    let place = ((panel * tap_count + tap) * in_len + c) * PANEL + column;
                    values[place] = weight(out, tap, c);
                }
            }
        }
        Self { values, bias: padded_bias, tap_count, in_len, out_len, panel_count }
    }

    /// Length of an output row: a multiple of 16.
    pub const fn out_stride(&self) -> usize {
        self.panel_count * PANEL
    }

    /// Whether the second half of the last panel contains only padding.
    const fn ends_in_half(&self) -> bool {
        self.panel_count * PANEL - self.out_len >= PANEL / 2
    }

    const fn panel_len(&self) -> usize {
        self.tap_count * self.in_len * PANEL
    }
}

/// The input position of each tap at each output position of a convolution.
pub struct Taps {
    /// \[output position, tap\]: input position or [`DEAD`].
    sources: Vec<u32>,
    tap_count: usize,
    in_positions: usize,
}

impl Taps {
    /// The taps of a square kernel over a square map.
    ///
    /// # Panics
    /// If the kernel is larger than the padded map.
    #[must_use]
    pub fn new(side: usize, kernel: usize, stride: usize, padding: usize) -> Self {
        assert!(side * side < DEAD as usize && kernel <= side + 2 * padding, "a kernel over a map");
        let out_side = (side + 2 * padding - kernel) / stride + 1;
        let mut sources = Vec::with_capacity(out_side * out_side * kernel * kernel);
        let inside = |out: usize, tap: usize| (out * stride + tap).checked_sub(padding).filter(|&i| i < side);
        for position in 0..out_side * out_side {
            for tap in 0..kernel * kernel {
                let row = inside(position / out_side, tap / kernel);
                let column = inside(position % out_side, tap % kernel);
                sources.push(match (row, column) {
                    (Some(row), Some(column)) => (row * side + column) as u32,
                    _ => DEAD,
                });
            }
        }
        Self { sources, tap_count: kernel * kernel, in_positions: side * side }
    }

    /// Number of positions of the output map.
    pub fn out_positions(&self) -> usize {
        self.sources.len() / self.tap_count
    }

    /// The live taps at an output position, each with its input position.
    pub fn live_at(&self, position: usize) -> impl Iterator<Item = (usize, usize)> {
        let live = |(tap, &source): (usize, &u32)| (source != DEAD).then_some((tap, source as usize));
        self.sources(position).iter().enumerate().filter_map(live)
    }

    /// The same table without taps that are dead everywhere, and the indices of the remaining taps.
    pub fn without_dead(&self) -> (Self, Vec<usize>) {
        let sees_input =
            |tap: &usize| (0..self.out_positions()).any(|position| self.sources(position)[*tap] != DEAD);
        let left: Vec<usize> = (0..self.tap_count).filter(sees_input).collect();
        let positions = (0..self.out_positions()).map(|position| self.sources(position));
        let sources = positions.flat_map(|sources| left.iter().map(|&tap| sources[tap])).collect();
        (Self { sources, tap_count: left.len(), in_positions: self.in_positions }, left)
    }

    /// The table of the backward pass: for each *input* position and tap, the output position that reads it.
    pub fn transposed(&self) -> Self {
        let mut sources = vec![DEAD; self.in_positions * self.tap_count];
        for position in 0..self.out_positions() {
            for (tap, source) in self.live_at(position) {
                sources[source * self.tap_count + tap] = position as u32;
            }
        }
        Self { sources, tap_count: self.tap_count, in_positions: self.out_positions() }
    }

    /// The input positions of an output position's taps.
    fn sources(&self, position: usize) -> &[u32] {
        &self.sources[position * self.tap_count..][..self.tap_count]
    }

    /// Number of live pairs of output position and tap.
    pub fn live_count(&self) -> usize {
        self.sources.iter().filter(|&&source| source != DEAD).count()
    }
}

/// How output rows find their input.
#[derive(Clone, Copy)]
pub enum Gather<'a> {
    /// Row q starts at q · stride.
    Rows {
        /// Distance between rows, in floats.
        stride: usize,
    },
    /// Row q is column q of a matrix: the product with its transpose.
    Columns {
        /// Distance between rows of the matrix, in floats.
        stride: usize,
    },
    /// Row q is output position q / images of image q % images. The input is \[position, image, channel\].
    Taps {
        /// The convolution's table.
        taps: &'a Taps,
        /// Images in the batch.
        image_count: usize,
        /// A row of zeros, as long as an input row.
        zeros: &'a [f32],
    },
}

/// One product; see the module.
pub struct Product<'a> {
    /// The input rows.
    pub input: &'a [f32],
    /// How an output row finds its input.
    pub gather: Gather<'a>,
    /// The matrix, with the bias.
    pub panels: &'a Panels,
    /// Added before the ReLU; in the layout of `out`.
    pub residual: Option<&'a [f32]>,
    /// Whether negative results become 0.
    pub relu: bool,
    /// \[row, `panels.out_stride()`\].
    pub out: &'a mut [f32],
}

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
