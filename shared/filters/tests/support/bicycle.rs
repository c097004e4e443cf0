//! The vehicle of the tests and benches.

use filters::{Bicycle, Integrator};

/// A bicycle with process noise.
pub const BICYCLE: Bicycle = Bicycle {
    rear_axle_m: 1.2,
    integrator: Integrator::Midpoint,
    acceleration_mps2: 2.0,
    slip_rate_radps: 0.2,
    slip_decay_per_s: 0.0,
    floor: [1e-4, 1e-4, 1e-5, 0.0, 0.0],
    slip_max_rad: 0.5,
};
