//! The context map beneath a scene: how often each place was visited, and how fast.

use std::collections::BTreeMap;

use scene::ContextMap;

use super::canvas::{Canvas, Path, Stroke};
use super::colour::{Colour, GREY, WHITE, mixed};
use super::contour::{Raster, simplified};
use super::view::View;

/// The darkest ground: what was visited most.
const BUSY: Colour = Colour([122, 138, 158]);
/// Levels of ln(1 + B/B̄) at which the ground becomes darker: from next to nothing to twelve times the mean.
const LEVELS: [f64; 8] = [0.08, 0.25, 0.5, 0.8, 1.15, 1.55, 2.0, 2.5];
/// Nodes that a cell of the map is split into along each axis.
const SPLIT: usize = 3;
/// Least distance between arrows on paper, pt.
const ARROW_SPACING: f64 = 11.0;
/// Speed below which ground has no direction.
const ARROW_SPEED_MIN_MPS: f64 = 0.2;

/// The colours of the ground from seldom to often visited.
pub fn ramp() -> impl ExactSizeIterator<Item = Colour> {
    (0..LEVELS.len()).map(|level| mixed(WHITE, BUSY, (level + 1) as f64 / LEVELS.len() as f64))
}

/// Draws how often places were visited.
pub fn draw_density(canvas: &mut Canvas, view: &View, map: &ContextMap) {
    let Some(raster) = smooth(map, view) else { return };
    for (level, colour) in LEVELS.into_iter().zip(ramp()) {
        let mut path = Path::default();
        for line in raster.contours(level) {
            let spots: Vec<_> = line.into_iter().map(|place| view.spot(place)).collect();
            path.add_line(simplified(&spots, 0.05));
            path.close();
        }
        canvas.fill(&path, colour, 1.0);
    }
}

/// The map's ln(1 + B/B̄) around the view as a cubic B-spline over the cells, which smooths by about one cell.
fn smooth(map: &ContextMap, view: &View) -> Option<Raster> {
    let densities: Vec<f64> = map.density().map(f64::from).collect();
    let (sum, visited) = densities
        .iter()
        .filter(|density| **density > 0.0)
        .fold((0.0, 0.0), |(sum, visited), density| (sum + density, visited + 1.0));
    let [cols, rows] = cells_within(map, view)?;
    let relative = |row: isize, col: isize| {
        let inside = (0..map.rows() as isize).contains(&row) && (0..map.cols() as isize).contains(&col);
        if inside {
            (densities[row as usize * map.cols() + col as usize] * visited / sum).ln_1p()
        } else {
            0.0
        }
    };
    let nodes = [rows.len(), cols.len()].map(|cells| cells * SPLIT + 1);
    let corner = [cols.start, rows.start].map(|cell| cell as f64 + 0.5);
    let mut raster = Raster {
        origin: [0, 1].map(|axis| f64::from(map.origin_m()[axis]) + corner[axis]),
        spacing_m: 1.0 / SPLIT as f64,
        rows: nodes[0],
        cols: nodes[1],
        values: vec![0.0; nodes[0] * nodes[1]],
    };
    for row in 0..raster.rows {
        let (first_row, across) = spline(rows.start, row);
        for col in 0..raster.cols {
            let (first_col, along) = spline(cols.start, col);
            let weighted = |(i, weight): (isize, f64)| -> f64 {
                let of_row = (0..4).zip(along).map(|(j, w)| w * relative(first_row + i, first_col + j));
                weight * of_row.sum::<f64>()
            };
            raster.values[row * raster.cols + col] = (0..4).zip(across).map(weighted).sum();
        }
    }
    Some(raster)
}

/// Columns and rows of cells in and a little around the view; none where it lies beside the map.
fn cells_within(map: &ContextMap, view: &View) -> Option<[std::ops::Range<isize>; 2]> {
    let (low, high) = view.corners();
    let ranges = [(0, map.cols()), (1, map.rows())].map(|(axis, len)| {
        let cell = |place: f64| (place - f64::from(map.origin_m()[axis])).floor() as isize;
        // The spline reaches two cells beyond the map; the outermost nodes of a raster count as 0.
        let (first, last) = (cell(low[axis]) - 3, cell(high[axis]) + 3);
        first.max(-3)..last.min(len as isize + 3)
    });
    ranges.iter().all(|range| range.start < range.end).then_some(ranges)
}

/// The first of the four cells that a node depends on, and the weights of all four.
fn spline(first_cell: isize, node: usize) -> (isize, [f64; 4]) {
    let share = (node % SPLIT) as f64 / SPLIT as f64;
    let rest = 1.0 - share;
    let weights = [
        rest.powi(3) / 6.0,
        2.0 / 3.0 - share * share * (1.0 - share / 2.0),
        2.0 / 3.0 - rest * rest * (1.0 - rest / 2.0),
        share.powi(3) / 6.0,
    ];
    (first_cell + (node / SPLIT) as isize - 1, weights)
}

/// A stretch of ground with how it was passed.
struct Passage {
    /// Where its visits were on average.
    place: [f64; 2],
    velocity_mps: [f64; 2],
    speed_mps: f64,
}

/// Draws how fast places were passed, as arrows; the longest is the fastest.
pub fn draw_velocity(canvas: &mut Canvas, view: &View, map: &ContextMap) {
    let block = ((ARROW_SPACING / view.scale()).ceil() as usize).max(1);
    let passages = passages(map, view, block);
    let fastest_mps = passages.iter().map(|passage| passage.speed_mps).fold(0.0, f64::max);
    let longest = 0.95 * block as f64 * view.scale();
    for Passage { place, velocity_mps: [vx, vy], speed_mps } in passages {
        let way = [vx / speed_mps, -vy / speed_mps];
        draw_arrow(canvas, view.spot(place), way, longest * (speed_mps / fastest_mps).max(0.2));
    }
}

/// The mean passage of each square block of cells in view that was passed at some speed.
fn passages(map: &ContextMap, view: &View, block: usize) -> Vec<Passage> {
    let Some([cols, rows]) = cells_within(map, view) else { return Vec::new() };
    let cells = map.density().zip(map.velocity_mps()).enumerate();
    // Blocks start at whole multiples, so that panels of one map show the same arrows.
    let mut sums: BTreeMap<[usize; 2], [f64; 5]> = BTreeMap::new();
    for (index, (density, [vx, vy])) in cells.filter(|(_, (density, _))| *density > 0.0) {
        let (row, col) = (index / map.cols(), index % map.cols());
        if !rows.contains(&(row as isize)) || !cols.contains(&(col as isize)) {
            continue;
        }
        let sum = sums.entry([row / block, col / block]).or_default();
        let of_cell = [1.0, col as f64 + 0.5, row as f64 + 0.5, f64::from(vx), f64::from(vy)];
        for (sum, value) in sum.iter_mut().zip(of_cell) {
            *sum += f64::from(density) * value;
        }
    }
    let passage = |[visits, x, y, vx, vy]: [f64; 5]| Passage {
        place: [0, 1].map(|axis| f64::from(map.origin_m()[axis]) + [x, y][axis] / visits),
        velocity_mps: [vx / visits, vy / visits],
        speed_mps: (vx / visits).hypot(vy / visits),
    };
    let passages = sums.into_values().map(passage);
    passages.filter(|passage| passage.speed_mps >= ARROW_SPEED_MIN_MPS).collect()
}

fn draw_arrow(canvas: &mut Canvas, [x, y]: [f64; 2], [cos, sin]: [f64; 2], length: f64) {
    let at = |along: f64, across: f64| [x + along * cos - across * sin, y + along * sin + across * cos];
    let (tip, head) = (length / 2.0, (0.35 * length).min(2.2));
    let mut path = Path::line([at(-tip, 0.0), at(tip, 0.0)]);
    path.add_line([at(tip - head, -0.5 * head), at(tip, 0.0), at(tip - head, 0.5 * head)]);
    canvas.stroke(&path, &Stroke::solid(GREY, 0.4).faint(0.7));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spline_is_an_average() {
        for node in 0..2 * SPLIT {
            let (_, weights) = spline(-4, node);
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{weights:?}");
            assert!(weights.iter().all(|weight| *weight >= 0.0));
        }
        assert_eq!(spline(-4, SPLIT).0, spline(-4, 0).0 + 1);
    }

    #[test]
    fn the_ground_becomes_darker_with_each_level() {
        let sums: Vec<u32> = ramp().map(|colour| colour.0.iter().map(|c| u32::from(*c)).sum()).collect();
        assert!(sums.windows(2).all(|pair| pair[0] > pair[1]), "{sums:?}");
    }
}
