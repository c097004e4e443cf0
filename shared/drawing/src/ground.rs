//! The context map beneath a scene: how often each place was visited, and at what speed.

use std::collections::BTreeMap;

use metrics::Point;
use scene::ContextMap;

use super::canvas::{Canvas, Stroke};
use super::colour::{Colour, GREY, WHITE, mixed};
use super::contour::{Place, Raster, simplified};
use super::path::Path;
use super::view::View;

/// The darkest ground, for the most visited places.
const BUSY: Colour = Colour([122, 138, 158]);
/// Levels of ln(1 + B/B̄) at which the ground becomes darker. They range from almost 0 to twelve times the
/// mean.
const LEVELS: [f64; 8] = [0.08, 0.25, 0.5, 0.8, 1.15, 1.55, 2.0, 2.5];
/// Approximate maximum number of ground blocks along a panel.
const SHOWN_MAX: f64 = 400.0;
/// Number of nodes per block along each axis.
const SPLIT: usize = 3;
/// Smallest distance between arrows on paper, pt.
const ARROW_SPACING: f64 = 11.0;
/// Speed below which no arrow is drawn.
const ARROW_SPEED_MIN_MPS: f64 = 0.2;

/// The colours of the ground, from rarely to often visited.
pub fn ramp() -> impl ExactSizeIterator<Item = Colour> {
    (0..LEVELS.len()).map(|level| mixed(WHITE, BUSY, (level + 1) as f64 / LEVELS.len() as f64))
}

/// Draws how often each place was visited.
pub fn draw_density(canvas: &mut Canvas, view: &View, map: &ContextMap) {
    let Some(raster) = Blocks::of(map, view).smooth(view) else { return };
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

/// The map's ln(1 + B/B̄). It is averaged over square blocks if the map is finer than the picture.
struct Blocks {
    side_m: f64,
    origin: Place,
    rows: usize,
    cols: usize,
    values: Vec<f64>,
}

impl Blocks {
    fn of(map: &ContextMap, view: &View) -> Self {
        let (low, high) = view.corners();
        let shown = |axis: usize, len: usize| (high[axis] - low[axis]).min(len as f64);
        let longer = shown(0, map.cols()).max(shown(1, map.rows()));
        let side = ((longer / SHOWN_MAX).ceil() as usize).max(1);
        let [rows, cols] = [map.rows(), map.cols()].map(|len| len.div_ceil(side));
        let (mut sum, mut visited) = (0.0, 0.0);
        for density in map.density().filter(|density| *density > 0.0) {
            sum += f64::from(density);
            visited += 1.0;
        }
        let mut values = vec![0.0; rows * cols];
        for (index, density) in map.density().enumerate().filter(|(_, density)| *density > 0.0) {
            let block = index / map.cols() / side * cols + index % map.cols() / side;
            values[block] += (f64::from(density) * visited / sum).ln_1p() / (side * side) as f64;
        }
        Self { side_m: side as f64, origin: map.origin_m().map(f64::from), rows, cols, values }
    }

    /// The value of a block; 0 outside the map.
    fn value(&self, row: isize, col: isize) -> f64 {
        let inside = (0..self.rows as isize).contains(&row) && (0..self.cols as isize).contains(&col);
        if inside { self.values[row as usize * self.cols + col as usize] } else { 0.0 }
    }

    /// The blocks in and slightly around the view as a cubic B-spline, which smooths by about one block.
    /// Returns `None` if the view and the map do not overlap.
    fn smooth(&self, view: &View) -> Option<Raster> {
        let (low, high) = view.corners();
        let [cols, rows] = [(0, self.cols), (1, self.rows)].map(|(axis, len)| {
            let block = |place: f64| ((place - self.origin[axis]) / self.side_m).floor() as isize;
            // The spline extends two blocks beyond the map, and the outermost nodes of a raster count as 0.
            block(low[axis]).max(0) - 3..block(high[axis]).min(len as isize) + 3
        });
        let [col_nodes, row_nodes] =
            [&cols, &rows].map(|blocks| (blocks.end - blocks.start) * SPLIT as isize);
        if col_nodes <= 0 || row_nodes <= 0 {
            return None;
        }
        let first = [cols.start, rows.start].map(|block| block as f64 + 0.5);
        let mut raster = Raster {
            origin: [0, 1].map(|axis| self.origin[axis] + first[axis] * self.side_m),
            spacing_m: self.side_m / SPLIT as f64,
            rows: row_nodes as usize + 1,
            cols: col_nodes as usize + 1,
            values: Vec::new(),
        };
        for row in 0..raster.rows {
            let (first_row, across) = spline(rows.start, row);
            for col in 0..raster.cols {
                let (first_col, along) = spline(cols.start, col);
                let of_row = |i: isize| -> f64 {
                    (0..4)
                        .zip(along)
                        .map(|(j, weight)| weight * self.value(first_row + i, first_col + j))
                        .sum()
                };
                raster.values.push((0..4).zip(across).map(|(i, weight)| weight * of_row(i)).sum());
            }
        }
        Some(raster)
    }
}

/// The first of the four blocks that a node depends on, and the weights of all four.
fn spline(first_block: isize, node: usize) -> (isize, [f64; 4]) {
    let share = (node % SPLIT) as f64 / SPLIT as f64;
    let rest = 1.0 - share;
    let weights = [
        rest.powi(3) / 6.0,
        2.0 / 3.0 - share * share * (1.0 - share / 2.0),
        2.0 / 3.0 - rest * rest * (1.0 - rest / 2.0),
        share.powi(3) / 6.0,
    ];
    (first_block + (node / SPLIT) as isize - 1, weights)
}

/// The look of lines on the ground, such as bounds of lanes.
pub const LANE: Stroke = Stroke::solid(GREY, 0.6).faint(0.8);

/// Draws a line on the ground.
pub fn draw_line(canvas: &mut Canvas, view: &View, line: &[Point]) {
    let path = Path::line(line.iter().map(|point| view.spot(point.map(f64::from))));
    canvas.stroke(&path, &LANE);
}

/// The mean motion of the agents that passed a block of ground.
struct Passage {
    /// Mean position of the visits.
    place: [f64; 2],
    velocity_mps: [f64; 2],
    speed_mps: f64,
}

/// Draws the mean velocities as arrows. The longest arrow is the fastest.
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

/// The mean passage of each square block of visible cells, if it is at least `ARROW_SPEED_MIN_MPS` fast.
fn passages(map: &ContextMap, view: &View, block: usize) -> Vec<Passage> {
    let (low, high) = view.corners();
    let is_seen = |cell: usize, axis: usize| {
        let place = f64::from(map.origin_m()[axis]) + cell as f64 + 0.5;
        (low[axis]..=high[axis]).contains(&place)
    };
    let cells = map.density().zip(map.velocity_mps()).enumerate();
    // Blocks start at integer multiples, so that panels of one map show the same arrows.
    let mut sums: BTreeMap<[usize; 2], [f64; 5]> = BTreeMap::new();
    for (index, (density, [vx, vy])) in cells.filter(|(_, (density, _))| *density > 0.0) {
        let (row, col) = (index / map.cols(), index % map.cols());
        if !is_seen(col, 0) || !is_seen(row, 1) {
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
    use crate::canvas::Frame;

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
    fn a_map_of_one_path_is_dark_along_it_whatever_the_scale() {
        let mut builder = scene::MapBuilder::new([0.0, 0.0], 40, 3_000).unwrap();
        assert!((0..3_000).all(|x| builder.visit([x as f32 + 0.5, 20.5], [1.0, 0.0])));
        let map = builder.build();
        for (extent, side_m) in [(30.0, 1.0), (2_000.0, 5.0)] {
            let frame = Frame { corner: [0.0, 0.0], size: [100.0, 100.0] };
            let view = View::of([[1_500.0, 20.5]].into_iter(), frame, extent).unwrap();
            let blocks = Blocks::of(&map, &view);
            assert_eq!(blocks.side_m, side_m);
            let raster = blocks.smooth(&view).unwrap();
            let at = |y: f64| {
                let node =
                    |place: f64, axis: usize| ((place - raster.origin[axis]) / raster.spacing_m).round();
                raster.values[node(y, 1) as usize * raster.cols + node(1_500.5, 0) as usize]
            };
            assert!(at(20.5) > 4.0 * at(20.5 + 2.0 * side_m), "{} at {extent} m", at(20.5));
            assert!(at(20.5) > 0.3 * 2.0_f64.ln() / side_m, "{} at {extent} m", at(20.5));
            let passages = passages(&map, &view, 10);
            assert!(passages.iter().all(|p| p.place[1] == 20.5 && (p.speed_mps - 1.0).abs() < 1e-6));
            assert!(!passages.is_empty());
        }
        let aside =
            View::of([[0.0, 900.0]].into_iter(), Frame { corner: [0.0; 2], size: [9.0; 2] }, 20.0).unwrap();
        assert!(Blocks::of(&map, &aside).smooth(&aside).is_none());
    }

    #[test]
    fn the_ground_becomes_darker_with_each_level() {
        let sums: Vec<u32> = ramp().map(|colour| colour.0.iter().map(|c| u32::from(*c)).sum()).collect();
        assert!(sums.windows(2).all(|pair| pair[0] > pair[1]), "{sums:?}");
    }
}
