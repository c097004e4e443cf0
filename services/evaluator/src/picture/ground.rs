//! The context map beneath a scene: how often each place was visited, and how fast.

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

/// Draws how fast places were passed, as arrows; the longest is the fastest.
pub fn draw_velocity(canvas: &mut Canvas, view: &View, map: &ContextMap) {
    let block = ((ARROW_SPACING / view.scale()).ceil() as usize).max(1);
    let Some([cols, rows]) = cells_within(map, view) else { return };
    let within = |range: &std::ops::Range<isize>, len: usize| {
        (range.start.max(0) as usize)..(range.end.max(0) as usize).min(len)
    };
    let (cols, rows) = (within(&cols, map.cols()), within(&rows, map.rows()));
    let cells: Vec<(f64, [f64; 2])> = map
        .density()
        .zip(map.velocity_mps())
        .map(|(density, velocity)| (f64::from(density), velocity.map(f64::from)))
        .collect();
    let mut arrows = Vec::new();
    // Blocks start at whole multiples, so that neighbouring panels show the same arrows.
    for row in (rows.start / block * block..rows.end).step_by(block) {
        for col in (cols.start / block * block..cols.end).step_by(block) {
            let rows = row..(row + block).min(map.rows());
            let of_block = rows
                .flat_map(|row| (col..(col + block).min(map.cols())).map(move |col| (row, col)))
                .map(|(row, col)| cells[row * map.cols() + col]);
            let (visits, [x, y]) = of_block.fold((0.0, [0.0; 2]), |(visits, [x, y]), (density, [vx, vy])| {
                (visits + density, [x + density * vx, y + density * vy])
            });
            let velocity = [x, y].map(|sum| if visits > 0.0 { sum / visits } else { 0.0 });
            let centre = [col, row].map(|cell| cell as f64 + block as f64 / 2.0);
            arrows.push(([0, 1].map(|axis| f64::from(map.origin_m()[axis]) + centre[axis]), velocity));
        }
    }
    let fastest = arrows.iter().map(|(_, [vx, vy])| vx.hypot(*vy)).fold(ARROW_SPEED_MIN_MPS, f64::max);
    let length = 0.95 * block as f64 * view.scale();
    for (place, [vx, vy]) in arrows {
        let speed = vx.hypot(vy);
        if speed >= ARROW_SPEED_MIN_MPS {
            let way = [vx / speed, -vy / speed];
            draw_arrow(canvas, view.spot(place), way, length * (speed / fastest).max(0.2));
        }
    }
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
