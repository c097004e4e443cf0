//! Filters that estimate the motion of agents, in f64, and the [`assignment`] of detections to them.
//!
//! A *prediction* moves a state on in time by its process model, an *update* corrects it by a measurement. Each is done
//! on a copy that replaces the state only when every number in it is finite, so that a failure costs one step and never
//! the track. Covariances are updated in Joseph form and symmetrised: they stay positive over millions of steps.
//!
//! Vehicles and cyclists move as a [`Bicycle`], pedestrians with [`ConstantVelocity`]. So does a bicycle whose course
//! nobody has told yet: a linearised heading with no idea of its value is worse than none. [`Filter::into_bicycle`]
//! takes over once the motion shows it.

pub mod assignment;
mod bicycle;
mod constant_velocity;
mod filter;
mod gaussian;
mod observation;

pub use bicycle::{Bicycle, BicycleModel};
pub use constant_velocity::ConstantVelocity;
pub use filter::Filter;
pub use gaussian::{FilterFault, Gaussian, Innovation};
pub use observation::{Motion, Observation};

use std::f64::consts::{PI, TAU};

/// Longest step of a process model.
pub const STEP_MAX_NS: u64 = 80_000_000;
const STEP_MAX_S: f64 = 0.08;

/// The angle's equal in [−π, π).
#[must_use]
pub fn wrapped(angle_rad: f64) -> f64 {
    if (-PI..PI).contains(&angle_rad) { angle_rad } else { (angle_rad + PI).rem_euclid(TAU) - PI }
}

/// Number and length of equal steps, each of at most 80 ms.
fn steps(dt_ns: u64) -> (u64, f64) {
    let steps_len = dt_ns.div_ceil(STEP_MAX_NS);
    (steps_len, dt_ns as f64 / 1e9 / steps_len.max(1) as f64)
}
