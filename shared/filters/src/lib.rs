//! Recursive Bayesian filters of an agent's motion in f64. The prior is a process model or a forecast.
//!
//! A filter keeps a belief about the state of one agent and repeats two steps:
//!
//! * **Predict**: a [`Process`] model moves the belief ahead in time and adds its noise. The uncertainty
//!   grows.
//! * **Update**: an [`Observation`] corrects the belief by its innovation. The uncertainty falls.
//!
//! | belief | update | for |
//! |---|---|---|
//! | [`Gaussian`] | Kalman filter, extended if the process is not linear | one process |
//! | [`Mixture`] | Rao-Blackwellised: one extended Kalman filter per hypothesis | a forecast, linearised |
//! | [`Particles`] | bootstrap, with kernels if it degenerates | a forecast, by Monte Carlo |
//!
//! **Processes.** [`ConstantVelocity`], [`ConstantAcceleration`], [`ConstantTurnRate`] and the kinematic
//! [`Bicycle`]. [`Filter`] is a [`Gaussian`] under one of the two that
//! trackers use, a [`Kind`] chosen at run time.
//!
//! **The learned prior.** A [`Forecast`] is a set of weighted hypotheses about an agent's controls. As the
//! prior of a [`Mixture`] it bridges a gap in which no process model knows the agent's motion. In the example
//! below, the vehicle brakes while it is hidden for 1.6 s. The forecast's controls predict the filter's own
//! posterior, so no measurement is lost. Measurements weigh the hypotheses.
//!
//! **Joint updates.** If several observations may belong to the agent, `update_jointly` weighs them by the
//! probabilities of an association (probabilistic data association).
//!
//! Each step works on a copy. The copy replaces the belief only if every number in it is finite, so a failure
//! costs one step and never the track. Covariances are updated in Joseph form and kept exactly symmetric.
//! They stay positive over millions of steps.
//!
//! ```
//! use filters::{
//!     Bicycle, ControlStep, Forecast, Gaussian, Integrator, Mixture, Observation, Priors,
//! };
//!
//! const TICK_NS: u64 = 80_000_000;
//! const BRAKING_MPS2: f64 = -4.0;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // The state is [x, y, heading, speed, slip]. Under a forecast the process has less noise of its own.
//! let kinematic = Bicycle {
//!     rear_axle_m: 1.2,
//!     integrator: Integrator::Midpoint,
//!     acceleration_mps2: 2.8,
//!     slip_rate_radps: 0.1,
//!     slip_decay_per_s: 0.15,
//!     floor: [1e-4, 1e-4, 1e-5, 0.0, 0.0],
//!     slip_max_rad: 0.5,
//! };
//! let learned = Bicycle { acceleration_mps2: 0.8, ..kinematic };
//! let start = Gaussian::new([0.0, 0.0, 0.0, 10.0, 0.0], [0.1, 0.1, 0.01, 1.0, 0.001]);
//! let mut kalman = start;
//! let mut mixture = Mixture::new(start, Priors::new(kinematic, learned), 1);
//!
//! // For 2 s the vehicle goes straight on at 10 m/s, and both filters measure its position.
//! for tick in 1..=25 {
//!     let observation = Observation::of_position([0.8 * f64::from(tick), 0.0], 0.01);
//!     kalman.predict(TICK_NS, &kinematic)?;
//!     kalman.update(&observation, &kinematic)?;
//!     mixture.predict(TICK_NS)?;
//!     mixture.update(&observation)?;
//! }
//!
//! // Then it brakes, hidden for 1.6 s. A forecast expects that with 80 %, and constant speed with 20 %.
//! let control = |mean| ControlStep { mean: [mean, 0.0], cholesky: [0.3, 0.0, 0.02] };
//! let controls = [[control(BRAKING_MPS2); 12], [control(0.0); 12]].concat();
//! let forecast = Forecast {
//!     age_ns: 0,
//!     step_ns: 400_000_000,
//!     heading_rad: 0.0,
//!     probability: &[0.8, 0.2],
//!     controls: &controls,
//! };
//! mixture.adopt(&forecast)?;
//! for _ in 0..20 {
//!     kalman.predict(TICK_NS, &kinematic)?;
//!     mixture.predict(TICK_NS)?;
//! }
//! let true_x_m = 20.0 + 10.0 * 1.6 + BRAKING_MPS2 / 2.0 * 1.6 * 1.6;
//! let error_m = |state: &Gaussian<5>| (state.mean[0] - true_x_m).abs();
//! assert!(error_m(&mixture.moments()) < 0.5 * error_m(&kalman));
//!
//! // The first measurement after the gap confirms the hypothesis that holds.
//! let observation = Observation::of_position([true_x_m, 0.0], 0.01);
//! mixture.update(&observation)?;
//! assert!(mixture.weight(0) > 0.95);
//! # Ok(())
//! # }
//! ```

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
pub mod noise;
mod observation;
pub mod particles;
mod plan;
mod priors;
mod process;
pub mod weights;

pub use kinematics::Integrator;

pub use bicycle::{Bicycle, BicycleStep, reversed};
pub use constant_acceleration::{ConstantAcceleration, chain_noise};
pub use constant_turn_rate::ConstantTurnRate;
pub use constant_velocity::ConstantVelocity;
pub use control::{
    Control, ControlStep, Controlled, Forecast, ForecastFault, HYPOTHESES_MAX, control_gain, noise_left,
};
pub use filter::{Filter, Kind, Models, Unknown};
pub use gaussian::{FilterFault, Gaussian};
pub use innovation::{Evidence, Innovation, MEASURED_MAX};
pub use mixture::{Ahead, Mixture};
pub use moments::{difference, interpolated, mean, moments, moments_near, sample_moments};
pub use observation::{Motion, OBSERVATIONS_MAX, Observation};
pub use particles::Particles;
pub use priors::Priors;
pub use process::Process;

use std::f64::consts::{PI, TAU};

/// Longest step of a process.
pub const STEP_MAX_NS: u64 = 80_000_000;
const STEP_MAX_S: f64 = 0.08;
/// Longest time that one prediction covers.
pub const GAP_MAX_NS: u64 = 60_000_000_000;

/// The angle wrapped to [−π, π).
#[must_use]
#[inline]
pub fn wrapped(angle_rad: f64) -> f64 {
    if (-PI..PI).contains(&angle_rad) { angle_rad } else { (angle_rad + PI).rem_euclid(TAU) - PI }
}
