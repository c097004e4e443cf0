use nalgebra::Vector2;

use crate::{Bicycle, BicycleState, Linearised, Motion};

/// Largest magnitudes of a vehicle's controls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlLimits {
    /// Largest acceleration, m/s².
    pub accel_mps2: f32,
    /// Largest slip rate, rad/s.
    pub slip_rate_radps: f32,
}

/// The motion of a vehicle: a bicycle with saturated controls at a fixed step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vehicle {
    /// The equations of motion.
    pub bicycle: Bicycle<f32>,
    /// The limits at which the controls saturate.
    pub limits: ControlLimits,
    /// The step, Δt.
    pub dt_s: f32,
}

impl Motion<5> for Vehicle {
    fn saturate(&self, control: &Vector2<f32>) -> (Vector2<f32>, Vector2<f32>) {
        let (accel, accel_slope) = saturate(control.x, self.limits.accel_mps2);
        let (slip_rate, slip_rate_slope) = saturate(control.y, self.limits.slip_rate_radps);
        (Vector2::new(accel, slip_rate), Vector2::new(accel_slope, slip_rate_slope))
    }

    fn step(&self, state: &BicycleState<f32>, control: &Vector2<f32>) -> BicycleState<f32> {
        self.bicycle.step(state, control, self.dt_s)
    }

    fn linearise(&self, state: &BicycleState<f32>, control: &Vector2<f32>) -> Linearised<f32, 5> {
        self.bicycle.linearise(state, control, self.dt_s)
    }
}

/// limit · tanh(value / limit) and its slope sech²(value / limit). It is smooth, so training can use it.
/// \[model §4\]
#[must_use]
pub fn saturate(value: f32, limit: f32) -> (f32, f32) {
    let share = (value / limit).tanh();
    (limit * share, 1.0 - share * share)
}
