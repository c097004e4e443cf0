use wire::HORIZON_MAX;

use crate::EXPERTS;

/// Maximum lateral acceleration, at any speed.
const ACROSS_MAX_MPS2: f32 = 4.0;
/// Maximum turn rate.
const TURN_RATE_MAX_RADPS: f32 = 0.6;
/// Maximum longitudinal acceleration.
const ALONG_MAX_MPS2: f32 = 4.0;
/// Time constant of the decay of a turn rate.
const TURN_S: f32 = 2.0;
/// Time constant of the decay of an acceleration.
const ACCELERATION_S: f32 = 1.5;
/// Parts of a step with a straight course.
const PARTS: usize = 4;
/// Below this speed an agent has no course.
pub(crate) const COURSE_MIN_MPS: f32 = 0.3;

/// Positions of an agent at each step of the horizon, by expert.
#[derive(Clone, Debug, PartialEq)]
pub struct Paths {
    /// Constant velocity's.
    pub velocity: [[f32; 2]; HORIZON_MAX],
    /// Positions of each other expert.
    pub experts: [[[f32; 2]; HORIZON_MAX]; EXPERTS],
}

/// The motion of an agent at a time, from which the kinematic experts extrapolate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionNow {
    /// Position.
    pub position_m: [f32; 2],
    /// Velocity.
    pub velocity_mps: [f32; 2],
    /// Turn rate of the course, to the left.
    pub turn_rate_radps: f32,
    /// Acceleration along the course.
    pub acceleration_mps2: f32,
    /// Mean velocity of the last steps.
    pub mean_velocity_mps: [f32; 2],
}

impl Paths {
    /// Positions of the experts relative to constant velocity's at a step, m.
    #[must_use]
    pub fn differences_m(&self, step: usize) -> [[f32; 2]; EXPERTS] {
        self.experts.each_ref().map(|path| [0, 1].map(|axis| path[step][axis] - self.velocity[step][axis]))
    }
}

/// The weighted sum of the experts' differences from constant velocity, m.
pub(crate) fn weighted_m(weights: &[f32; EXPERTS], differences_m: &[[f32; 2]; EXPERTS]) -> [f32; 2] {
    [0, 1].map(|axis| weights.iter().zip(differences_m).map(|(weight, d)| weight * d[axis]).sum())
}

/// A decaying acceleration after a time.
pub(crate) fn decayed(acceleration_mps2: f32, time_s: f32) -> f32 {
    acceleration_mps2 * (-time_s / ACCELERATION_S).exp()
}

/// The speed that a decaying acceleration has added after a time.
pub(crate) fn gained_mps(acceleration_mps2: f32, time_s: f32) -> f32 {
    acceleration_mps2 * ACCELERATION_S * (1.0 - (-time_s / ACCELERATION_S).exp())
}

impl MotionNow {
    /// The motion of an agent, from its velocity now and, in `before`, an earlier one with its age in
    /// seconds.
    #[must_use]
    pub fn since(position_m: [f32; 2], velocity_mps: [f32; 2], before: Option<([f32; 2], f32)>) -> Self {
        let steady = Self { position_m, velocity_mps, mean_velocity_mps: velocity_mps, ..Self::default() };
        let Some(([bx, by], since_s)) = before.filter(|(_, since_s)| *since_s > 0.0) else { return steady };
        let [vx, vy] = velocity_mps;
        let [speed, speed_before] = [vx.hypot(vy), bx.hypot(by)];
        let turned = if speed.min(speed_before) < COURSE_MIN_MPS {
            0.0
        } else {
            (bx * vy - by * vx).atan2(bx * vx + by * vy)
        };
        let turn_max = TURN_RATE_MAX_RADPS.min(ACROSS_MAX_MPS2 / speed.max(COURSE_MIN_MPS));
        Self {
            turn_rate_radps: (turned / since_s).clamp(-turn_max, turn_max),
            acceleration_mps2: ((speed - speed_before) / since_s).clamp(-ALONG_MAX_MPS2, ALONG_MAX_MPS2),
            ..steady
        }
    }

    /// Cosine and sine of the course; of the heading if the agent hardly moves.
    #[must_use]
    pub fn course(&self, heading_rad: f32) -> [f32; 2] {
        let speed_mps = self.speed_mps();
        if speed_mps > COURSE_MIN_MPS {
            self.velocity_mps.map(|of_axis| of_axis / speed_mps)
        } else {
            [heading_rad.cos(), heading_rad.sin()]
        }
    }

    /// Speed.
    pub fn speed_mps(&self) -> f32 {
        self.velocity_mps[0].hypot(self.velocity_mps[1])
    }

    /// Constant velocity.
    pub fn steady(&self, dt_s: f32, out: &mut [[f32; 2]]) {
        self.straight(self.velocity_mps, dt_s, out);
    }

    /// The mean velocity of the last steps. A pedestrian sways with each stride and turns back to its way.
    pub fn by_mean_velocity(&self, dt_s: f32, out: &mut [[f32; 2]]) {
        self.straight(self.mean_velocity_mps, dt_s, out);
    }

    fn straight(&self, velocity_mps: [f32; 2], dt_s: f32, out: &mut [[f32; 2]]) {
        for (step, out) in out.iter_mut().enumerate() {
            let time_s = (step + 1) as f32 * dt_s;
            *out = [0, 1].map(|axis| self.position_m[axis] + time_s * velocity_mps[axis]);
        }
    }

    /// The angle by which a decaying turn has turned the course after a time.
    pub(crate) fn turned_rad(&self, time_s: f32) -> f32 {
        self.turn_rate_radps * TURN_S * (1.0 - (-time_s / TURN_S).exp())
    }

    /// Constant speed on a course whose turn rate decays: θ = θ₀ + ω τ (1 − e^(−t/τ)).
    pub fn turning(&self, dt_s: f32, out: &mut [[f32; 2]]) {
        let ([mut x, mut y], part_s) = (self.position_m, dt_s / PARTS as f32);
        let [vx, vy] = self.velocity_mps;
        for (step, out) in out.iter_mut().enumerate() {
            for part in 0..PARTS {
                let middle_s = ((step * PARTS + part) as f32 + 0.5) * part_s;
                let (sin, cos) = self.turned_rad(middle_s).sin_cos();
                x += (vx * cos - vy * sin) * part_s;
                y += (vx * sin + vy * cos) * part_s;
            }
            *out = [x, y];
        }
    }

    /// A straight course with a decaying acceleration, down to rest at most: v = v₀ + a τ (1 − e^(−t/τ)).
    pub fn accelerating(&self, dt_s: f32, out: &mut [[f32; 2]]) {
        let (speed, part_s) = (self.speed_mps(), dt_s / PARTS as f32);
        let course = if speed > COURSE_MIN_MPS { self.velocity_mps.map(|v| v / speed) } else { [0.0; 2] };
        let mut gone_m = 0.0;
        for (step, out) in out.iter_mut().enumerate() {
            for part in 0..PARTS {
                let middle_s = ((step * PARTS + part) as f32 + 0.5) * part_s;
                gone_m += (speed + gained_mps(self.acceleration_mps2, middle_s)).max(0.0) * part_s;
            }
            *out = [0, 1].map(|axis| self.position_m[axis] + gone_m * course[axis]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sway_does_not_change_the_mean_velocity() {
        let mut motion = MotionNow::since([1.0, 2.0], [1.3, 0.4], None);
        let (mut newest, mut mean) = ([[0.0; 2]; 12], [[0.0; 2]; 12]);
        motion.steady(0.4, &mut newest);
        motion.by_mean_velocity(0.4, &mut mean);
        assert_eq!(mean, newest, "without history");
        motion.mean_velocity_mps = [1.25, 0.0];
        motion.by_mean_velocity(0.4, &mut mean);
        assert_eq!([mean[0], mean[11]], [[1.5, 2.0], [7.0, 2.0]]);
    }

    fn end(of: impl Fn(&mut [[f32; 2]])) -> [f32; 2] {
        let mut path = [[0.0; 2]; 12];
        of(&mut path);
        path[11]
    }

    #[test]
    fn without_change_all_experts_go_straight_on() {
        let now = MotionNow::since([1.0, 2.0], [3.0, 4.0], Some(([3.0, 4.0], 0.8)));
        for [x, y] in [
            end(|path| now.steady(0.4, path)),
            end(|path| now.turning(0.4, path)),
            end(|path| now.accelerating(0.4, path)),
        ] {
            assert!((x - 15.4).abs() < 1e-3 && (y - 21.2).abs() < 1e-3, "{x} {y}");
        }
    }

    #[test]
    fn a_braking_agent_comes_to_rest_and_stays() {
        let now = MotionNow::since([0.0; 2], [2.0, 0.0], Some(([4.0, 0.0], 0.8)));
        let mut path = [[0.0; 2]; 12];
        now.accelerating(0.4, &mut path);
        assert!((0.5..2.5).contains(&path[11][0]) && path[11] == path[8], "{path:?}");
    }

    #[test]
    fn a_turn_to_the_left_ends_to_the_left_of_the_course() {
        let now = MotionNow::since([0.0; 2], [10.0, 0.0], Some(([9.95, -1.0], 0.8)));
        assert!((now.turn_rate_radps - 0.125).abs() < 0.01, "{now:?}");
        let [x, y] = end(|path| now.turning(0.4, path));
        assert!((3.0..12.0).contains(&y) && x < 48.0, "{x} {y}");
    }

    #[test]
    fn fast_agents_do_not_turn_beyond_physics() {
        let now = MotionNow::since([0.0; 2], [30.0, 0.0], Some(([29.0, -7.0], 0.4)));
        assert!((now.turn_rate_radps * 30.0 - ACROSS_MAX_MPS2).abs() < 1e-3, "{now:?}");
    }
}
