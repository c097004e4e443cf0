//! Contour lines of a field that is given on a grid.

/// A position in the world, m.
pub type Place = [f64; 2];

/// Marks an edge without a successor.
const NONE: usize = usize::MAX;

/// Values at the nodes of a square grid. Everything outside counts as 0, and the outermost nodes are 0, so
/// every contour closes.
#[derive(Clone, Debug)]
pub struct Raster {
    /// The node of row 0, column 0.
    pub origin: Place,
    /// Distance between neighbouring nodes, m.
    pub spacing_m: f64,
    /// Nodes along y.
    pub rows: usize,
    /// Nodes along x.
    pub cols: usize,
    /// Values, row-major.
    pub values: Vec<f64>,
}

impl Raster {
    /// A raster of zeros that covers the rectangle between two corners, with one extra node on each side. Its
    /// longer side has about `nodes` nodes.
    pub fn over(low: Place, high: Place, nodes: usize) -> Self {
        let extent = [0, 1].map(|axis| (high[axis] - low[axis]).max(1e-3));
        let spacing_m = extent[0].max(extent[1]) / nodes as f64;
        let [cols, rows] = extent.map(|extent| (extent / spacing_m).ceil() as usize + 3);
        let origin = low.map(|low| low - spacing_m);
        Self { origin, spacing_m, rows, cols, values: vec![0.0; rows * cols] }
    }

    /// The position of a node.
    pub fn place(&self, row: usize, col: usize) -> Place {
        [self.origin[0] + col as f64 * self.spacing_m, self.origin[1] + row as f64 * self.spacing_m]
    }

    /// Rows and columns of the nodes in a rectangle around a place.
    pub fn nodes_within(&self, centre: Place, reach: [f64; 2]) -> [std::ops::Range<usize>; 2] {
        [(1, self.rows), (0, self.cols)].map(|(axis, len)| {
            let node = |offset: f64| (centre[axis] + offset - self.origin[axis]) / self.spacing_m;
            // Casts saturate, so a rectangle outside the grid gives an empty range at the edge.
            let first = (node(-reach[axis]).ceil() as usize).min(len);
            first..((node(reach[axis]).floor() + 1.0) as usize).clamp(first, len)
        })
    }

    /// The closed lines at which the field crosses `level`, with the higher side on their left.
    ///
    /// # Panics
    /// If `level` is not positive: the field would have no outside.
    pub fn contours(&self, level: f64) -> Vec<Vec<Place>> {
        assert!(level > 0.0, "level {level} does not separate inside from outside");
        let mut next = self.links(level);
        let mut loops = Vec::new();
        for start in 0..next.len() {
            let mut line = Vec::new();
            let mut edge = start;
            while next[edge] != NONE {
                line.push(self.crossing(edge, level));
                edge = std::mem::replace(&mut next[edge], NONE);
            }
            if line.len() > 2 {
                loops.push(line);
            }
        }
        loops
    }

    fn value(&self, row: usize, col: usize) -> f64 {
        let is_edge = row == 0 || col == 0 || row + 1 >= self.rows || col + 1 >= self.cols;
        if is_edge { 0.0 } else { self.values[row * self.cols + col] }
    }

    /// Maps every edge at which a contour enters a cell to the edge at which it leaves the cell. An edge is
    /// numbered by twice its start node, plus 1 if the edge goes up.
    fn links(&self, level: f64) -> Vec<usize> {
        let mut next = vec![NONE; 2 * self.rows * self.cols];
        for row in 0..self.rows.saturating_sub(1) {
            for col in 0..self.cols.saturating_sub(1) {
                let values = [
                    self.value(row, col),
                    self.value(row, col + 1),
                    self.value(row + 1, col + 1),
                    self.value(row + 1, col),
                ];
                let inside = values.map(|value| value >= level);
                if inside == [true; 4] || inside == [false; 4] {
                    continue;
                }
                let node = row * self.cols + col;
                let edges = [2 * node, 2 * (node + 1) + 1, 2 * (node + self.cols), 2 * node + 1];
                let joined = values.iter().sum::<f64>() / 4.0 >= level;
                for (from, to) in crossings(inside, joined) {
                    next[edges[from]] = edges[to];
                }
            }
        }
        next
    }

    /// The position on an edge at which the field crosses `level`.
    fn crossing(&self, edge: usize, level: f64) -> Place {
        let (row, col) = (edge / 2 / self.cols, edge / 2 % self.cols);
        let (to_row, to_col) = if edge % 2 == 1 { (row + 1, col) } else { (row, col + 1) };
        let (from, to) = (self.value(row, col), self.value(to_row, to_col));
        let share = (level - from) / (to - from);
        let (a, b) = (self.place(row, col), self.place(to_row, to_col));
        [0, 1].map(|axis| a[axis] + (b[axis] - a[axis]) * share)
    }
}

/// The sides of a cell between which contours run, as (from, to). Sides are counted counter-clockwise: side i
/// runs from corner i to corner i + 1. If two opposite corners are inside, `joined` states whether they
/// belong together.
fn crossings(inside: [bool; 4], joined: bool) -> impl Iterator<Item = (usize, usize)> {
    let leaves = move |side: usize| inside[side] && !inside[(side + 1) % 4];
    let enters = move |side: usize| !inside[side] && inside[(side + 1) % 4];
    (0..4).filter(move |side| leaves(*side)).filter_map(move |side| {
        let turned = |quarter: usize| (if joined { side + quarter } else { side + 4 - quarter }) % 4;
        (1..4).map(turned).find(|side| enters(*side)).map(|to| (side, to))
    })
}

/// A closed line without the spots that are within `tolerance` of the straight line between kept spots.
pub fn simplified(closed: &[Place], tolerance: f64) -> Vec<Place> {
    let Some(first) = closed.first() else { return Vec::new() };
    let farthest = (0..closed.len())
        .max_by(|a, b| distance(closed[*a], *first).total_cmp(&distance(closed[*b], *first)))
        .unwrap_or(0);
    let mut ring: Vec<Place> = closed.to_vec();
    ring.push(*first);
    let mut kept = vec![false; ring.len()];
    // Douglas-Peucker on both halves of the ring.
    let mut spans = vec![(0, farthest), (farthest, ring.len() - 1)];
    while let Some((start, end)) = spans.pop() {
        kept[start] = true;
        let off = |index: &usize| off_line(ring[*index], ring[start], ring[end]);
        let worst = (start + 1..end).max_by(|a, b| off(a).total_cmp(&off(b)));
        if let Some(worst) = worst.filter(|worst| off(worst) > tolerance) {
            spans.extend([(start, worst), (worst, end)]);
        }
    }
    ring.into_iter().zip(kept).filter_map(|(place, kept)| kept.then_some(place)).collect()
}

fn distance(a: Place, b: Place) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Distance between a position and the line segment between two others.
fn off_line(place: Place, from: Place, to: Place) -> f64 {
    let along = [to[0] - from[0], to[1] - from[1]];
    let length2 = along[0] * along[0] + along[1] * along[1];
    let towards = (place[0] - from[0]) * along[0] + (place[1] - from[1]) * along[1];
    let share = if length2 > 0.0 { (towards / length2).clamp(0.0, 1.0) } else { 0.0 };
    distance(place, [from[0] + share * along[0], from[1] + share * along[1]])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Area on the left of closed lines.
    fn area(loops: &[Vec<Place>]) -> f64 {
        let of = |line: &Vec<Place>| {
            let next = line.iter().cycle().skip(1);
            line.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>() / 2.0
        };
        loops.iter().map(of).sum()
    }

    fn raster(field: impl Fn(Place) -> f64) -> Raster {
        let mut raster = Raster::over([-5.0, -4.0], [5.0, 4.0], 200);
        for row in 0..raster.rows {
            for col in 0..raster.cols {
                raster.values[row * raster.cols + col] = field(raster.place(row, col));
            }
        }
        raster
    }

    #[test]
    fn a_ring_has_an_outer_and_an_inner_contour() {
        let ring = raster(|[x, y]| (1.5 - (x.hypot(y) - 2.5).abs()).max(0.0));
        let contours = ring.contours(1.0);
        assert_eq!(contours.len(), 2);
        let expected = std::f64::consts::PI * (3.0_f64.powi(2) - 2.0_f64.powi(2));
        assert!((area(&contours) / expected - 1.0).abs() < 2e-3, "{} m²", area(&contours));
        for [x, y] in contours.concat() {
            let radius = x.hypot(y);
            assert!((radius - 2.0).abs() < 0.01 || (radius - 3.0).abs() < 0.01, "radius {radius}");
        }
    }

    #[test]
    fn a_field_that_reaches_the_edge_is_closed_along_it() {
        let contours = raster(|_| 2.0).contours(1.0);
        assert_eq!(contours.len(), 1);
        assert!((area(&contours) / 80.0 - 1.0).abs() < 0.03, "{} m²", area(&contours));
    }

    #[test]
    fn saddles_part_or_join_by_their_middle() {
        let saddle = |middle: f64| raster(move |[x, y]| 1.0 + middle + 0.05 * x * y);
        assert_eq!(saddle(-0.01).contours(1.0).len(), 2);
        assert_eq!(saddle(0.01).contours(1.0).len(), 1);
    }

    #[test]
    fn simplifying_drops_most_points_within_its_tolerance() {
        let circle = &raster(|[x, y]| 4.0 - x.hypot(y)).contours(1.0)[0];
        let kept = simplified(circle, 0.01);
        assert!(kept.len() * 3 < circle.len(), "{} of {}", kept.len(), circle.len());
        for place in circle {
            let next = kept.iter().cycle().skip(1);
            let off =
                kept.iter().zip(next).map(|(a, b)| off_line(*place, *a, *b)).fold(f64::INFINITY, f64::min);
            assert!(off <= 0.01, "{place:?} is {off} m off");
        }
        assert!(simplified(&[], 0.1).is_empty());
    }
}
