use super::ContextMap;
use crate::State;

/// Largest number of cells in a map: a square of 2 km.
pub const CELLS_MAX: usize = 1 << 22;

#[derive(Clone, Copy, Default)]
struct Sums {
    visits: u64,
    velocity_mps: [f64; 2],
}

/// The ground that positions cover: its lower left corner in whole metres, and its numbers of cells along x
/// and y. `None` if there are no positions.
pub fn extent(positions_m: impl IntoIterator<Item = [f32; 2]>) -> Option<([f32; 2], [usize; 2])> {
    let mut positions_m = positions_m.into_iter();
    let first = positions_m.next()?;
    let (low, high) = positions_m.fold((first, first), |(low, high), position| {
        let extreme =
            |of: [f32; 2], pick: fn(f32, f32) -> f32| [0, 1].map(|axis| pick(of[axis], position[axis]));
        (extreme(low, f32::min), extreme(high, f32::max))
    });
    let origin_m = low.map(f32::floor);
    Some((origin_m, [0, 1].map(|axis| (high[axis] - origin_m[axis]) as usize + 1)))
}

/// Adds up the visits of a map.
#[derive(Clone)]
pub struct MapBuilder {
    origin_m: [f32; 2],
    rows: usize,
    cols: usize,
    sums: Vec<Sums>,
}

impl MapBuilder {
    /// A map without visits, with its lower left corner at `origin_m`. Returns `None` if it has more than
    /// [`CELLS_MAX`] cells.
    #[must_use]
    pub fn new(origin_m: [f32; 2], rows: usize, cols: usize) -> Option<Self> {
        let cell_count = rows.checked_mul(cols).filter(|len| *len <= CELLS_MAX)?;
        Some(Self { origin_m, rows, cols, sums: vec![Sums::default(); cell_count] })
    }

    /// Counts one visit: an agent at a position with a velocity. A visit outside the map is dropped. Returns
    /// whether the visit was counted.
    pub fn visit(&mut self, position_m: [f32; 2], velocity_mps: [f32; 2]) -> bool {
        let [col, row] = [0, 1].map(|axis| f64::from(position_m[axis]) - f64::from(self.origin_m[axis]));
        let inside = |index: f64, len: usize| index >= 0.0 && index < len as f64;
        if !inside(row, self.rows) || !inside(col, self.cols) {
            return false;
        }
        let cell = &mut self.sums[row as usize * self.cols + col as usize];
        cell.visits += 1;
        cell.velocity_mps = [0, 1].map(|axis| cell.velocity_mps[axis] + f64::from(velocity_mps[axis]));
        true
    }

    /// The map of all visits.
    pub fn build(&self) -> ContextMap {
        let total = self.sums.iter().map(|cell| cell.visits).sum::<u64>().max(1) as f64;
        let density = self.sums.iter().map(|cell| (cell.visits as f64 / total) as f32);
        let velocity =
            self.sums.iter().map(|cell| cell.velocity_mps.map(|v| (v / cell.visits.max(1) as f64) as f32));
        ContextMap::new(self.origin_m, self.cols, density, velocity)
    }
}

impl ContextMap {
    /// The map of one visit per state. `None` if there are no states or they span more than a map holds.
    #[must_use]
    pub fn of_visits(states: &[State]) -> Option<Self> {
        let (origin_m, [cols, rows]) = extent(states.iter().map(|state| state.position_m))?;
        let mut builder = MapBuilder::new(origin_m, rows, cols)?;
        for state in states {
            builder.visit(state.position_m, state.velocity_mps);
        }
        Some(builder.build())
    }
}
