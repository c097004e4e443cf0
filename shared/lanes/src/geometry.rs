//! The middle of a lanelet, between its bounds.

use kinematics::hypot;

use crate::lane::{POINTS_MAX, SPACING_M};
use crate::osm::Line;
use crate::{Lane, Users};

/// The middle and the bounds of a lane, at points about [`SPACING_M`] apart.
#[derive(Clone)]
pub(crate) struct Sampled {
    pub(crate) centre_m: Vec<[f32; 2]>,
    half_width_m: Vec<f32>,
}

impl Sampled {
    pub(crate) fn of(left: &Line, right: &Line, given: Option<&Line>) -> Self {
        let bounds = [left, right].map(|line| Measured::new(&line.points_m));
        let longest_m = bounds.iter().map(Measured::length_m).fold(0.0, f64::max);
        let given = given.map(|line| {
            let starts_at = |point: [f64; 2]| distance(point, left.points_m[0]);
            let mut points_m = line.points_m.clone();
            if starts_at(points_m[points_m.len() - 1]) < starts_at(points_m[0]) {
                points_m.reverse();
            }
            Measured::new(&points_m)
        });
        let steps = (longest_m / SPACING_M).ceil().clamp(1.0, POINTS_MAX as f64) as usize;
        let mut sampled = Self { centre_m: Vec::new(), half_width_m: Vec::new() };
        for step in 0..=steps {
            let share = step as f64 / steps as f64;
            let [l, r] = bounds.each_ref().map(|bound| bound.at(share));
            let middle = [0, 1].map(|axis| 0.5 * (l[axis] + r[axis]));
            let centre_m = near(&given.as_ref().map_or(middle, |given| given.at(share)));
            if sampled.centre_m.last() != Some(&centre_m) {
                sampled.centre_m.push(centre_m);
                sampled.half_width_m.push((0.5 * distance(l, r)) as f32);
            }
        }
        if let ([only], Some(end)) = (&sampled.centre_m[..], left.points_m.last()) {
            // The bounds cross. Any second point gives the lane a direction.
            let nudged = [only[0], only[1] + 0.01_f32.max((end[1].abs() * 1e-6) as f32)];
            sampled.centre_m.push(nudged);
            sampled.half_width_m.push(0.0);
        }
        sampled
    }

    pub(crate) fn reversed(mut self) -> Self {
        self.centre_m.reverse();
        self.half_width_m.reverse();
        self
    }

    pub(crate) fn lane(self, id: i64, users: Users, limit_mps: Option<f32>, bounds: [&Line; 2]) -> Lane {
        let mut along_m = vec![0.0_f32];
        for (before, after) in self.centre_m.iter().zip(&self.centre_m[1..]) {
            let last_m = along_m.last().copied().unwrap_or(0.0);
            along_m.push(last_m + (after[0] - before[0]).hypot(after[1] - before[1]));
        }
        Lane {
            id,
            users,
            limit_mps,
            centre_m: self.centre_m,
            half_width_m: self.half_width_m,
            along_m,
            bounds_m: bounds.map(|line| line.points_m.iter().map(near).collect()),
            successors: Vec::new(),
            neighbours: [None; 2],
        }
    }
}

/// A line with the length up to each of its points.
struct Measured {
    points_m: Vec<[f64; 2]>,
    along_m: Vec<f64>,
}

impl Measured {
    fn new(points_m: &[[f64; 2]]) -> Self {
        let mut along_m = vec![0.0];
        for pair in points_m.windows(2) {
            along_m.push(along_m.last().copied().unwrap_or(0.0) + distance(pair[0], pair[1]));
        }
        Self { points_m: points_m.to_vec(), along_m }
    }

    fn length_m(&self) -> f64 {
        self.along_m.last().copied().unwrap_or(0.0)
    }

    /// The point at a share of the length.
    fn at(&self, share: f64) -> [f64; 2] {
        let wanted_m = share * self.length_m();
        let after =
            self.along_m.partition_point(|along_m| *along_m < wanted_m).clamp(1, self.points_m.len() - 1);
        let (from, to) = (self.points_m[after - 1], self.points_m[after]);
        let (from_m, to_m) = (self.along_m[after - 1], self.along_m[after]);
        let part = if to_m > from_m { ((wanted_m - from_m) / (to_m - from_m)).clamp(0.0, 1.0) } else { 0.0 };
        [0, 1].map(|axis| from[axis] + part * (to[axis] - from[axis]))
    }
}

/// Orients two bounds in the direction of their lanelet: both the same way, with the left one on the left.
pub(crate) fn align(left: &mut Line, right: &mut Line) -> Result<(), String> {
    let ends = |line: &Line| [line.points_m[0], line.points_m[line.points_m.len() - 1]];
    let ([l0, l1], [r0, r1]) = (ends(left), ends(right));
    if distance(l0, r0) + distance(l1, r1) > distance(l0, r1) + distance(l1, r0) {
        right.reverse();
    }
    let around = left.points_m.iter().chain(right.points_m.iter().rev());
    let area = signed_area(around);
    if area == 0.0 {
        return Err(format!("ways {} and {} enclose no area", left.way, right.way));
    }
    if area > 0.0 {
        left.reverse();
        right.reverse();
    }
    Ok(())
}

/// Twice the area inside a closed line; positive if the line runs counter-clockwise.
fn signed_area<'p>(points_m: impl Iterator<Item = &'p [f64; 2]> + Clone) -> f64 {
    // Relative to the first point, so that nothing cancels far from the origin.
    let Some(&[x0, y0]) = points_m.clone().next() else { return 0.0 };
    let next = points_m.clone().cycle().skip(1);
    points_m.zip(next).map(|(a, b)| (a[0] - x0) * (b[1] - y0) - (b[0] - x0) * (a[1] - y0)).sum()
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    hypot(a[0] - b[0], a[1] - b[1])
}

pub(crate) fn near(point: &[f64; 2]) -> [f32; 2] {
    point.map(|x| x as f32)
}
