//! Turns controls into trajectories: the last stage of a tick.
//!
//! Every track gets a forecast at every tick, whatever became of its controls. The [`Sampler`] takes the best that there
//! is, and the forecast tells which it was, why, and how old:
//!
//! * *learned*: the controls of this tick, carried through the kinematic layer mode by mode — as linearised Gaussians or
//!   as particles ([`Propagation`]);
//! * *held*: the last learned forecast of the track, moved on to now, while it is not too old;
//! * *kinematic*: no control at all, with a covariance that grows.
//!
//! The modes of an agent make a mixture; its mean and covariance are told beside them.

mod held;
mod kept;
mod kinematic;
mod learned;
mod motion;
mod options;
mod sampler;
mod settings;
pub mod stage;

pub use options::{Options, Propagation, PropagationKind, STAGE, SamplerOptions};
pub use sampler::Sampler;
