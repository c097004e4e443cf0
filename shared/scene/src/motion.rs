//! Velocities and headings of agents from their positions alone, and the start of their future motion.

use kinematics::MotionStart;

use crate::{MOVING_MPS, State, agent_frame};

/// Fills `states` with the velocities and headings that follow from `positions_m`, one row per step of
/// `dt_s`.
///
/// ```text
/// v^k = (p^k − p^j) / ((k − j) Δt),  j the last present step before k
/// ψ^k = atan2(vy, vx) if |v| ≥ 0.1 m/s
/// ```
///
/// The differences are backward only: row k depends on rows up to k. The first present row copies the
/// velocity of the second present row. If the first row is within the first `observed_count` rows and the
/// second is not, the first row is at rest instead. No row of the first `observed_count` therefore depends on a
/// later one. The heading of an agent at rest is its last defined heading, or 0 if there is none. \[model
/// §1\]
///
/// # Panics
/// If the slices differ in length.
pub fn states_from_positions(
    positions_m: &[Option<[f32; 2]>],
    observed_count: usize,
    dt_s: f32,
    states: &mut [Option<State>],
) {
    assert_eq!(positions_m.len(), states.len(), "a state for each position");
    let mut rows = positions_m.iter().enumerate().filter_map(|(step, p)| p.map(|p| (step, p)));
    let first = rows.next();
    let second = rows.next().filter(|(step, _)| {
        let split = first.is_some_and(|(first, _)| first < observed_count);
        !split || *step < observed_count
    });
    let mut heading_rad = 0.0;
    let mut last = None;
    for (step, (position, state)) in positions_m.iter().zip(states).enumerate() {
        let Some(position_m) = *position else {
            *state = None;
            continue;
        };
        let here = (step, position_m);
        let velocity_mps = match (last, second) {
            (Some(last), _) => velocity(last, here, dt_s),
            (None, Some(second)) => velocity(here, second, dt_s),
            (None, None) => [0.0; 2],
        };
        if velocity_mps[0].hypot(velocity_mps[1]) >= MOVING_MPS {
            heading_rad = velocity_mps[1].atan2(velocity_mps[0]);
        }
        last = Some(here);
        *state = Some(State { position_m, velocity_mps, heading_rad });
    }
}

fn velocity(from: (usize, [f32; 2]), to: (usize, [f32; 2]), dt_s: f32) -> [f32; 2] {
    let elapsed_s = (to.0 - from.0) as f32 * dt_s;
    [0, 1].map(|axis| (to.1[axis] - from.1[axis]) / elapsed_s)
}

/// Turn rates of the newest two history intervals, newest first, rad/s. A rate is 0 if either end is absent.
#[must_use]
pub fn turn_rates(history: &[Option<State>], dt_s: f32) -> [f32; 2] {
    let back = |steps: usize| history.len().checked_sub(steps).and_then(|step| history[step]);
    [1, 2].map(|steps| match (back(steps), back(steps + 1)) {
        (Some(after), Some(before)) => turn(before.heading_rad, after.heading_rad) / dt_s,
        _ => 0.0,
    })
}

/// The angle in [−π, π) from one heading to another.
#[must_use]
#[inline]
pub fn turn(from_rad: f32, to_rad: f32) -> f32 {
    use std::f32::consts::{PI, TAU};
    (to_rad - from_rad + PI).rem_euclid(TAU) - PI
}

/// The start of the motion of an agent whose history ends at `now`, in steps of `dt_s`.
///
/// If there is no history, the agent frame is the frame of the present state.
#[must_use]
pub fn motion_start(now: &State, history: &[Option<State>], length_m: Option<f32>, dt_s: f32) -> MotionStart {
    MotionStart {
        position_m: now.position_m,
        velocity_mps: now.velocity_mps,
        heading_rad: now.heading_rad,
        turn_rates_radps: turn_rates(history, dt_s),
        frame_heading_rad: agent_frame(history).map_or(now.heading_rad, |frame| frame.heading_rad),
        length_m,
    }
}
