use crate::{Bicycle, ControlLimits, DisplacementKind, Integrator, Vehicle, initial_slip};

/// How an agent moves, and what its controls are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MotionKind {
    /// Along a heading, as a kinematic bicycle: acceleration m/s² and slip rate rad/s.
    Bicycle,
    /// In any direction: a displacement (x, y) of each step in the agent frame, m.
    Displacement,
}

/// The constants of motion, which belong to a model's configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionOptions {
    /// Integrator of the bicycle.
    pub integrator: Integrator,
    /// Where a bicycle's controls saturate.
    pub limits: ControlLimits,
    /// Largest slip angle, if there is a limit.
    pub slip_limit_rad: Option<f32>,
    /// Whether a bicycle's first slip angle follows from its turn rates; 0 otherwise.
    pub initial_slip: bool,
    /// Distance of the rear axle from the centre over the length.
    pub rear_axle_ratio: f32,
    /// Length of vehicles whose length is unknown.
    pub default_length_m: f32,
    /// What a displacement is relative to.
    pub displacement: DisplacementKind,
}

impl Default for MotionOptions {
    fn default() -> Self {
        Self {
            integrator: Integrator::Midpoint,
            limits: ControlLimits { accel_mps2: 6.0, slip_rate_radps: 1.0 },
            slip_limit_rad: Some(0.5),
            initial_slip: true,
            rear_axle_ratio: 0.26,
            default_length_m: 4.5,
            displacement: DisplacementKind::Residual,
        }
    }
}

impl MotionOptions {
    /// Distance from the centre of a vehicle to its rear axle, l_r.
    #[must_use]
    pub fn rear_axle_m(&self, length_m: Option<f32>) -> f32 {
        self.rear_axle_ratio * length_m.unwrap_or(self.default_length_m)
    }

    /// The slip angle with which a bicycle of a signed speed begins, by the turn rates of its newest two
    /// history intervals, newest first: [`initial_slip`], or 0.
    #[must_use]
    pub fn start_slip_rad(&self, rear_axle_m: f32, speed_mps: f32, turn_rates_radps: [f32; 2]) -> f32 {
        if self.initial_slip { initial_slip(rear_axle_m, speed_mps, turn_rates_radps) } else { 0.0 }
    }

    /// The motion of a vehicle in steps of `dt_s`.
    #[must_use]
    pub const fn vehicle(&self, rear_axle_m: f32, dt_s: f32) -> Vehicle {
        let bicycle =
            Bicycle { rear_axle_m, slip_limit_rad: self.slip_limit_rad, integrator: self.integrator };
        Vehicle { bicycle, limits: self.limits, dt_s }
    }
}
