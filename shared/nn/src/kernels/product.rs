//! The product of gathered rows with packed panels: one kernel for linear layers and convolutions.
//!
//! ```text
//! out[q, o] = ( Σ_tap Σ_c  input[row(q, tap), c] · W[o, tap, c] + bias[o] + residual[q, o] )⁺
//! ```
//!
//! A linear layer has one tap, and row q of its output reads row q of its input. A convolution has a tap for
//! each cell of its kernel and reads the input *in place* (indirect convolution: no im2col copy). A tap that
//! sees only padding is *dead* for that output and is skipped; where a register tile mixes outputs for which
//! a tap is live and dead, the dead ones read a shared row of zeros.
//!
//! W is packed as `[⌈out / 16⌉][tap][in][16]`, so that the innermost loop reads it front to back. Each output
//! is one chain of multiply-adds in the order of (tap, c): neither the tile's shape nor the other rows of a
//! batch change a bit of it.

#![expect(unsafe_code, reason = "the register tile reads through pointers")]

mod pack;
#[cfg(test)]
mod tests;

pub use pack::Columns;

use super::{Kernel, Lanes, dispatch};
use crate::buffer::Buffer;

/// Columns of a panel.
pub const PANEL: usize = 16;
/// Most taps of a convolution: 7 × 7.
pub(crate) const TAPS_MAX: usize = 49;
/// Marks a tap that sees padding.
const DEAD: u32 = u32::MAX;

/// A matrix in the order in which the kernel reads it, with a bias.
pub struct Panels {
    values: Buffer,
    bias: Buffer,
    taps_len: usize,
    in_len: usize,
    panels_len: usize,
}

impl Panels {
    /// Packs the matrix whose entry for (out, tap, in) is `weight(out, tap, in)`. Outputs are padded to whole
    /// panels with zeros.
    ///
    /// # Panics
    /// Where a length is 0 or there are more than 49 taps.
    #[must_use]
    pub fn pack(
        [out_len, taps_len, in_len]: [usize; 3],
        weight: impl Fn(usize, usize, usize) -> f32,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        assert!((1..=TAPS_MAX).contains(&taps_len) && in_len > 0 && out_len > 0);
        let panels_len = out_len.div_ceil(PANEL);
        let mut values = Buffer::zeroed(panels_len * taps_len * in_len * PANEL);
        let mut padded_bias = Buffer::zeroed(panels_len * PANEL);
        for out in 0..out_len {
            let (panel, column) = (out / PANEL, out % PANEL);
            padded_bias[out] = bias(out);
            for tap in 0..taps_len {
                for c in 0..in_len {
                    let place = ((panel * taps_len + tap) * in_len + c) * PANEL + column;
                    values[place] = weight(out, tap, c);
                }
            }
        }
        Self { values, bias: padded_bias, taps_len, in_len, panels_len }
    }

    /// Length of an output row: a multiple of 16.
    #[must_use]
    pub const fn out_stride(&self) -> usize {
        self.panels_len * PANEL
    }

    const fn panel_len(&self) -> usize {
        self.taps_len * self.in_len * PANEL
    }
}

/// The input position of each tap at each output position of a convolution.
pub struct Taps {
    /// \[output position, tap\]: input position or [`DEAD`].
    sources: Vec<u32>,
    taps_len: usize,
    in_positions: usize,
}

impl Taps {
    /// The taps of a square kernel over a square map.
    ///
    /// # Panics
    /// Where the kernel is larger than the padded map.
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
        Self { sources, taps_len: kernel * kernel, in_positions: side * side }
    }

    /// Positions of the output map.
    #[must_use]
    pub fn out_positions(&self) -> usize {
        self.sources.len() / self.taps_len
    }

    /// The taps that see input at an output position, with the input position that they see.
    pub fn live_at(&self, position: usize) -> impl Iterator<Item = (usize, usize)> {
        let live = |(tap, &source): (usize, &u32)| (source != DEAD).then_some((tap, source as usize));
        self.sources(position).iter().enumerate().filter_map(live)
    }

    /// The same without the taps that see padding everywhere, and the numbers of those that are left.
    #[must_use]
    pub fn without_dead(&self) -> (Self, Vec<usize>) {
        let sees_input =
            |tap: &usize| (0..self.out_positions()).any(|position| self.sources(position)[*tap] != DEAD);
        let left: Vec<usize> = (0..self.taps_len).filter(sees_input).collect();
        let positions = (0..self.out_positions()).map(|position| self.sources(position));
        let sources = positions.flat_map(|sources| left.iter().map(|&tap| sources[tap])).collect();
        (Self { sources, taps_len: left.len(), in_positions: self.in_positions }, left)
    }

    /// The table of the backward pass: each *input* position finds the output position that reads it through
    /// each tap.
    #[must_use]
    pub fn transposed(&self) -> Self {
        let mut sources = vec![DEAD; self.in_positions * self.taps_len];
        for position in 0..self.out_positions() {
            for (tap, source) in self.live_at(position) {
                sources[source * self.taps_len + tap] = position as u32;
            }
        }
        Self { sources, taps_len: self.taps_len, in_positions: self.out_positions() }
    }

    /// The input positions of an output position's taps.
    fn sources(&self, position: usize) -> &[u32] {
        &self.sources[position * self.taps_len..][..self.taps_len]
    }

    /// Pairs of output position and tap that see input.
    #[must_use]
    pub fn live_len(&self) -> usize {
        self.sources.iter().filter(|&&source| source != DEAD).count()
    }
}

/// How output rows find their input.
#[derive(Clone, Copy)]
pub enum Gather<'a> {
    /// Row q lies at q · stride.
    Rows {
        /// Floats from one row to the next.
        stride: usize,
    },
    /// Row q is column q of a matrix: the product with its transpose.
    Columns {
        /// Floats from one row of the matrix to the next.
        stride: usize,
    },
    /// Row q is output position q / images of image q % images; the input is \[position, image, channel\].
    Taps {
        /// The convolution's table.
        taps: &'a Taps,
        /// Images in the batch.
        images_len: usize,
        /// A row of zeros, as long as an input row.
        zeros: &'a [f32],
    },
}

/// One product; see the module.
pub struct Product<'a> {
    /// The rows that are gathered.
    pub input: &'a [f32],
    /// How an output row finds its input.
    pub gather: Gather<'a>,
    /// The matrix, with the bias.
    pub panels: &'a Panels,
    /// Added before the ReLU; the layout of `out`.
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
    /// Where the slices do not fit one another.
    pub fn run(self) {
        let stride = self.panels.out_stride();
        let rows_len = self.out.len() / stride;
        assert_eq!(self.out.len(), rows_len * stride, "whole rows of output");
        assert!(self.residual.is_none_or(|r| r.len() == self.out.len()), "residual like output");
        if rows_len == 0 {
            return;
        }
        match self.gather {
            Gather::Rows { stride } => {
                assert_eq!(self.panels.taps_len, 1);
                let last = (rows_len - 1).checked_mul(stride);
                let end = last.and_then(|last| last.checked_add(self.panels.in_len));
                assert!(end.is_some_and(|end| end <= self.input.len()), "rows of input");
            }
            Gather::Columns { stride } => {
                assert_eq!(self.panels.taps_len, 1);
                let last = (self.panels.in_len - 1).checked_mul(stride);
                let end = last.and_then(|last| last.checked_add(rows_len));
                assert!(end.is_some_and(|end| end <= self.input.len()), "columns of input");
            }
            Gather::Taps { taps, images_len, zeros } => {
                assert_eq!(self.panels.taps_len, taps.taps_len);
                assert_eq!(taps.out_positions().checked_mul(images_len), Some(rows_len), "rows of output");
                let in_rows = taps.in_positions.checked_mul(images_len);
                let len = in_rows.and_then(|rows| rows.checked_mul(self.panels.in_len));
                assert!(len.is_some_and(|len| len <= self.input.len()), "input maps");
                assert!(zeros.len() >= self.panels.in_len);
            }
        }
        dispatch(Checked { product: self, rows_len });
    }
}

/// A product whose slices fit one another.
struct Checked<'a> {
    product: Product<'a>,
    rows_len: usize,
}

/// The live taps of a register tile of R rows.
struct Tile<const R: usize> {
    /// Input rows of each live tap.
    rows: [[*const f32; R]; TAPS_MAX],
    /// The live taps.
    taps: [usize; TAPS_MAX],
    live_len: usize,
}

impl<const R: usize> Tile<R> {
    const fn new() -> Self {
        Self { rows: [[std::ptr::null(); R]; TAPS_MAX], taps: [0; TAPS_MAX], live_len: 0 }
    }

    #[inline(always)]
    fn push(&mut self, tap: usize, rows: [*const f32; R]) {
        self.rows[self.live_len] = rows;
        self.taps[self.live_len] = tap;
        self.live_len += 1;
    }
}

impl Kernel for Checked<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self, lanes: L) {
        if let Gather::Columns { .. } = self.product.gather {
            self.panels::<L, true>(lanes);
        } else {
            self.panels::<L, false>(lanes);
        }
    }
}

impl Checked<'_> {
    /// All rows of all columns; `ACROSS` where the input rows are columns of a matrix.
    ///
    /// The tile keeps R × V vectors in registers: enough to hide the latency of the multiply-adds, and few
    /// enough loads for each of them.
    #[inline(always)]
    fn panels<L: Lanes, const ACROSS: bool>(&mut self, lanes: L) {
        let panels_len = self.product.panels.panels_len;
        let mut panel = 0;
        if L::LEN == PANEL {
            while panel + 2 <= panels_len {
                self.columns::<L, 12, 2, ACROSS>(lanes, panel);
                panel += 2;
            }
            if panel < panels_len {
                self.columns::<L, 12, 1, ACROSS>(lanes, panel);
            }
        } else {
            for panel in 0..panels_len {
                if L::LEN == 8 {
                    self.columns::<L, 6, 2, ACROSS>(lanes, panel);
                } else {
                    self.columns::<L, 6, 4, ACROSS>(lanes, panel);
                }
            }
        }
    }

    /// All rows of V vectors of columns, from `panel` on.
    #[inline(always)]
    fn columns<L: Lanes, const R: usize, const V: usize, const ACROSS: bool>(
        &mut self,
        lanes: L,
        panel: usize,
    ) {
        let mut row = 0;
        row = self.tiles::<L, R, V, ACROSS>(lanes, panel, row);
        row = self.tiles::<L, 8, V, ACROSS>(lanes, panel, row);
        row = self.tiles::<L, 4, V, ACROSS>(lanes, panel, row);
        row = self.tiles::<L, 2, V, ACROSS>(lanes, panel, row);
        self.tiles::<L, 1, V, ACROSS>(lanes, panel, row);
    }

    /// As many whole tiles of R rows as there are from `row` on; returns the first row that is left.
    #[inline(always)]
    fn tiles<L: Lanes, const R: usize, const V: usize, const ACROSS: bool>(
        &mut self,
        lanes: L,
        panel: usize,
        mut row: usize,
    ) -> usize {
        if row + R > self.rows_len {
            return row;
        }
        let mut tile = Tile::<R>::new();
        while row + R <= self.rows_len {
            self.gather(row, &mut tile);
            // SAFETY: `Product::run` has checked that input, panels and output hold what the tile addresses.
            unsafe { self.multiply::<L, R, V, ACROSS>(lanes, panel, row, &tile) };
            row += R;
        }
        row
    }

    /// Finds the input rows of a tile.
    #[inline(always)]
    fn gather<const R: usize>(&self, row: usize, tile: &mut Tile<R>) {
        let input = self.product.input.as_ptr();
        let in_len = self.product.panels.in_len;
        match self.product.gather {
            Gather::Rows { stride } => {
                tile.live_len = 0;
                tile.push(0, rows_from(input.wrapping_add(row * stride), stride));
            }
            Gather::Columns { .. } => {
                tile.live_len = 0;
                tile.push(0, rows_from(input.wrapping_add(row), 1));
            }
            Gather::Taps { taps, images_len, zeros } => {
                tile.live_len = 0;
                let (position, image) = (row / images_len, row % images_len);
                if image + R <= images_len {
                    let sources = taps.sources(position).iter().enumerate().filter(|(_, s)| **s != DEAD);
                    for (tap, &source) in sources {
                        let first = (source as usize * images_len + image) * in_len;
                        tile.push(tap, rows_from(input.wrapping_add(first), in_len));
                    }
                    return;
                }
                let places = places::<R>(position, image, images_len);
                for tap in 0..taps.taps_len {
                    let mut rows = [zeros.as_ptr(); R];
                    let mut live = false;
                    for (from, (position, image)) in rows.iter_mut().zip(places) {
                        let source = taps.sources[position * taps.taps_len + tap];
                        if source != DEAD {
                            *from = input.wrapping_add((source as usize * images_len + image) * in_len);
                            live = true;
                        }
                    }
                    if live {
                        tile.push(tap, rows);
                    }
                }
            }
        }
    }

    /// # Safety
    /// The tile's rows hold `in_len` floats each, as far apart as the gather gives; panels, residual and
    /// output hold the columns and rows addressed.
    #[inline(always)]
    unsafe fn multiply<L: Lanes, const R: usize, const V: usize, const ACROSS: bool>(
        &mut self,
        l: L,
        panel: usize,
        row: usize,
        tile: &Tile<R>,
    ) {
        let Panels { values, bias, in_len, .. } = self.product.panels;
        let panel_len = self.product.panels.panel_len();
        let stride = self.product.panels.out_stride();
        let per_panel = PANEL / L::LEN;
        let weights = values.as_ptr().wrapping_add(panel * panel_len);
        let step = match self.product.gather {
            Gather::Columns { stride } if ACROSS => stride,
            _ => 1,
        };
        let mut sums = [[l.splat(0.0); V]; R];
        for live in 0..tile.live_len {
            let rows = tile.rows[live];
            let weights = weights.wrapping_add(tile.taps[live] * in_len * PANEL);
            for c in 0..*in_len {
                let mut w = [l.splat(0.0); V];
                for (v, w) in w.iter_mut().enumerate() {
                    let offset = (v / per_panel) * panel_len + c * PANEL + (v % per_panel) * L::LEN;
                    // SAFETY: within the panels.
                    *w = unsafe { l.load_from(weights.wrapping_add(offset)) };
                }
                for (row, sums) in rows.iter().zip(&mut sums) {
                    // SAFETY: the caller vouches for `in_len` floats in each row.
                    let x = l.splat(unsafe { *row.wrapping_add(c * step) });
                    for (sum, w) in sums.iter_mut().zip(&w) {
                        *sum = l.fma(x, *w, *sum);
                    }
                }
            }
        }
        for (r, sums) in sums.iter().enumerate() {
            for (v, sum) in sums.iter().enumerate() {
                let column = panel * PANEL + v * L::LEN;
                let place = (row + r) * stride + column;
                // SAFETY: within the bias, which has a value for each column.
                let mut y = l.add(*sum, unsafe { l.load_from(bias.as_ptr().wrapping_add(column)) });
                if let Some(residual) = self.product.residual {
                    // SAFETY: the residual has the output's length.
                    y = l.add(y, unsafe { l.load_from(residual.as_ptr().wrapping_add(place)) });
                }
                if self.product.relu {
                    y = l.max(y, l.splat(0.0));
                }
                // SAFETY: within the output.
                unsafe { l.store_to(self.product.out.as_mut_ptr().wrapping_add(place), y) };
            }
        }
    }
}

/// Position and image of R consecutive rows.
#[inline(always)]
fn places<const R: usize>(mut position: usize, mut image: usize, images_len: usize) -> [(usize, usize); R] {
    let mut places = [(0, 0); R];
    for place in &mut places {
        *place = (position, image);
        image += 1;
        if image == images_len {
            (position, image) = (position + 1, 0);
        }
    }
    places
}

/// R rows that lie `stride` floats apart.
#[inline(always)]
fn rows_from<const R: usize>(start: *const f32, stride: usize) -> [*const f32; R] {
    let mut rows = [start; R];
    for (r, row) in rows.iter_mut().enumerate() {
        *row = start.wrapping_add(r * stride);
    }
    rows
}
