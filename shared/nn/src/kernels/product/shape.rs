//! The operands of a product.

use crate::buffer::Buffer;

/// Columns of a panel.
pub const PANEL: usize = 16;
/// Maximum number of taps of a convolution: 7 × 7.
pub(crate) const TAPS_MAX: usize = 49;
/// Marks a tap that reads padding.
pub(super) const DEAD: u32 = u32::MAX;

/// A matrix in the kernel's reading order, with a bias.
pub struct Panels {
    pub(super) values: Buffer,
    pub(super) bias: Buffer,
    pub(super) tap_count: usize,
    pub(super) in_len: usize,
    pub(super) out_len: usize,
    pub(super) panel_count: usize,
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
    pub(super) const fn ends_in_half(&self) -> bool {
        self.panel_count * PANEL - self.out_len >= PANEL / 2
    }

    pub(super) const fn panel_len(&self) -> usize {
        self.tap_count * self.in_len * PANEL
    }
}

/// The input position of each tap at each output position of a convolution.
pub struct Taps {
    /// \[output position, tap\]: input position or [`DEAD`].
    pub(super) sources: Vec<u32>,
    pub(super) tap_count: usize,
    pub(super) in_positions: usize,
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
    pub(super) fn sources(&self, position: usize) -> &[u32] {
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
