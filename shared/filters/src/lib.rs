//! Filters that estimate the motion of agents, in f64.
//!
//! A *prediction* moves a state on in time by its [`Process`], an *update* corrects it by what was observed.
//! Each is done on a copy that replaces the state only when every number in it is finite, so that a failure
//! costs one step and never the track. Covariances are updated in Joseph form and kept exactly symmetric:
//! they stay positive over millions of steps.
//!
//! A [`Gaussian`] under one process is an (extended) Kalman filter; [`Filter`] holds one of any [`Kind`]. The
//! forecast of a model, given as controls of several hypotheses, becomes the process of a [`Mixture`] of
//! linearised filters, or of [`Particles`].

mod bicycle;
mod constant_acceleration;
mod constant_turn_rate;
mod constant_velocity;
mod control;
mod filter;
mod gaussian;
mod innovation;
pub mod mixture;
mod moments;
mod observation;
pub mod particles;
mod process;
mod singer;
pub mod weights;

pub use kinematics::Integrator;

pub use bicycle::{Bicycle, reversed};
pub use constant_acceleration::{ConstantAcceleration, chain_noise};
pub use constant_turn_rate::ConstantTurnRate;
pub use constant_velocity::ConstantVelocity;
pub use control::{
    Control, ControlStep, Controlled, Forecast, ForecastFault, HYPOTHESES_MAX, control_gain, noise_left,
};
pub use filter::{Filter, Kind, Models, Unknown};
pub use gaussian::{FilterFault, Gaussian};
pub use innovation::{Evidence, Innovation, MEASURED_MAX};
pub use mixture::{Mixture, Priors};
pub use moments::{difference, interpolated, mean, moments, sample_moments};
pub use observation::{Motion, OBSERVATIONS_MAX, Observation};
pub use particles::Particles;
pub use process::Process;
pub use singer::SingerBicycle;

use std::f64::consts::{PI, TAU};

/// Longest step of a process.
pub const STEP_MAX_NS: u64 = 80_000_000;
const STEP_MAX_S: f64 = 0.08;
/// Longest time that one prediction covers.
pub const GAP_MAX_NS: u64 = 60_000_000_000;

/// The angle's equal in [−π, π).
#[must_use]
#[inline]
pub fn wrapped(angle_rad: f64) -> f64 {
    if (-PI..PI).contains(&angle_rad) { angle_rad } else { (angle_rad + PI).rem_euclid(TAU) - PI }
}
