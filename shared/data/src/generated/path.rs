//! Paths of road users.

use kinematics::wrap_angle;

pub(super) type Point = [f32; 2];

/// Distance between two samples of a path.
const STEP_M: f32 = 0.5;
/// Speed on straight parts; a driver's temper scales it.
const STRAIGHT_SPEED_MPS: f32 = 12.0;
/// Comfortable lateral acceleration in a curve.
const LATERAL_MPS2: f32 = 2.0;
/// Comfortable braking before a curve.
const BRAKING_MPS2: f32 = 1.3;

/// A place on a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pose {
    pub(super) position_m: Point,
    pub(super) heading_rad: f32,
}

/// A smooth line, sampled as poses every [`STEP_M`] of its length, with the speed that its curves allow.
#[derive(Clone, Debug)]
pub(super) struct Path {
    poses: Vec<Pose>,
    speeds_mps: Vec<f32>,
}

impl Path {
    /// Creates the path along a line of densely spaced points, resampled to equal steps.
    pub(super) fn along(line: &[Point]) -> Self {
        let positions = resampled(line);
        let last = positions.len() - 1;
        let heading = |i: usize| {
            let (a, b) = (positions[i.saturating_sub(1)], positions[(i + 1).min(last)]);
            (b[1] - a[1]).atan2(b[0] - a[0])
        };
        let poses: Vec<Pose> =
            (0..=last).map(|i| Pose { position_m: positions[i], heading_rad: heading(i) }).collect();
        let speeds_mps = allowed_speeds(&poses);
        Self { poses, speeds_mps }
    }

    pub(super) fn length_m(&self) -> f32 {
        (self.poses.len() - 1) as f32 * STEP_M
    }

    /// The pose `along_m` from the start and `aside_m` to the left of the line. Distances beyond the ends are
    /// clamped.
    pub(super) fn pose(&self, along_m: f32, aside_m: f32) -> Pose {
        let (i, share) = self.place(along_m);
        let (a, b) = (self.poses[i], self.poses[i + 1]);
        let heading_rad = a.heading_rad + share * wrap_angle(b.heading_rad - a.heading_rad);
        let between = |axis: usize| a.position_m[axis] + share * (b.position_m[axis] - a.position_m[axis]);
        let (sin, cos) = heading_rad.sin_cos();
        Pose { position_m: [between(0) - aside_m * sin, between(1) + aside_m * cos], heading_rad }
    }

    /// The speed at this distance from which a driver takes all later curves in comfort.
    pub(super) fn speed_mps(&self, along_m: f32) -> f32 {
        let (i, share) = self.place(along_m);
        self.speeds_mps[i] + share * (self.speeds_mps[i + 1] - self.speeds_mps[i])
    }

    /// The samples: distance from the start, and position.
    pub(super) fn samples(&self) -> impl Iterator<Item = (f32, Point)> + Clone + '_ {
        self.poses.iter().enumerate().map(|(i, pose)| (i as f32 * STEP_M, pose.position_m))
    }

    fn place(&self, along_m: f32) -> (usize, f32) {
        let steps = (along_m / STEP_M).clamp(0.0, (self.poses.len() - 1) as f32);
        let i = (steps as usize).min(self.poses.len() - 2);
        (i, steps - i as f32)
    }
}

/// A curve from `a`, leaving in direction `out`, to `b`, arriving in direction `into`, without curvature at
/// its ends. It is a quintic Bézier curve whose first and last three control points are collinear.
pub(super) fn curve(a: Point, out: Point, b: Point, into: Point) -> impl Iterator<Item = Point> {
    const PIECES: u16 = 100;
    // With this reach the curve is like an arc around the corner.
    let reach = 0.29 * ((b[0] - a[0]).abs() + (b[1] - a[1]).abs()) / 2.0;
    let from_a = move |n: f32| [a[0] + n * reach * out[0], a[1] + n * reach * out[1]];
    let from_b = move |n: f32| [b[0] - n * reach * into[0], b[1] - n * reach * into[1]];
    let control = [from_a(0.0), from_a(1.0), from_a(2.0), from_b(2.0), from_b(1.0), from_b(0.0)];
    (0..=PIECES).map(move |i| {
        let t = f32::from(i) / f32::from(PIECES);
        let mut points = control;
        for level in (1..points.len()).rev() {
            for k in 0..level {
                points[k] = [0, 1].map(|axis| points[k][axis] + t * (points[k + 1][axis] - points[k][axis]));
            }
        }
        points[0]
    })
}

fn resampled(line: &[Point]) -> Vec<Point> {
    let mut positions = vec![line[0]];
    let mut left_m = STEP_M;
    for pair in line.windows(2) {
        let [a, b] = [pair[0], pair[1]];
        let piece_m = (b[0] - a[0]).hypot(b[1] - a[1]);
        let mut at_m = left_m;
        while at_m <= piece_m {
            let share = at_m / piece_m;
            positions.push([a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])]);
            at_m += STEP_M;
        }
        left_m = at_m - piece_m;
    }
    positions
}

fn allowed_speeds(poses: &[Pose]) -> Vec<f32> {
    let mut speeds = vec![STRAIGHT_SPEED_MPS; poses.len()];
    for i in 1..poses.len() - 1 {
        let turned_rad = wrap_angle(poses[i + 1].heading_rad - poses[i - 1].heading_rad).abs();
        let curvature = turned_rad / (2.0 * STEP_M);
        speeds[i] = speeds[i].min((LATERAL_MPS2 / curvature.max(1e-6)).sqrt());
    }
    for i in (0..poses.len() - 1).rev() {
        speeds[i] = speeds[i].min((speeds[i + 1].powi(2) + 2.0 * BRAKING_MPS2 * STEP_M).sqrt());
    }
    speeds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_straight_path_is_as_long_as_its_line() {
        let path = Path::along(&[[0.0, 0.0], [10.0, 0.0], [30.0, 0.0]]);
        assert_eq!(path.length_m(), 30.0);
        let pose = path.pose(12.25, 1.0);
        assert_eq!(pose, Pose { position_m: [12.25, 1.0], heading_rad: 0.0 });
        assert_eq!(path.speed_mps(3.0), STRAIGHT_SPEED_MPS);
    }

    #[test]
    fn a_curve_turns_steadily_and_slows_the_driver() {
        let mut line = vec![[-40.0, 0.0]];
        line.extend(curve([0.0, 0.0], [1.0, 0.0], [10.0, 10.0], [0.0, 1.0]));
        line.push([10.0, 50.0]);
        let path = Path::along(&line);
        let headings: Vec<f32> = (0..200).map(|i| path.pose(i as f32 * 0.5, 0.0).heading_rad).collect();
        assert!(headings.is_sorted_by(|a, b| b - a > -1e-3), "turns left only");
        assert!(headings.windows(2).all(|w| w[1] - w[0] < 0.09), "no kink: {headings:?}");
        let slowest = (0..200).map(|i| path.speed_mps(i as f32 * 0.5)).fold(f32::MAX, f32::min);
        assert!((3.0..5.0).contains(&slowest), "{slowest}");
        let eased = (0..40).all(|i| path.speed_mps(i as f32) - path.speed_mps(i as f32 + 1.0) < 0.6);
        assert!(eased, "braking in comfort");
    }
}
