use std::f64::consts::{PI, TAU};

use scene::State;

use crate::Point;

/// Share by which a rollout in f32 may exceed every limit.
const ROUNDING: f64 = 1e-3;
/// Error of a coordinate, in units in the last place.
const ULPS: f64 = 4.0;

/// The limits of a vehicle whose centre moves at a slip angle to its heading, as in the model's bicycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BicycleLimits {
    /// Largest change of the speed per second.
    pub acceleration_mps2: f32,
    /// Largest angle between course and heading.
    pub slip_rad: f32,
    /// Largest change of the slip angle per second.
    pub slip_rate_radps: f32,
    /// Distance from the centre to the rear axle; positive.
    pub rear_axle_m: f32,
}

/// Follows the positions of a vehicle as long as a bicycle within its limits can reach them.
///
/// One step of a bicycle is a straight *chord*. Its length is the mean speed times Δt. Its direction is the
/// *course*, ψ + β in the middle of the step. In the time t between the middles of two chords
///
/// ```text
/// |Δ speed| ≤ a t      |Δ course| ≤ κ path + min(β̇ t, 2 β)      κ = sin β / l_r
/// ```
///
/// with the limits a, β and β̇. The heading turns by at most κ times the path; the rest is slip. Slip is
/// bounded, so over any number of steps the course turns by at most κ times the path plus 2 β. The longer
/// chord stands for the path between two middles. This is valid for Euler steps and midpoint steps of the
/// bicycle. Reversing is a negative speed along the opposite course.
pub(crate) struct Steering {
    limits: Bounds,
    dt_s: f64,
    position_m: [f64; 2],
    /// Speed in the middle of the newest chord; negative in reverse.
    speed_mps: f64,
    /// The newest known course, or the heading before the first one.
    course_rad: f64,
    is_heading: bool,
    /// Error of the course caused by rounding of the positions.
    blur_rad: f64,
    /// Length of the newest chord; `None` before the first.
    chord_m: Option<f64>,
    /// Time and path since the newest known course.
    uncertain_s: f64,
    uncertain_m: f64,
    left: Swing,
    right: Swing,
}

/// [`BicycleLimits`] in double precision, with a tolerance for rounding.
struct Bounds {
    acceleration_mps2: f64,
    slip_rad: f64,
    slip_rate_radps: f64,
    curvature_radpm: f64,
}

/// How far the course has turned to one side, minus the turn that the heading can make along the path.
#[derive(Clone, Copy)]
struct Swing {
    now_rad: f64,
    lowest_rad: f64,
}

impl Steering {
    pub(crate) fn new(limits: &BicycleLimits, now: &State, dt_s: f32) -> Self {
        let tolerant = |limit: f32| f64::from(limit) * (1.0 + ROUNDING);
        let limits = Bounds {
            acceleration_mps2: tolerant(limits.acceleration_mps2),
            slip_rad: tolerant(limits.slip_rad),
            slip_rate_radps: tolerant(limits.slip_rate_radps),
            curvature_radpm: tolerant(limits.slip_rad).sin() / f64::from(limits.rear_axle_m),
        };
        let course_rad = f64::from(now.heading_rad);
        let (sin, cos) = course_rad.sin_cos();
        let [vx, vy] = now.velocity_mps.map(f64::from);
        // The course may differ from the heading by β to either side, not by 2 β.
        let swing = Swing { now_rad: 0.0, lowest_rad: -limits.slip_rad };
        Self {
            limits,
            dt_s: f64::from(dt_s),
            position_m: now.position_m.map(f64::from),
            speed_mps: vx * cos + vy * sin,
            course_rad,
            is_heading: true,
            blur_rad: 0.0,
            chord_m: None,
            uncertain_s: 0.0,
            uncertain_m: 0.0,
            left: swing,
            right: swing,
        }
    }

    /// Advances one step, to `next`. Returns `false` if no bicycle within the limits can reach it.
    pub(crate) fn reaches(&mut self, next: Point) -> bool {
        let next = next.map(f64::from);
        let [dx, dy] = [0, 1].map(|axis| next[axis] - self.position_m[axis]);
        let chord_m = dx.hypot(dy);
        let largest_m = next.iter().chain(&self.position_m).fold(0.0_f64, |most, x| most.max(x.abs()));
        let rounding_m = ULPS * f64::from(f32::EPSILON) * largest_m;
        // The middle of the first chord is half a step after now.
        let elapsed_s = if self.chord_m.is_some() { self.dt_s } else { 0.5 * self.dt_s };
        self.uncertain_s += elapsed_s;
        self.uncertain_m += self.chord_m.map_or(0.5 * chord_m, |before_m| before_m.max(chord_m));

        let speed_mps = chord_m / self.dt_s;
        let gain_mps = self.limits.acceleration_mps2 * elapsed_s + rounding_m / self.dt_s;
        let course_rad = dy.atan2(dx);
        let ways = [(speed_mps, course_rad), (-speed_mps, course_rad + PI)]
            .map(|(speed_mps, course_rad)| (speed_mps, wrap(course_rad - self.course_rad)));
        let within = ways.map(|(speed_mps, _)| (speed_mps - self.speed_mps).abs() <= gain_mps);
        let (speed_mps, turn_rad) = match within {
            [true, true] if ways[1].1.abs() < ways[0].1.abs() => ways[1],
            [true, _] => ways[0],
            [false, true] => ways[1],
            [false, false] => return false,
        };
        // Beyond this angle the direction of a turn is ambiguous.
        let clear_rad = if within == [true, true] { 0.5 * PI } else { PI };
        self.speed_mps = speed_mps;
        self.position_m = next;
        self.chord_m = Some(chord_m);
        // A chord that rounding can reverse has no course.
        chord_m <= 2.0 * rounding_m || self.turns(turn_rad, clear_rad, rounding_m / chord_m)
    }

    fn turns(&mut self, turn_rad: f64, clear_rad: f64, blur_rad: f64) -> bool {
        let heading_rad = self.limits.curvature_radpm * self.uncertain_m;
        let both_slips_rad = 2.0 * self.limits.slip_rad;
        let slip_rad = if self.is_heading {
            self.limits.slip_rad
        } else {
            both_slips_rad.min(self.limits.slip_rate_radps * self.uncertain_s)
        };
        let blurs_rad = blur_rad + self.blur_rad;
        self.course_rad += turn_rad;
        self.is_heading = false;
        self.blur_rad = blur_rad;
        (self.uncertain_s, self.uncertain_m) = (0.0, 0.0);
        if heading_rad + slip_rad >= clear_rad {
            // A turn of any size is possible, so this course is independent of the earlier ones.
            (self.left, self.right) = (Swing::new(blur_rad), Swing::new(blur_rad));
            return true;
        }
        let within = turn_rad.abs() <= heading_rad + slip_rad + blurs_rad;
        let left = self.left.advance(turn_rad - heading_rad, blur_rad);
        let right = self.right.advance(-turn_rad - heading_rad, blur_rad);
        within && left.max(right) <= both_slips_rad
    }
}

impl Swing {
    const fn new(blur_rad: f64) -> Self {
        Self { now_rad: 0.0, lowest_rad: blur_rad }
    }

    /// Turns by `rad` and returns the smallest possible distance above the lowest value.
    fn advance(&mut self, rad: f64, blur_rad: f64) -> f64 {
        self.now_rad += rad;
        let above_rad = self.now_rad - blur_rad - self.lowest_rad;
        self.lowest_rad = self.lowest_rad.min(self.now_rad + blur_rad);
        above_rad
    }
}

/// The angle in (−π, π] with the same direction.
fn wrap(angle_rad: f64) -> f64 {
    let wrapped = angle_rad.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Limits;
    use kinematics::{Bicycle, BicycleState, ControlLimits, Integrator, Motion, Vehicle};
    use proptest::prelude::*;

    const STEPS: usize = 12;

    fn vehicle(limits: &BicycleLimits, integrator: Integrator, dt_s: f32) -> Vehicle {
        Vehicle {
            bicycle: Bicycle {
                rear_axle_m: limits.rear_axle_m,
                slip_limit_rad: Some(limits.slip_rad),
                integrator,
            },
            limits: ControlLimits {
                accel_mps2: limits.acceleration_mps2,
                slip_rate_radps: limits.slip_rate_radps,
            },
            dt_s,
        }
    }

    fn bicycle(rear_axle_m: f32) -> BicycleLimits {
        match Limits::vehicle(rear_axle_m) {
            Limits::Bicycle(limits) => limits,
            Limits::Point(_) => unreachable!("a vehicle is a bicycle"),
        }
    }

    /// A state, and the positions that the vehicle reaches from it under saturated controls.
    fn drive(vehicle: &Vehicle, start: [f32; 5], controls: &[[f32; 2]]) -> (State, Vec<Point>) {
        let [x, y, heading, speed, _] = start;
        let now = State {
            position_m: [x, y],
            velocity_mps: [speed * heading.cos(), speed * heading.sin()],
            heading_rad: heading,
        };
        let mut state = BicycleState::from(start);
        let step = |control: &[f32; 2]| {
            let (acting, _) = vehicle.saturate(&(*control).into());
            state = vehicle.step(&state, &acting);
            [state[0], state[1]]
        };
        (now, controls.iter().map(step).collect())
    }

    fn violated(rear_axle_m: f32, start: [f32; 5], driven: &BicycleLimits, control: [f32; 2]) -> bool {
        let vehicle = vehicle(driven, Integrator::Midpoint, 0.5);
        let (now, trajectory) = drive(&vehicle, start, &[control; STEPS]);
        Limits::vehicle(rear_axle_m).violated_by(&now, &trajectory, 0.5)
    }

    #[test]
    fn slightly_more_acceleration_violates_the_limit() {
        let start = [500.0, -300.0, 1.0, 5.0, 0.0];
        let strong = BicycleLimits { acceleration_mps2: 6.1, ..bicycle(1.2) };
        assert!(!violated(1.2, start, &bicycle(1.2), [99.0, 0.0]));
        assert!(violated(1.2, start, &strong, [99.0, 0.0]));
        assert!(violated(1.2, start, &strong, [-99.0, 0.0]), "braking into reverse");
    }

    #[test]
    fn a_circle_beyond_the_slip_violates_the_limit() {
        let loose = BicycleLimits { slip_rad: 0.8, ..bicycle(1.2) };
        for speed_mps in [1.0, 3.0, 8.0, -3.0] {
            let circle = [0.0, 0.0, -2.0, speed_mps, 0.5];
            assert!(!violated(1.2, circle, &bicycle(1.2), [0.0, 99.0]), "{speed_mps} m/s");
            assert!(violated(1.2, circle, &loose, [0.0, 99.0]), "{speed_mps} m/s");
        }
    }

    #[test]
    fn the_circle_of_a_shorter_vehicle_violates_the_limit() {
        let circle = [0.0, 0.0, 0.0, 4.0, 0.5];
        assert!(!violated(1.0, circle, &bicycle(1.0), [0.0, 99.0]));
        assert!(violated(1.3, circle, &bicycle(1.0), [0.0, 99.0]));
    }

    #[test]
    fn a_kink_in_a_slow_path_violates_the_slip_rate() {
        let now = State { velocity_mps: [1.0, 0.0], ..State::default() };
        let kink = |turn: f32| [[0.5, 0.0], [1.0, 0.0], [1.0 + 0.5 * turn.cos(), 0.5 * turn.sin()]];
        // 0.5 s at 1 rad/s, and 0.5 m at 0.4 rad/m.
        assert!(!Limits::vehicle(1.2).violated_by(&now, &kink(0.69), 0.5));
        assert!(Limits::vehicle(1.2).violated_by(&now, &kink(0.71), 0.5));
    }

    #[test]
    fn sideways_motion_violates_limits_and_reversing_does_not() {
        let now = State::default();
        assert!(Limits::vehicle(1.2).violated_by(&now, &[[0.0, 0.3]], 0.5));
        assert!(!Limits::vehicle(1.2).violated_by(&now, &[[-0.3, 0.0], [-1.0, 0.0]], 0.5));
        assert!(!Limits::vehicle(1.2).violated_by(&now, &[[0.0; 2]; 3], 0.5));
    }

    #[test]
    fn nan_violates_the_limits() {
        assert!(Limits::vehicle(1.2).violated_by(&State::default(), &[[f32::NAN, 0.0]], 0.5));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4_000))]
        #[test]
        fn bicycle_rollouts_within_limits_never_violate_them(
            place in [-2e3f32..2e3, -2e3f32..2e3], heading in -3.2f32..3.2, slip in -0.46f32..0.46,
            speed in prop_oneof![Just(0.0f32), -2.0f32..2.0, -5.0f32..20.0],
            rear_axle_m in 0.8f32..2.5, dt_s in prop_oneof![Just(0.1f32), Just(0.4), Just(0.5)], euler: bool,
            size in prop_oneof![Just([0.3f32, 0.05]), Just([8.0, 1.0]), Just([40.0, 9.0])],
            controls in prop::collection::vec([-1.0f32..1.0, -1.0f32..1.0], STEPS),
        ) {
            let integrator = if euler { Integrator::Euler } else { Integrator::Midpoint };
            let vehicle = vehicle(&bicycle(rear_axle_m), integrator, dt_s);
            let controls: Vec<[f32; 2]> = controls.iter().map(|c| [c[0] * size[0], c[1] * size[1]]).collect();
            let (now, trajectory) = drive(&vehicle, [place[0], place[1], heading, speed, slip], &controls);
            let cut = (1..=STEPS).find(|&k| Limits::vehicle(rear_axle_m).violated_by(&now, &trajectory[..k], dt_s));
            prop_assert!(cut.is_none(), "violated at step {cut:?}: {now:?} {trajectory:?}");
        }
    }
}
