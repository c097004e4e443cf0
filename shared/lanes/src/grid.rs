//! Finds the lanes near a position.

use std::collections::BTreeMap;

use crate::Lane;

/// Side of a cell.
const CELL_M: f32 = 8.0;

/// Lanes by the cells that their middle crosses.
#[derive(Clone, Debug)]
pub(crate) struct Grid {
    cells: BTreeMap<[i32; 2], Vec<u32>>,
}

impl Grid {
    pub(crate) fn of(lanes: &[Lane]) -> Self {
        let mut cells: BTreeMap<[i32; 2], Vec<u32>> = BTreeMap::new();
        for (place, lane) in lanes.iter().enumerate() {
            for &point_m in &lane.centre_m {
                let of_cell = cells.entry(cell(point_m)).or_default();
                if of_cell.last() != Some(&(place as u32)) {
                    of_cell.push(place as u32);
                }
            }
        }
        Self { cells }
    }

    /// Writes the lanes of all cells within `reach_m` of a position, each once, in order.
    pub(crate) fn near(&self, position_m: [f32; 2], reach_m: f32, found: &mut Vec<u32>) {
        found.clear();
        let [low, high] = [-reach_m, reach_m].map(|by| cell(position_m.map(|x| x + by)));
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                let lanes = self.cells.get(&[x, y]).into_iter().flatten();
                // Stays within the reserved capacity, so that a tick does not allocate.
                lanes.for_each(|&lane| {
                    if found.len() < found.capacity() {
                        found.push(lane);
                    }
                });
            }
        }
        found.sort_unstable();
        found.dedup();
    }
}

fn cell(position_m: [f32; 2]) -> [i32; 2] {
    position_m.map(|x| (x / CELL_M).floor() as i32)
}
