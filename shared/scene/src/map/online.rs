use super::patch::{self, CHANNEL_LANES, Cells, PatchOptions};
use crate::State;

/// Cells along each side of an online map.
pub const ONLINE_SIDE: usize = 512;

/// The window moves once its centre is this far from the ego, in cells.
const SLACK: i32 = ONLINE_SIDE as i32 / 4;
/// Number of visits for which the density channel is tabulated.
const TABULATED: usize = 256;

#[derive(Clone, Copy, Default)]
struct Cell {
    visits: u32,
    velocity_mps: [f32; 2],
}

/// A map of the observations so far. It is causal by construction: a patch shows only visits added before it
/// was cut.
///
/// Memory is bounded, because the map is a window of [`ONLINE_SIDE`]² cells around the ego. Cells that leave
/// the window are cleared. Cells are aligned to whole metres of the world frame and stored modulo the
/// window's side. Moving the window therefore clears the strips that leave and copies nothing.
#[derive(Clone)]
pub struct OnlineMap {
    cells: Vec<Cell>,
    /// World cell (column, row) of the window's lower left corner.
    corner: [i32; 2],
    placed: bool,
    visits: u64,
    occupied: u64,
    /// ln(1 + B/B̄) of a cell, indexed by its visits.
    channel: [f32; TABULATED],
}

impl Default for OnlineMap {
    fn default() -> Self {
        Self::new()
    }
}

impl OnlineMap {
    /// A map without visits. The first call of [`OnlineMap::observe`] places it.
    #[must_use]
    pub fn new() -> Self {
        Self {
            cells: vec![Cell::default(); ONLINE_SIDE * ONLINE_SIDE],
            corner: [0; 2],
            placed: false,
            visits: 0,
            occupied: 0,
            channel: [0.0; TABULATED],
        }
    }

    /// Adds the visits (position, velocity) of a tick, with the ego at `ego_m`. Visits outside the window are
    /// dropped.
    pub fn observe(&mut self, ego_m: [f32; 2], visits: impl Iterator<Item = ([f32; 2], [f32; 2])>) {
        self.follow(ego_m);
        for (position_m, velocity_mps) in visits {
            self.visit(position_m, velocity_mps);
        }
        for visits in 0..TABULATED {
            self.channel[visits] = self.relative_density(visits as u32);
        }
    }

    /// Writes the patch of an agent, \[channel, row, column\], with zeros where nothing was observed.
    ///
    /// # Panics
    /// If `out` does not have the length of the patch.
    pub fn patch(&self, state: &State, options: PatchOptions, out: &mut [f32]) {
        patch::sample(self, state, options, out);
    }

    fn visit(&mut self, position_m: [f32; 2], velocity_mps: [f32; 2]) {
        let [col, row] = [0, 1].map(|axis| world_cell(position_m[axis]).wrapping_sub(self.corner[axis]));
        let inside = |index: i32| (0..ONLINE_SIDE as i32).contains(&index);
        if !inside(row) || !inside(col) {
            return;
        }
        let slot = self.slot(row as usize, col as usize);
        let cell = &mut self.cells[slot];
        self.occupied += u64::from(cell.visits == 0);
        self.visits += u64::from(cell.visits < u32::MAX);
        cell.visits = cell.visits.saturating_add(1);
        let share = 1.0 / cell.visits as f32;
        for (mean, new) in cell.velocity_mps.iter_mut().zip(velocity_mps) {
            *mean += (new - *mean) * share;
        }
    }

    /// ln(1 + B/B̄), with B = visits / all visits and B̄ = 1 / occupied cells.
    fn relative_density(&self, visits: u32) -> f32 {
        let per_mean = self.occupied as f64 / self.visits.max(1) as f64;
        (f64::from(visits) * per_mean).ln_1p() as f32
    }

    fn follow(&mut self, ego_m: [f32; 2]) {
        let wanted = ego_m.map(|x| world_cell(x) - ONLINE_SIDE as i32 / 2);
        if !self.placed {
            (self.corner, self.placed) = (wanted, true);
            return;
        }
        for (axis, corner) in wanted.into_iter().enumerate() {
            let shift = corner - self.corner[axis];
            if shift.abs() > SLACK {
                self.clear_strip(axis, shift);
                self.corner[axis] = corner;
            }
        }
    }

    /// Clears the lines that leave when the window moves by `shift` cells along `axis`.
    fn clear_strip(&mut self, axis: usize, shift: i32) {
        let len = (shift.unsigned_abs() as usize).min(ONLINE_SIDE);
        let first = if shift > 0 { 0 } else { ONLINE_SIDE - len };
        for line in first..first + len {
            for along in 0..ONLINE_SIDE {
                let (row, col) = if axis == 0 { (along, line) } else { (line, along) };
                let slot = self.slot(row, col);
                let left = std::mem::take(&mut self.cells[slot]);
                self.visits -= u64::from(left.visits);
                self.occupied -= u64::from(left.visits > 0);
            }
        }
    }

    fn slot(&self, row: usize, col: usize) -> usize {
        let wrap = |index: usize, corner: i32| (corner as usize).wrapping_add(index) % ONLINE_SIDE;
        wrap(row, self.corner[1]) * ONLINE_SIDE + wrap(col, self.corner[0])
    }
}

impl Cells for OnlineMap {
    fn origin_m(&self) -> [f32; 2] {
        self.corner.map(|cell| cell as f32)
    }

    fn size(&self) -> [usize; 2] {
        [ONLINE_SIDE; 2]
    }

    fn cell(&self, row: usize, col: usize) -> [f32; CHANNEL_LANES] {
        let cell = &self.cells[self.slot(row, col)];
        let channel = self.channel.get(cell.visits as usize).copied();
        let channel = channel.unwrap_or_else(|| self.relative_density(cell.visits));
        [channel, cell.velocity_mps[0], cell.velocity_mps[1], 0.0]
    }
}

/// The world cell of a coordinate, clamped to the world.
fn world_cell(coordinate_m: f32) -> i32 {
    coordinate_m.clamp(-wire::POSITION_MAX_M, wire::POSITION_MAX_M).floor() as i32
}
