use super::ContextMap;

/// Largest number of cells in a map: a square of 2 km.
pub const CELLS_MAX: usize = 1 << 22;

#[derive(Clone, Copy, Default)]
struct Sums {
    visits: u64,
    velocity_mps: [f64; 2],
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
