//! The line that an agent drives along a route. It is smooth, starts at the agent's pose and stays within the
//! lanes' bounds.

use crate::Route;
use crate::routes::{ROUTE_POINTS_MAX, ROUTE_STEP_M};

/// Points on either side over which a route's middle is averaged, because lanelets join at corners.
const SMOOTHED: usize = 3;
/// Distance between a line and the bounds: half a car width.
const MARGIN_M: f32 = 1.0;
/// Smallest room on either side, even in a narrow lane.
const ROOM_MIN_M: f32 = 0.4;
/// Room at which [`STIFFNESS`] applies.
const ROOM_USUAL_M: f32 = 1.5;
/// λ: weight of the distance to the desired line, relative to the weight of the bend, 1/m⁴.
const STIFFNESS: f32 = 3e-4;
/// Share of its offset that an agent keeps.
const KEPT: f32 = 0.5;
/// Factor on the stiffness if the line would leave the bounds.
const STIFFER: f32 = 30.0;
/// Largest slope of the agent's direction relative to the route.
const SLOPE_MAX: f32 = 0.68;
/// Lateral acceleration that drivers accept in bends.
const BEND_MPS2: f32 = 3.0;
/// Deceleration before bends.
const BEFORE_BEND_MPS2: f32 = 2.0;
/// Points on either side from which the curvature is computed.
const BEND_POINTS: usize = 5;
/// Number of passes. The second pass knows the places at which the first left the bounds.
const PASSES: usize = 2;

/// A polyline with the length up to each point.
#[derive(Clone, Debug, Default)]
pub(crate) struct Corridor {
    points_m: Vec<[f32; 2]>,
    along_m: Vec<f32>,
}

/// Scratch memory.
#[derive(Clone, Debug)]
pub(crate) struct Scratch {
    normals: Vec<[f32; 2]>,
    bends: Vec<f32>,
    rooms_m: Vec<f32>,
    offsets_m: Vec<f64>,
    wanted_m: Vec<f32>,
    stiffness: Vec<f32>,
    /// Rows of the factor: the diagonal and its two neighbours.
    factors: Vec<[f64; 3]>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            normals: Vec::with_capacity(ROUTE_POINTS_MAX),
            bends: Vec::with_capacity(ROUTE_POINTS_MAX),
            rooms_m: Vec::with_capacity(ROUTE_POINTS_MAX),
            offsets_m: Vec::with_capacity(ROUTE_POINTS_MAX),
            wanted_m: Vec::with_capacity(ROUTE_POINTS_MAX),
            stiffness: Vec::with_capacity(ROUTE_POINTS_MAX),
            factors: Vec::with_capacity(ROUTE_POINTS_MAX),
        }
    }
}

impl Corridor {
    pub(crate) fn with_room() -> Self {
        Self { points_m: Vec::with_capacity(ROUTE_POINTS_MAX), along_m: Vec::with_capacity(ROUTE_POINTS_MAX) }
    }

    /// The line of an agent along a route.
    ///
    /// ```text
    /// minimise Σ (d_(i+1) − 2 d_i + d_(i−1) + κ_i)² + Σ λ_i (d_i − d*_i)²     d_0, d_1 from the pose
    /// ```
    ///
    /// Here d is the offset to the left of the route's middle, and κ is the bend of the middle over one step.
    /// d* is half of the agent's own offset. λ is smaller in wider lanes, because agents cut corners there.
    /// If the solution leaves the bounds, λ grows there, d* becomes the bound, and the system is solved
    /// again.
    pub(crate) fn draw(&mut self, route: &Route, position_m: [f32; 2], scratch: &mut Scratch) {
        let len = route.points_m.len();
        self.points_m.clear();
        self.points_m.extend((0..len).map(|place| smoothed(&route.points_m, place)));
        scratch.measure(&self.points_m, &route.half_width_m);
        let first = [0, 1].map(|axis| position_m[axis] - self.points_m[0][axis]);
        let offset_m = first[0] * scratch.normals[0][0] + first[1] * scratch.normals[0][1];
        let slope = route.turn_rad.clamp(-1.0, 1.0).tan().clamp(-SLOPE_MAX, SLOPE_MAX);
        let narrowed = 1.0 - (scratch.bends[0] * offset_m).clamp(-0.5, 0.5);
        scratch.solve(offset_m, offset_m + slope * ROUTE_STEP_M * narrowed);
        for ((point, normal), offset_m) in
            self.points_m.iter_mut().zip(&scratch.normals).zip(&scratch.offsets_m)
        {
            *point = [0, 1].map(|axis| point[axis] + normal[axis] * *offset_m as f32);
        }
        self.along_m.clear();
        self.along_m.push(0.0);
        for pair in self.points_m.windows(2) {
            let last_m = self.along_m.last().copied().unwrap_or(0.0);
            self.along_m.push(last_m + (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]));
        }
    }

    /// Its points, and the length up to each.
    pub(crate) fn points(&self) -> (&[[f32; 2]], &[f32]) {
        (&self.points_m, &self.along_m)
    }

    /// Writes the speed that the line permits at each point: bends limit it, and it falls before them.
    ///
    /// ```text
    /// v_i = min(√(a / κ_i), √(v_(i+1)² + 2 b ℓ_i))
    /// ```
    ///
    /// κ is the curvature, a the lateral acceleration that drivers accept, b their deceleration, and ℓ the
    /// distance between two points.
    pub(crate) fn speeds_mps(&self, out: &mut [f32; ROUTE_POINTS_MAX]) {
        let last = self.points_m.len() - 1;
        let heading = |from: usize, to: usize| {
            let [x, y] = [0, 1].map(|axis| self.points_m[to][axis] - self.points_m[from][axis]);
            y.atan2(x)
        };
        let mut next_mps = f32::INFINITY;
        for place in (0..=last).rev() {
            let [from, to] = [place.saturating_sub(BEND_POINTS), (place + BEND_POINTS).min(last)];
            let turned = if from < place && place < to {
                scene::turn(heading(from, place), heading(place, to)).abs()
            } else {
                0.0
            };
            let curvature = 2.0 * turned / (self.along_m[to] - self.along_m[from]).max(1e-3);
            let by_bend_mps = (BEND_MPS2 / curvature.max(1e-6)).sqrt();
            let step_m = self.along_m[(place + 1).min(last)] - self.along_m[place];
            let before_mps = (next_mps * next_mps + 2.0 * BEFORE_BEND_MPS2 * step_m).sqrt();
            next_mps = by_bend_mps.min(before_mps);
            out[place] = next_mps;
        }
    }

    /// Writes the points at increasing lengths. Beyond the end the line is straight.
    pub(crate) fn at(&self, lengths_m: &[f32], out: &mut [[f32; 2]]) {
        let mut place = 0;
        let last = self.points_m.len() - 2;
        for (length_m, out) in lengths_m.iter().zip(out) {
            while place < last && self.along_m[place + 1] <= *length_m {
                place += 1;
            }
            let [from, to] = [self.points_m[place], self.points_m[place + 1]];
            let step_m = (self.along_m[place + 1] - self.along_m[place]).max(1e-6);
            let part = (length_m - self.along_m[place]) / step_m;
            *out = [0, 1].map(|axis| from[axis] + part * (to[axis] - from[axis]));
        }
    }
}

impl Scratch {
    /// Computes normals, bends and room of a middle line.
    fn measure(&mut self, points_m: &[[f32; 2]], half_width_m: &[f32]) {
        let len = points_m.len();
        self.normals.clear();
        self.bends.clear();
        self.rooms_m.clear();
        for place in 0..len {
            let [before, after] = [place.saturating_sub(1), (place + 1).min(len - 1)];
            let along = [0, 1].map(|axis| points_m[after][axis] - points_m[before][axis]);
            let length_m = along[0].hypot(along[1]).max(1e-6);
            self.normals.push([-along[1] / length_m, along[0] / length_m]);
            let room_m = half_width_m.get(place).copied().unwrap_or(0.0) - MARGIN_M;
            self.rooms_m.push(room_m.max(ROOM_MIN_M));
        }
        for place in 0..len {
            let place = place.clamp(1, len - 2);
            let bend = |axis: usize| {
                points_m[place + 1][axis] - 2.0 * points_m[place][axis] + points_m[place - 1][axis]
            };
            self.bends.push(bend(0) * self.normals[place][0] + bend(1) * self.normals[place][1]);
        }
    }

    /// Solves for the offsets after the first two.
    fn solve(&mut self, first_m: f32, second_m: f32) {
        let len = self.bends.len();
        let widest_m = self.rooms_m.iter().copied().fold(0.0, f32::max);
        let wanted_m = KEPT * first_m.clamp(-widest_m, widest_m);
        self.wanted_m.clear();
        self.wanted_m.extend(self.rooms_m.iter().map(|room_m| wanted_m.clamp(-room_m, *room_m)));
        self.stiffness.clear();
        let by_room = |room_m: &f32| STIFFNESS * (ROOM_USUAL_M / room_m) * (ROOM_USUAL_M / room_m);
        self.stiffness.extend(self.rooms_m.iter().map(by_room));
        for _ in 0..PASSES {
            self.offsets_m.clear();
            self.offsets_m.extend([f64::from(first_m), f64::from(second_m)]);
            self.eliminate(len);
            for place in 2..len {
                let (room_m, offset_m) = (self.rooms_m[place], self.offsets_m[place] as f32);
                if offset_m.abs() > room_m {
                    self.wanted_m[place] = room_m.copysign(offset_m);
                    self.stiffness[place] = (self.stiffness[place] * STIFFER).max(10.0 * STIFFNESS);
                }
            }
        }
    }

    /// Solves the symmetric system with five diagonals by L D Lᵀ.
    fn eliminate(&mut self, len: usize) {
        self.factors.clear();
        // Second differences at 1 to len − 2 contain the offset at `place` with weights 1, −2 and 1.
        let weight = |about: usize, place: usize| if about == place { -2.0 } else { 1.0 };
        for place in 2..len {
            let stiffness = f64::from(self.stiffness[place]);
            let mut row = [stiffness, 0.0, 0.0];
            let mut right = stiffness * f64::from(self.wanted_m[place]);
            for about in (place - 1).max(1)..=(place + 1).min(len - 2) {
                let own = weight(about, place);
                right -= own * f64::from(self.bends[about]);
                for other in about - 1..=about + 1 {
                    let both = own * weight(about, other);
                    match other {
                        0 | 1 => right -= both * self.offsets_m[other],
                        _ if other >= place => row[other - place] += both,
                        _ => (),
                    }
                }
            }
            let before = |back: usize| self.factors.len().checked_sub(back).map(|at| self.factors[at]);
            if let Some([diagonal, beside, _]) = before(1) {
                row[0] -= beside * beside * diagonal;
                right -= beside * self.offsets_m[place - 1];
                row[1] -= beside * diagonal * before(1).map_or(0.0, |factor| factor[2]);
            }
            if let Some([diagonal, _, beyond]) = before(2) {
                row[0] -= beyond * beyond * diagonal;
                right -= beyond * self.offsets_m[place - 2];
            }
            self.factors.push([row[0], row[1] / row[0], row[2] / row[0]]);
            // Forward substitution. The division and the back substitution follow below.
            self.offsets_m.push(right);
        }
        for place in (2..len).rev() {
            let [diagonal, beside, beyond] = self.factors[place - 2];
            let next = |by: usize| self.offsets_m.get(place + by).copied().unwrap_or(0.0);
            let value = self.offsets_m[place] / diagonal - beside * next(1) - beyond * next(2);
            self.offsets_m[place] = value;
        }
    }
}

/// A point of a line, averaged with its neighbours. The line is extended straight at its ends.
fn smoothed(points_m: &[[f32; 2]], place: usize) -> [f32; 2] {
    let last = points_m.len() as isize - 1;
    let at = |place: isize| {
        let inside = place.clamp(0, last);
        let (from, to) = if place < 0 { (0, 1) } else { (last as usize - 1, last as usize) };
        let beyond = (place - inside) as f32;
        [0, 1].map(|axis| {
            points_m[inside as usize][axis] + beyond * (points_m[to][axis] - points_m[from][axis])
        })
    };
    let around = -(SMOOTHED as isize)..=SMOOTHED as isize;
    let sum = around.fold([0.0_f32; 2], |sum, by| {
        let point = at(place as isize + by);
        [0, 1].map(|axis| sum[axis] + point[axis])
    });
    sum.map(|sum| sum / (2 * SMOOTHED + 1) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn route(points_m: Vec<[f32; 2]>, half_m: f32) -> Route {
        let half_width_m = vec![half_m; points_m.len()];
        Route { points_m, half_width_m, ..Route::default() }
    }

    #[test]
    fn the_offsets_minimise_the_sum() {
        let arc = |i: usize| [(i as f32 * 0.005).sin() * 200.0, 200.0 - (i as f32 * 0.005).cos() * 200.0];
        let mut scratch = Scratch::default();
        let mut corridor = Corridor::with_room();
        corridor.draw(&route((0..60).map(arc).collect(), 9.0), [0.0, 0.6], &mut scratch);
        let (offsets, bends) = (scratch.offsets_m.clone(), &scratch.bends);
        let sum = |d: &[f64]| -> f64 {
            let bent = (1..59).map(|i| (d[i + 1] - 2.0 * d[i] + d[i - 1] + f64::from(bends[i])).powi(2));
            let room_m = f64::from(9.0 - MARGIN_M);
            let stiffness = f64::from(STIFFNESS) * (f64::from(ROOM_USUAL_M) / room_m).powi(2);
            let held = (2..60).map(|i| stiffness * (d[i] - f64::from(scratch.wanted_m[i])).powi(2));
            bent.sum::<f64>() + held.sum::<f64>()
        };
        assert!(offsets.iter().all(|d| d.abs() < f64::from(9.0 - MARGIN_M)), "{offsets:?}");
        let least = sum(&offsets);
        for place in 2..60 {
            for by in [-1e-3, 1e-3] {
                let mut other = offsets.clone();
                other[place] += by;
                assert!(sum(&other) > least, "at {place} by {by}");
            }
        }
    }

    #[test]
    fn a_line_begins_at_the_agent_and_joins_the_lane() {
        let straight = (0..100).map(|i| [i as f32, 0.0]).collect();
        let mut corridor = Corridor::with_room();
        corridor.draw(&route(straight, 1.8), [0.0, 0.7], &mut Scratch::default());
        let mut out = [[0.0; 2]; 3];
        corridor.at(&[0.0, 30.0, 150.0], &mut out);
        assert!((out[0][1] - 0.7).abs() < 1e-5, "{out:?}");
        assert!((out[1][1] - 0.35).abs() < 0.2 && (out[1][0] - 30.0).abs() < 0.2, "{out:?}");
        assert!((out[2][0] - 150.0).abs() < 0.5, "{out:?}");
    }
}
