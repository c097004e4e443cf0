//! Forecasts by kinematic models: constant velocity, acceleration and turn rate.
//!
//! A history has one entry per step, oldest first; an entry is `None` if the agent was absent. All forecasts
//! start from the newest entry and are `None` if that entry is. Rates of change are the difference of the
//! newest two present states, divided by the time between them. With a single state all rates are 0.

use kinematics::wrap_angle;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use scene::State;

use crate::Point;

/// Draws of [`sampled_constant_velocity`] in the published comparison.
pub const CVM_DRAWS: usize = 20;
/// Standard deviation of the headings in the published comparison: 25°.
pub const CVM_SIGMA_RAD: f32 = 25.0 * std::f32::consts::PI / 180.0;
/// Time in which the acceleration of [`constant_turn_rate_acceleration`] decays to 1/e.
pub const ACCELERATION_DECAY_S: f32 = 1.0;
/// Time in which the turn rate of [`constant_turn_rate_acceleration`] decays to 1/e.
pub const TURN_RATE_DECAY_S: f32 = 2.0;

/// Midpoints per step in the path integral of [`constant_turn_rate_acceleration`].
const MIDPOINTS: usize = 8;

/// Constant velocity (CV).
#[must_use]
pub fn constant_velocity(history: &[Option<State>], dt_s: f32, horizon: usize) -> Option<Vec<Point>> {
    let State { position_m: [x, y], velocity_mps: [vx, vy], .. } = (*history.last()?)?;
    Some(times(dt_s, horizon).map(|t| [x + vx * t, y + vy * t]).collect())
}

/// Constant acceleration (CA).
#[must_use]
pub fn constant_acceleration(history: &[Option<State>], dt_s: f32, horizon: usize) -> Option<Vec<Point>> {
    let State { position_m: [x, y], velocity_mps: [vx, vy], .. } = (*history.last()?)?;
    let [ax, ay] = before_newest(history, dt_s).map_or([0.0; 2], |(before, elapsed_s)| {
        [(vx - before.velocity_mps[0]) / elapsed_s, (vy - before.velocity_mps[1]) / elapsed_s]
    });
    let half = 0.5;
    Some(times(dt_s, horizon).map(|t| [x + (vx + half * ax * t) * t, y + (vy + half * ay * t) * t]).collect())
}

/// Constant turn rate and velocity (CTRV): the path is a circle.
#[must_use]
pub fn constant_turn_rate(history: &[Option<State>], dt_s: f32, horizon: usize) -> Option<Vec<Point>> {
    let State { position_m: [x, y], velocity_mps: [vx, vy], heading_rad } = (*history.last()?)?;
    let rate_radps = before_newest(history, dt_s)
        .map_or(0.0, |(before, elapsed_s)| turn_rate_radps(before.heading_rad, heading_rad, elapsed_s));
    // ∫ R(ωτ) v dτ = [s −c; c s] v with s = sin(ωt) / ω and c = (1 − cos ωt) / ω, by series near ω = 0.
    let turned = |t: f32| {
        let angle = rate_radps * t;
        let (s, c) = if angle.abs() < 1e-3 {
            (t * (1.0 - angle * angle / 6.0), t * angle / 2.0)
        } else {
            (angle.sin() / rate_radps, (1.0 - angle.cos()) / rate_radps)
        };
        [x + s * vx - c * vy, y + c * vx + s * vy]
    };
    Some(times(dt_s, horizon).map(turned).collect())
}

/// Constant turn rate and acceleration along the path, both decaying (decaying CTRA).
///
/// ```text
/// v(t) = max(0, v₀ + a₀ τ_a (1 − e^(−t/τ_a)))      γ(t) = γ₀ + ω₀ τ_ω (1 − e^(−t/τ_ω))
/// ```
///
/// γ is the course. τ_a and τ_ω are [`ACCELERATION_DECAY_S`] and [`TURN_RATE_DECAY_S`]. Both rates decay
/// because holding a momentary acceleration or turn rate for seconds gives a bad forecast. An agent that
/// brakes comes to rest and stays there; an agent at rest departs along its heading. Speed and course are
/// exact; the path is integrated by the midpoint rule.
#[must_use]
pub fn constant_turn_rate_acceleration(
    history: &[Option<State>],
    dt_s: f32,
    horizon: usize,
) -> Option<Vec<Point>> {
    let newest = (*history.last()?)?;
    let speed_mps = newest.speed_mps();
    let (acceleration_mps2, rate_radps) =
        before_newest(history, dt_s).map_or((0.0, 0.0), |(before, elapsed_s)| {
            let gained_mps = speed_mps - before.speed_mps();
            (gained_mps / elapsed_s, turn_rate_radps(before.heading_rad, newest.heading_rad, elapsed_s))
        });
    let [vx, vy] = newest.velocity_mps;
    let course_rad = if speed_mps > 0.0 { vy.atan2(vx) } else { newest.heading_rad };
    // ∫ e^(−s/τ) ds from 0 to t: the time in which the full rate would have had the same effect.
    let effective_s = |t: f32, decay_s: f32| decay_s * (1.0 - (-t / decay_s).exp());
    let mut position = newest.position_m;
    let part_s = dt_s / MIDPOINTS as f32;
    let step = |k: usize| {
        for part in 0..MIDPOINTS {
            let t = k as f32 * dt_s + (part as f32 + 0.5) * part_s;
            let speed_mps = (speed_mps + acceleration_mps2 * effective_s(t, ACCELERATION_DECAY_S)).max(0.0);
            let (sin, cos) = (course_rad + rate_radps * effective_s(t, TURN_RATE_DECAY_S)).sin_cos();
            position = [position[0] + speed_mps * cos * part_s, position[1] + speed_mps * sin * part_s];
        }
        position
    };
    Some((0..horizon).map(step).collect())
}

/// Sampled constant velocity (CVM-S): `draws` directions, rotated from the true one by N(0, `sigma_rad`²).
#[must_use]
pub fn sampled_constant_velocity(
    history: &[Option<State>],
    dt_s: f32,
    horizon: usize,
    draws: usize,
    sigma_rad: f32,
    rng: &mut impl Rng,
) -> Option<Vec<Vec<Point>>> {
    let state = (*history.last()?)?;
    let mut draw = || {
        let noise: f32 = StandardNormal.sample(rng);
        let [vx, vy] = state.velocity_mps;
        let (sin, cos) = (sigma_rad * noise).sin_cos();
        let turned = State { velocity_mps: [cos * vx - sin * vy, sin * vx + cos * vy], ..state };
        constant_velocity(&[Some(turned)], dt_s, horizon)
    };
    (0..draws).map(|_| draw()).collect()
}

fn times(dt_s: f32, horizon: usize) -> impl Iterator<Item = f32> {
    (1..=horizon).map(move |step| step as f32 * dt_s)
}

fn turn_rate_radps(before_rad: f32, now_rad: f32, elapsed_s: f32) -> f32 {
    wrap_angle(now_rad - before_rad) / elapsed_s
}

/// The last state before the newest, and the time between them.
fn before_newest(history: &[Option<State>], dt_s: f32) -> Option<(State, f32)> {
    let mut backwards = history.iter().rev().enumerate().skip(1);
    backwards.find_map(|(steps, state)| state.map(|state| (state, steps as f32 * dt_s)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn state(position_m: Point, velocity_mps: Point, heading_rad: f32) -> Option<State> {
        Some(State { position_m, velocity_mps, heading_rad })
    }

    fn within(a: &[Point], b: &[Point], tolerance_m: f32) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]) < tolerance_m)
    }

    fn close(a: &[Point], b: &[Point]) -> bool {
        within(a, b, 1e-4)
    }

    #[test]
    fn constant_velocity_equals_values_by_hand() {
        let history = [None, state([1.0, 2.0], [2.0, -1.0], 0.0)];
        assert_eq!(constant_velocity(&history, 0.5, 2), Some(vec![[2.0, 1.5], [3.0, 1.0]]));
        assert_eq!(constant_velocity(&[history[1], None], 0.5, 2), None);
        assert_eq!(constant_velocity(&[], 0.5, 2), None);
    }

    #[test]
    fn constant_acceleration_equals_values_by_hand() {
        // 2 m/s gained over two steps of 0.5 s, one of them unseen: 2 m/s².
        let history = [state([0.0; 2], [1.0, 0.0], 0.0), None, state([2.0, 0.0], [3.0, 0.0], 0.0)];
        let forecast = constant_acceleration(&history, 0.5, 2).expect("present");
        assert!(close(&forecast, &[[3.75, 0.0], [6.0, 0.0]]), "{forecast:?}");
    }

    #[test]
    fn constant_turn_rate_drives_a_quarter_circle() {
        use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
        // π/4 per second at speed π/4: radius 1 around (0, 1).
        let rate = FRAC_PI_4;
        let history = [state([-1.0, 0.0], [rate, 0.0], -rate), state([0.0; 2], [rate, 0.0], 0.0)];
        let forecast = constant_turn_rate(&history, 1.0, 2).expect("present");
        let eighth = [FRAC_PI_4.sin(), 1.0 - FRAC_PI_4.cos()];
        assert!(close(&forecast, &[eighth, [FRAC_PI_2.sin(), 1.0]]), "{forecast:?}");
    }

    #[test]
    fn turn_rate_is_wrapped() {
        let history = [state([0.0; 2], [-1.0, 0.0], 3.1), state([0.0; 2], [-1.0, 0.0], -3.1)];
        let forecast = constant_turn_rate(&history, 1.0, 1).expect("present");
        assert!((forecast[0][0] + 1.0).abs() < 0.01, "{forecast:?}");
    }

    #[test]
    fn decaying_acceleration_integrates_to_speed_and_path() {
        // v(t) = 3 + 2 (1 − e^−t) m/s: the path after t is 5 t − 2 (1 − e^−t).
        let history = [state([0.0; 2], [0.0, 2.0], 1.5), state([1.0, 0.0], [0.0, 3.0], 1.5)];
        let forecast = constant_turn_rate_acceleration(&history, 0.5, 6).expect("present");
        for (k, position) in forecast.iter().enumerate() {
            let t = (k + 1) as f32 * 0.5;
            let way = 5.0 * t - 2.0 * (1.0 - (-t).exp());
            assert!(
                (position[0] - 1.0).abs() < 1e-5 && (position[1] - way).abs() < 2e-3,
                "{t}: {position:?}"
            );
        }
    }

    #[test]
    fn braking_ends_at_rest_and_stays_there() {
        // Braking at 4 m/s² that decays in 1 s reduces the speed by 4 m/s in total. An agent at 2 m/s is at
        // rest after ln 2 s. It has then moved 4 (1 − e^−t) − 2 t = 4/2 − 2 ln 2 m.
        let history = [state([0.0; 2], [4.0, 0.0], 0.0), state([0.0; 2], [2.0, 0.0], 0.0)];
        let forecast = constant_turn_rate_acceleration(&history, 0.5, 8).expect("present");
        assert!(forecast.is_sorted_by(|a, b| a[0] <= b[0]), "{forecast:?}");
        let stop_m = 2.0 - 2.0 * 2.0_f32.ln();
        assert!((forecast[2][0] - stop_m).abs() < 5e-3, "{forecast:?}, {stop_m}");
        assert_eq!(forecast[2], forecast[7]);
    }

    #[test]
    fn decaying_turn_rate_integrates_to_the_course() {
        // 0.5 rad/s that decays in 2 s turns by 1 rad in total.
        let history = [state([0.0; 2], [8.0, 0.0], -0.25), state([0.0; 2], [8.0, 0.0], 0.0)];
        let forecast = constant_turn_rate_acceleration(&history, 0.5, 60).expect("present");
        let [a, b] = [forecast[58], forecast[59]];
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        assert!((dy.atan2(dx) - 1.0).abs() < 1e-4, "{}", dy.atan2(dx));
        assert!((dx.hypot(dy) - 4.0).abs() < 1e-3);
        let first = forecast[0];
        let expected = 0.5 * 2.0 * (1.0 - (1.0 - (-0.25_f32).exp()) / 0.25);
        assert!((first[1].atan2(first[0]) - expected).abs() < 1e-3, "mean course {first:?}, {expected}");
    }

    #[test]
    fn sampled_headings_repeat_by_seed_with_the_given_sigma() {
        let history = [state([0.0; 2], [1.0, 0.0], 0.0)];
        let draw = |seed| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            sampled_constant_velocity(&history, 1.0, 1, 4_000, CVM_SIGMA_RAD, &mut rng).expect("present")
        };
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
        let angles: Vec<f64> = draw(1).iter().map(|t| f64::from(t[0][1].atan2(t[0][0]))).collect();
        let variance = angles.iter().map(|a| a * a).sum::<f64>() / angles.len() as f64;
        assert!((variance.sqrt().to_degrees() - 25.0).abs() < 1.0, "{}", variance.sqrt().to_degrees());
    }

    proptest! {
        #[test]
        fn all_models_agree_on_straight_motion_at_constant_speed(
            x in -50.0f32..50.0, y in -50.0f32..50.0, heading in -3.0f32..3.0, speed in 0.0f32..20.0,
        ) {
            let velocity = [speed * heading.cos(), speed * heading.sin()];
            let at = |t: f32| state([x + velocity[0] * t, y + velocity[1] * t], velocity, heading);
            let history = [at(-0.8), at(-0.4), at(0.0)];
            let expected = constant_velocity(&history, 0.4, 12).expect("present");
            prop_assert!(close(&constant_acceleration(&history, 0.4, 12).expect("present"), &expected));
            prop_assert!(close(&constant_turn_rate(&history, 0.4, 12).expect("present"), &expected));
            let decaying = constant_turn_rate_acceleration(&history, 0.4, 12).expect("present");
            prop_assert!(within(&decaying, &expected, 1e-3));
        }
    }
}
