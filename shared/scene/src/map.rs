//! The global context map and the local patches cut from it.
//!
//! A map has cells of 1 m × 1 m with two fields. The *density* B is the share of all visits that fell into
//! the cell. The *mean velocity* VF is the mean over these visits. The fields show the positions of lanes and
//! paths. A [`ContextMap`] is built offline from training tracks ([`MapBuilder`]) and read from a file. An
//! [`OnlineMap`] grows from the observations so far and follows the ego. A *patch* is a small window of
//! either map, placed and turned with an agent. \[paper, App. A; model §2\]

mod build;
mod file;
mod online;
mod patch;

pub use build::{CELLS_MAX, MapBuilder, extent};
pub use online::{ONLINE_SIDE, OnlineMap};
pub use patch::PatchOptions;

use patch::{CHANNEL_LANES, Cells};

use crate::State;

/// A complete map: row = y, column = x, lower left corner at its origin.
#[derive(Clone, Debug, PartialEq)]
pub struct ContextMap {
    origin_m: [f32; 2],
    rows: usize,
    cols: usize,
    /// \[ln(1 + B/B̄), VF x, VF y, B\] of each cell, row-major.
    cells: Vec<[f32; CHANNEL_LANES]>,
}

impl ContextMap {
    /// The map of the given densities and velocities (x, y), row-major. B̄ is the mean of the non-zero
    /// densities.
    fn new(
        origin_m: [f32; 2],
        cols: usize,
        density: impl ExactSizeIterator<Item = f32> + Clone,
        velocity_mps: impl Iterator<Item = [f32; 2]>,
    ) -> Self {
        let (mut sum, mut occupied) = (0.0_f64, 0.0_f64);
        for visited in density.clone().filter(|b| *b > 0.0) {
            sum += f64::from(visited);
            occupied += 1.0;
        }
        let per_mean = if sum > 0.0 { (occupied / sum) as f32 } else { 0.0 };
        let rows = density.len() / cols.max(1);
        let cells =
            density.zip(velocity_mps).map(|(b, [vx, vy])| [(b * per_mean).ln_1p(), vx, vy, b]).collect();
        Self { origin_m, rows, cols, cells }
    }

    /// Lower left corner of cell (0, 0) in the world frame.
    pub const fn origin_m(&self) -> [f32; 2] {
        self.origin_m
    }

    /// Cells along y.
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// Cells along x.
    pub const fn cols(&self) -> usize {
        self.cols
    }

    /// B of each cell, row-major. The sum is 1, or 0 if nothing was ever visited.
    pub fn density(&self) -> impl ExactSizeIterator<Item = f32> + '_ {
        self.cells.iter().map(|cell| cell[3])
    }

    /// ln(1 + B/B̄) of each cell, row-major: the density as the network sees it.
    pub fn visits(&self) -> impl ExactSizeIterator<Item = f32> + '_ {
        self.cells.iter().map(|cell| cell[0])
    }

    /// VF (x, y) of each cell, row-major, m/s.
    pub fn velocity_mps(&self) -> impl ExactSizeIterator<Item = [f32; 2]> + '_ {
        self.cells.iter().map(|cell| [cell[1], cell[2]])
    }

    /// Writes the patch of an agent, \[channel, row, column\], with zeros outside the map.
    ///
    /// # Panics
    /// If `out` does not have the length of the patch.
    pub fn patch(&self, state: &State, options: PatchOptions, out: &mut [f32]) {
        patch::sample(self, state, options, out);
    }
}

impl Cells for ContextMap {
    fn origin_m(&self) -> [f32; 2] {
        self.origin_m
    }

    fn size(&self) -> [usize; 2] {
        [self.rows, self.cols]
    }

    fn cell(&self, row: usize, col: usize) -> [f32; CHANNEL_LANES] {
        self.cells[row * self.cols + col]
    }
}
