//! The course between two measurements of a detector that is slower than the frames.

use filters::{Motion, wrapped};
use kinematics::hypot;

/// Time constant of the mean turn rate.
const TURN_S: f64 = 3.0;
/// Courses of slower agents are meaningless.
const COURSE_MIN_MPS: f64 = 0.5;
/// A larger turn between two measurements means that front and rear were exchanged.
const TURN_MAX_RAD: f64 = 1.0;

/// The motion at the last frame that was not a repetition, and its turn rate until the next measurement.
///
/// The slip of a bicycle follows from few positions, so it is noisy. Between measurements nothing corrects
/// the turn that it predicts. With noise of 0.03 m the course is off by 0.1 rad after 0.3 s, and forecasts
/// that start there end metres to the side. The published motion therefore turns at the mean rate of the last
/// seconds. The belief itself continues as if there were no repetitions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    from: Motion,
    from_ns: i64,
    turn_radps: f64,
    pub is_held: bool,
}

impl Held {
    pub const fn new(from: Motion, from_ns: i64) -> Self {
        Self { from, from_ns, turn_radps: 0.0, is_held: false }
    }

    /// Ends the hold, because of a measurement or a miss.
    pub const fn end(&mut self) {
        self.is_held = false;
    }

    /// The motion to publish when the belief has moved to `now`.
    pub fn motion(&mut self, now: Motion, now_ns: i64) -> Motion {
        let Self { from, from_ns, turn_radps, is_held } = self;
        let dt_s = now_ns.saturating_sub(*from_ns).max(0) as f64 / 1e9;
        let was_mps = hypot(from.velocity_mps[0], from.velocity_mps[1]);
        let (Some(heading_rad), Some(was_rad)) = (now.heading_rad, from.heading_rad) else {
            *self = Self { from: now, from_ns: now_ns, turn_radps: 0.0, is_held: *is_held };
            return now;
        };
        if !*is_held || was_mps == 0.0 {
            let turned_rad = wrapped(heading_rad + now.slip_rad - was_rad - from.slip_rad);
            let is_moving = now.speed_mps.abs().min(was_mps) >= COURSE_MIN_MPS;
            if dt_s > 0.0 && is_moving && turned_rad.abs() <= TURN_MAX_RAD {
                *turn_radps += (turned_rad - *turn_radps * dt_s) / (TURN_S + dt_s);
            }
            (*from, *from_ns) = (now, now_ns);
            return now;
        }
        let turned_rad = *turn_radps * dt_s;
        let along = |way: f64, turned_rad: f64| {
            let ([x, y], (sin, cos)) = (from.velocity_mps.map(|v| v * way / was_mps), turned_rad.sin_cos());
            [x * cos - y * sin, x * sin + y * cos]
        };
        let moved_m = [0, 1].map(|axis| now.position_m[axis] - from.position_m[axis]);
        let chord_m = along(hypot(moved_m[0], moved_m[1]), 0.5 * turned_rad);
        Motion {
            position_m: [0, 1].map(|axis| from.position_m[axis] + chord_m[axis]),
            velocity_mps: along(hypot(now.velocity_mps[0], now.velocity_mps[1]), turned_rad),
            heading_rad: Some(wrapped(was_rad + turned_rad)),
            slip_rad: from.slip_rad,
            ..now
        }
    }
}
