//! Turns controls into trajectories: the last stage of a tick.
//!
//! Every track gets a forecast at every tick, for as long as the policy of [`Degradation`] allows. This also
//! holds if its controls are late, missing or refused. The [`Sampler`] takes the first of these that it has,
//! and the forecast contains its quality, cause and age:
//!
//! * *learned*: the controls of this tick, taken through the kinematic layer mode by mode. The widths of the
//!   modes come from the evidence or, without it, from linearised Gaussians or particles ([`Propagation`]);
//! * *held*: the last forecast of the track from controls, moved on to the present, until it is too old;
//! * *kinematic*: zero control, with a covariance that grows.
//!
//! With evidence, the single best forecast is a blend of the network and kinematic experts, weighted by their
//! matured forecasts. Modes of a fan replace some of the network's modes: see [`evidence`]. If constant
//! velocity has most of the weight, the forecast is marked as kinematic, with the cause *outdone*.
//!
//! If the sampler has a lane map, forecasts of vehicles follow its lanes: see [`lanes`].
//!
//! The modes of an agent form a mixture. Its mean and covariance are published as well.

mod degradation;
mod experts;
mod fallback;
mod guidance;
mod held;
pub mod journal;
mod kinematic;
mod learned;
mod memory;
mod motion;
mod options;
mod published;
mod sampler;
mod settings;
mod spread;
pub mod state;
mod step;
mod tick;
mod turns;

pub use degradation::{Change, Degradation, Level, TRANSITIONS};
pub use memory::{open, save_memory};
pub use options::{LanesOrigin, Options, Propagation, PropagationKind, STAGE, SamplerOptions};
pub use sampler::Sampler;
pub use step::run;
