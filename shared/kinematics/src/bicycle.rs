//! The kinematic bicycle: a vehicle whose centre moves at a slip angle β to its heading ψ.
//!
//! Within a step all motion is evaluated at one *evaluation point* (v*, β*), along one course γ*:
//!
//! ```text
//! x' = x + v* cos γ* Δt      ψ' = ψ + ω* Δt,  ω* = v* sin β* / l_r      β' = β + β̇ Δt
//! y' = y + v* sin γ* Δt      v' = v + a Δt
//! ```
//!
//! `Euler` uses the state before the step: v* = v, β* = β, γ* = ψ + β \[paper, Eq. discretesystem\].
//! `Midpoint` uses the middle: v* = (v + v')/2, β* = (β + β')/2, γ* = ψ + ω* Δt/2 + β*.
//!
//! Differs from \[paper, Eq. discretesystem\]: with Euler the first control cannot move the first position,
//! so midpoint is the default. The derivative of x' with respect to v is cos γ Δt; the paper prints v_x Δt.

use nalgebra::{RealField, SMatrix, SVector, Vector2, convert};

use crate::Linearised;

/// \[x, y, ψ, v, β\]: position m, heading rad, speed along the heading m/s (negative in reverse), slip angle
/// rad.
pub type BicycleState<T> = SVector<T, 5>;

const HEADING: usize = 2;
const SPEED: usize = 3;
const SLIP: usize = 4;

/// The point within a step at which the right-hand sides are evaluated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Integrator {
    /// The beginning of the step.
    Euler,
    /// The middle of the step.
    #[default]
    Midpoint,
}

/// A kinematic bicycle with controls (a, β̇): acceleration m/s² and slip rate rad/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bicycle<T> {
    /// Distance from the centre to the rear axle, l_r; positive.
    pub rear_axle_m: T,
    /// Largest magnitude of the slip angle after a step, if there is a limit.
    pub slip_limit_rad: Option<T>,
    /// The point within a step at which the right-hand sides are evaluated.
    pub integrator: Integrator,
}

/// Speed, slip, turn rate and course over a step, and the part of the state that does not depend on them.
struct Evaluation<T> {
    speed: T,
    slip_sin: T,
    slip_cos: T,
    turn_rate: T,
    course_sin: T,
    course_cos: T,
    next_speed: T,
    next_slip: T,
    slip_is_free: bool,
}

impl<T: RealField + Copy> Bicycle<T> {
    /// The state after `dt_s` under (a, β̇). Finite inputs give a finite result. The heading is not wrapped.
    #[must_use]
    pub fn step(&self, state: &BicycleState<T>, control: &Vector2<T>, dt_s: T) -> BicycleState<T> {
        Self::advance(state, &self.evaluate(state, control, dt_s), dt_s)
    }

    /// Like [`Bicycle::step`], with derivatives with respect to state and control. A saturated slip angle has
    /// none.
    #[must_use]
    pub fn linearise(&self, state: &BicycleState<T>, control: &Vector2<T>, dt_s: T) -> Linearised<T, 5> {
        let at = self.evaluate(state, control, dt_s);
        let (zero, one, half) = (T::zero(), T::one(), convert::<f64, T>(0.5));
        let free = if at.slip_is_free { one } else { zero };
        // Derivatives of the evaluation point with respect to the state before the step and the control.
        let (slip_by_slip, slip_by_rate, speed_by_accel, course_by_turn) = match self.integrator {
            Integrator::Euler => (one, zero, zero, zero),
            Integrator::Midpoint => ((one + free) * half, free * dt_s * half, dt_s * half, dt_s * half),
        };
        let turn_by_speed = at.slip_sin / self.rear_axle_m;
        let turn_by_slip = at.speed * at.slip_cos / self.rear_axle_m;
        let (sin, cos) = (at.course_sin, at.course_cos);
        let (along, across) = ([cos * dt_s, sin * dt_s], [-at.speed * sin * dt_s, at.speed * cos * dt_s]);

        let mut by_state = SMatrix::<T, 5, 5>::identity();
        let mut by_control = SMatrix::<T, 5, 2>::zeros();
        for axis in 0..2 {
            let by_speed = along[axis] + across[axis] * course_by_turn * turn_by_speed;
            let by_slip = across[axis] * (one + course_by_turn * turn_by_slip);
            by_state[(axis, HEADING)] = across[axis];
            by_state[(axis, SPEED)] = by_speed;
            by_state[(axis, SLIP)] = by_slip * slip_by_slip;
            by_control[(axis, 0)] = by_speed * speed_by_accel;
            by_control[(axis, 1)] = by_slip * slip_by_rate;
        }
        by_state[(HEADING, SPEED)] = turn_by_speed * dt_s;
        by_state[(HEADING, SLIP)] = turn_by_slip * slip_by_slip * dt_s;
        by_state[(SLIP, SLIP)] = free;
        by_control[(HEADING, 0)] = turn_by_speed * speed_by_accel * dt_s;
        by_control[(HEADING, 1)] = turn_by_slip * slip_by_rate * dt_s;
        by_control[(SPEED, 0)] = dt_s;
        by_control[(SLIP, 1)] = free * dt_s;
        Linearised { next: Self::advance(state, &at, dt_s), by_state, by_control }
    }

    fn evaluate(&self, state: &BicycleState<T>, control: &Vector2<T>, dt_s: T) -> Evaluation<T> {
        let half = convert::<f64, T>(0.5);
        let (heading, speed, slip) = (state[HEADING], state[SPEED], state[SLIP]);
        let next_speed = speed + control[0] * dt_s;
        let asked_slip = slip + control[1] * dt_s;
        let next_slip = self.slip_limit_rad.map_or(asked_slip, |limit| asked_slip.clamp(-limit, limit));
        let (speed, slip) = match self.integrator {
            Integrator::Euler => (speed, slip),
            Integrator::Midpoint => ((speed + next_speed) * half, (slip + next_slip) * half),
        };
        let (slip_sin, slip_cos) = slip.sin_cos();
        let turn_rate = speed * slip_sin / self.rear_axle_m;
        let course = match self.integrator {
            Integrator::Euler => heading + slip,
            Integrator::Midpoint => heading + turn_rate * dt_s * half + slip,
        };
        let (course_sin, course_cos) = course.sin_cos();
        let slip_is_free = next_slip == asked_slip;
        Evaluation {
            speed,
            slip_sin,
            slip_cos,
            turn_rate,
            course_sin,
            course_cos,
            next_speed,
            next_slip,
            slip_is_free,
        }
    }

    fn advance(state: &BicycleState<T>, at: &Evaluation<T>, dt_s: T) -> BicycleState<T> {
        BicycleState::<T>::from([
            state[0] + at.speed * at.course_cos * dt_s,
            state[1] + at.speed * at.course_sin * dt_s,
            state[HEADING] + at.turn_rate * dt_s,
            at.next_speed,
            at.next_slip,
        ])
    }
}

/// The slip angle at the start of a vehicle's forecast, from the turn rates of its newest two history
/// intervals.
///
/// ```text
/// β_0 = asin(clip(l_r ω̂ / v, ±0.45)),  ω̂ = 1.5 d₁ − 0.5 d₂          [model §4]
/// ```
///
/// `turn_rates_radps` is \[d₁ (newest), d₂\]; v is signed. The slip of a vehicle at rest is 0.
#[must_use]
pub fn initial_slip(rear_axle_m: f32, speed_mps: f32, turn_rates_radps: [f32; 2]) -> f32 {
    let turn_rate = 1.5 * turn_rates_radps[0] - 0.5 * turn_rates_radps[1];
    if speed_mps == 0.0 {
        return 0.0;
    }
    (rear_axle_m * turn_rate / speed_mps).clamp(-0.45, 0.45).asin()
}

/// The angle in (−π, π] with the same direction.
#[must_use]
pub fn wrap_angle(angle_rad: f32) -> f32 {
    use std::f32::consts::{PI, TAU};
    let wrapped = angle_rad.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}
