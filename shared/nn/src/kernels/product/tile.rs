//! The register tile: R rows × V vectors of sums that stay in registers over the whole chain.
//!
//! | set | registers | tile | sums |
//! |---|---:|---|---:|
//! | AVX-512 | 32 | 12 rows × 2 vectors of two panels | 24 |
//! | AVX2 | 16 | 6 rows × 2 vectors of one panel | 12 |
//! | NEON | 32 | 6 rows × 4 vectors of one panel | 24 |
//! | portable | 16 | 3 rows × 4 vectors of one panel | 12 |
//!
//! Besides the sums, a tile needs V vectors of weights and the row's number in all lanes. Everything must fit
//! into the set's registers: with one more sum, the compiler moves sums to the stack and back in each step.
//! There must also be enough sums to hide the latency of the multiply-adds. Most processors run two
//! multiply-adds at a time.
//!
//! Rows that do not fill a whole tile get a smaller one. At most half the columns of the last panel may be
//! outputs, as in the decoder's head. The panel's tile then has half the vectors and up to twice the rows.
//! AVX-512 is an exception, because one vector is a panel.

#![expect(unsafe_code, reason = "the register tile reads through pointers")]

use super::shape::{DEAD, Gather, PANEL, Panels, Product, TAPS_MAX};
use crate::kernels::{Kernel, Lanes};

/// A product whose slice lengths match.
pub(super) struct Checked<'a> {
    pub(super) product: Product<'a>,
    pub(super) row_count: usize,
}

/// The live taps, at most T, of a register tile of R rows.
struct Tile<const R: usize, const T: usize> {
    /// Input rows of each live tap.
    rows: [[*const f32; R]; T],
    /// The live taps.
    taps: [usize; T],
    live_count: usize,
}

impl<const R: usize, const T: usize> Tile<R, T> {
    const fn new() -> Self {
        Self { rows: [[std::ptr::null(); R]; T], taps: [0; T], live_count: 0 }
    }

    #[inline(always)]
    fn push(&mut self, tap: usize, rows: [*const f32; R]) {
        self.rows[self.live_count] = rows;
        self.taps[self.live_count] = tap;
        self.live_count += 1;
    }
}

impl Kernel for Checked<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(mut self, lanes: L) {
        match self.product.gather {
            Gather::Rows { .. } => self.panels::<L, 1, false>(lanes),
            Gather::Columns { .. } => self.panels::<L, 1, true>(lanes),
            Gather::Taps { .. } => self.panels::<L, TAPS_MAX, false>(lanes),
        }
    }
}

impl Checked<'_> {
    /// All rows of all columns, with at most T taps. `ACROSS` means that the input rows are columns of a
    /// matrix. The module doc has the table of tiles.
    #[inline(always)]
    fn panels<L: Lanes, const T: usize, const ACROSS: bool>(&mut self, l: L) {
        let panel_count = self.product.panels.panel_count;
        let mut panel = 0;
        // No closures: they would be compiled without the set's features.
        while panel < panel_count {
            let is_half = panel + 1 == panel_count && self.product.panels.ends_in_half();
            match (L::LEN, L::REGISTERS) {
                (8, _) if is_half => self.up_to_12::<L, 1, T, ACROSS>(l, panel),
                (4, 32) if is_half => self.up_to_12::<L, 2, T, ACROSS>(l, panel),
                (4, _) if is_half => self.up_to_6::<L, 2, T, ACROSS>(l, panel),
                (PANEL, _) if panel + 2 <= panel_count => {
                    self.up_to_12::<L, 2, T, ACROSS>(l, panel);
                    panel += 1;
                }
                (PANEL, _) => self.up_to_12::<L, 1, T, ACROSS>(l, panel),
                (8, _) => self.up_to_6::<L, 2, T, ACROSS>(l, panel),
                (_, 32) => self.up_to_6::<L, 4, T, ACROSS>(l, panel),
                _ => self.up_to_3::<L, 4, T, ACROSS>(l, panel, 0),
            }
            panel += 1;
        }
    }

    /// All rows of V vectors of columns from `panel`, in tiles of at most 12 rows.
    #[inline(always)]
    fn up_to_12<L: Lanes, const V: usize, const T: usize, const ACROSS: bool>(&mut self, l: L, panel: usize) {
        let mut row = 0;
        row = self.tiles::<L, 12, V, T, ACROSS>(l, panel, row);
        row = self.tiles::<L, 8, V, T, ACROSS>(l, panel, row);
        row = self.tiles::<L, 4, V, T, ACROSS>(l, panel, row);
        row = self.tiles::<L, 2, V, T, ACROSS>(l, panel, row);
        self.tiles::<L, 1, V, T, ACROSS>(l, panel, row);
    }

    /// The same in tiles of at most 6 rows.
    #[inline(always)]
    fn up_to_6<L: Lanes, const V: usize, const T: usize, const ACROSS: bool>(&mut self, l: L, panel: usize) {
        let mut row = 0;
        row = self.tiles::<L, 6, V, T, ACROSS>(l, panel, row);
        row = self.tiles::<L, 5, V, T, ACROSS>(l, panel, row);
        row = self.tiles::<L, 4, V, T, ACROSS>(l, panel, row);
        self.up_to_3::<L, V, T, ACROSS>(l, panel, row);
    }

    /// The same in tiles of at most 3 rows, from `row`.
    #[inline(always)]
    fn up_to_3<L: Lanes, const V: usize, const T: usize, const ACROSS: bool>(
        &mut self,
        l: L,
        panel: usize,
        mut row: usize,
    ) {
        row = self.tiles::<L, 3, V, T, ACROSS>(l, panel, row);
        row = self.tiles::<L, 2, V, T, ACROSS>(l, panel, row);
        self.tiles::<L, 1, V, T, ACROSS>(l, panel, row);
    }

    /// All whole tiles of R rows from `row`; returns the first remaining row.
    #[inline(always)]
    fn tiles<L: Lanes, const R: usize, const V: usize, const T: usize, const ACROSS: bool>(
        &mut self,
        lanes: L,
        panel: usize,
        mut row: usize,
    ) -> usize {
        if row + R > self.row_count {
            return row;
        }
        let mut tile = Tile::<R, T>::new();
        while row + R <= self.row_count {
            self.gather(row, &mut tile);
            // SAFETY: `Product::run` has checked that input, panels and output hold what the tile addresses.
            unsafe { self.multiply::<L, R, V, T, ACROSS>(lanes, panel, row, &tile) };
            row += R;
        }
        row
    }

    /// Finds the input rows of a tile.
    #[inline(always)]
    fn gather<const R: usize, const T: usize>(&self, row: usize, tile: &mut Tile<R, T>) {
        let input = self.product.input.as_ptr();
        let in_len = self.product.panels.in_len;
        match self.product.gather {
            Gather::Rows { stride } => {
                tile.live_count = 0;
                tile.push(0, rows_from(input.wrapping_add(row * stride), stride));
            }
            Gather::Columns { .. } => {
                tile.live_count = 0;
                tile.push(0, rows_from(input.wrapping_add(row), 1));
            }
            Gather::Taps { taps, image_count, zeros } => {
                tile.live_count = 0;
                let (position, image) = (row / image_count, row % image_count);
                if image + R <= image_count {
                    let sources = taps.sources(position).iter().enumerate().filter(|(_, s)| **s != DEAD);
                    for (tap, &source) in sources {
                        let first = (source as usize * image_count + image) * in_len;
                        tile.push(tap, rows_from(input.wrapping_add(first), in_len));
                    }
                    return;
                }
                let places = places::<R>(position, image, image_count);
                for tap in 0..taps.tap_count {
                    let mut rows = [zeros.as_ptr(); R];
                    let mut live = false;
                    for (from, (position, image)) in rows.iter_mut().zip(places) {
                        let source = taps.sources[position * taps.tap_count + tap];
                        if source != DEAD {
                            *from = input.wrapping_add((source as usize * image_count + image) * in_len);
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
    /// The tile's rows contain `in_len` floats each, at the distance of the gather. Panels, residual and
    /// output contain the addressed columns and rows.
    #[inline(always)]
    unsafe fn multiply<L: Lanes, const R: usize, const V: usize, const T: usize, const ACROSS: bool>(
        &mut self,
        l: L,
        panel: usize,
        row: usize,
        tile: &Tile<R, T>,
    ) {
        let Panels { values, bias, in_len, .. } = self.product.panels;
        let panel_len = self.product.panels.panel_len();
        let stride = self.product.panels.out_stride();
        let per_panel = PANEL / L::LEN;
        let step = match self.product.gather {
            Gather::Columns { stride } if ACROSS => stride,
            _ => 1,
        };
        let mut sums = [[l.splat(0.0); V]; R];
        for live in 0..tile.live_count {
            let first = values.as_ptr().wrapping_add(panel * panel_len + tile.taps[live] * in_len * PANEL);
            let mut weights = [first; V];
            for (v, weights) in weights.iter_mut().enumerate() {
                *weights = first.wrapping_add((v / per_panel) * panel_len + (v % per_panel) * L::LEN);
            }
            // SAFETY: the caller vouches for `in_len` floats in each row; the weights lie within the panels.
            sums = unsafe { chain(l, tile.rows[live], weights, *in_len, step, sums) };
        }
        let mut biases = [l.splat(0.0); V];
        let bias = bias.as_ptr().wrapping_add(panel * PANEL);
        for (v, values) in biases.iter_mut().enumerate() {
            // SAFETY: within the bias, which has a value for each column.
            *values = unsafe { l.load_from(bias.wrapping_add(v * L::LEN)) };
        }
        for (r, sums) in sums.iter().enumerate() {
            for (v, (sum, bias)) in sums.iter().zip(&biases).enumerate() {
                let place = (row + r) * stride + panel * PANEL + v * L::LEN;
                let mut y = l.add(*sum, *bias);
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
            for v in V..per_panel {
                let place = (row + r) * stride + panel * PANEL + v * L::LEN;
                // SAFETY: within the output.
                unsafe { l.store_to(self.product.out.as_mut_ptr().wrapping_add(place), l.splat(0.0)) };
            }
        }
    }
}

/// Continues the sums of a tile: `len` multiply-adds each, in order, [`Lanes::STEPS`] per pass of the loop. A
/// tile of one vector has many rows per step and does one multiply-add per pass: with more, the compiler
/// mixes the rows and runs out of registers.
///
/// This separate function takes and returns the sums by value, so that each sum stays in its register. The
/// test of the emitted code checks this.
///
/// # Safety
/// Each of the rows is valid for reading a float at every `step`, each of the weights for a vector at every
/// [`PANEL`], `len` times.
#[inline(always)]
unsafe fn chain<L: Lanes, const R: usize, const V: usize>(
    l: L,
    rows: [*const f32; R],
    weights: [*const f32; V],
    len: usize,
    step: usize,
    mut sums: [[L::V; V]; R],
) -> [[L::V; V]; R] {
    let steps = if V == 1 { 1 } else { L::STEPS };
    let mut c = 0;
    while c + steps <= len {
        let (rows, weights) = (ahead(rows, c * step), ahead(weights, c * PANEL));
        for k in 0..steps {
            // SAFETY: the caller vouches for steps below `len`.
            sums = unsafe { link(l, ahead(rows, k * step), ahead(weights, k * PANEL), sums) };
        }
        c += steps;
    }
    while c < len {
        // SAFETY: the caller vouches for steps below `len`.
        sums = unsafe { link(l, ahead(rows, c * step), ahead(weights, c * PANEL), sums) };
        c += 1;
    }
    sums
}

/// One multiply-add for each sum of a tile.
///
/// # Safety
/// Each of the rows is valid for reading a float, each of the weights for reading a vector.
#[inline(always)]
unsafe fn link<L: Lanes, const R: usize, const V: usize>(
    l: L,
    rows: [*const f32; R],
    weights: [*const f32; V],
    mut sums: [[L::V; V]; R],
) -> [[L::V; V]; R] {
    let mut w = [l.splat(0.0); V];
    for (w, weights) in w.iter_mut().zip(weights) {
        // SAFETY: the caller vouches for them.
        *w = unsafe { l.load_from(weights) };
    }
    for (row, sums) in rows.into_iter().zip(&mut sums) {
        // SAFETY: the caller vouches for the rows.
        let x = l.splat(unsafe { *row });
        for (sum, w) in sums.iter_mut().zip(&w) {
            *sum = l.fma(x, *w, *sum);
        }
    }
    sums
}

/// The pointers, advanced by a number of floats.
#[inline(always)]
fn ahead<const N: usize>(mut pointers: [*const f32; N], by: usize) -> [*const f32; N] {
    for pointer in &mut pointers {
        *pointer = pointer.wrapping_add(by);
    }
    pointers
}

/// Position and image of R consecutive rows.
#[inline(always)]
fn places<const R: usize>(mut position: usize, mut image: usize, image_count: usize) -> [(usize, usize); R] {
    let mut places = [(0, 0); R];
    for place in &mut places {
        *place = (position, image);
        image += 1;
        if image == image_count {
            (position, image) = (position + 1, 0);
        }
    }
    places
}

/// R rows at a distance of `stride` floats.
#[inline(always)]
fn rows_from<const R: usize>(start: *const f32, stride: usize) -> [*const f32; R] {
    let mut rows = [start; R];
    for (r, row) in rows.iter_mut().enumerate() {
        *row = start.wrapping_add(r * stride);
    }
    rows
}
