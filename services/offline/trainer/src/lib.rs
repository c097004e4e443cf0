//! Training of the STG-DAT network, from recordings to a weights file.
//!
//! The network is written a second time here, layer by layer with its way back (`net`), under the tensor names of the
//! weights file; features, maps and the base control come from the same code as onboard, and both forward passes are held
//! to the same golden vectors.
//!
//! A run has three parts. Recordings become scenes (windows, and a causal map patch for every agent and frame), which
//! wait in a scratch file beside the checkpoints: memory need only hold the largest recording. The *base control* — ridge
//! regression and anchors — is fitted to them. Then the network learns what to add, batch by batch; its running average
//! is validated from time to time, and the best one is written with a model card.
//!
//! A seed fixes everything random, so that a run on one machine can be repeated to the bit.

mod ablations;
#[cfg(test)]
mod agreement;
mod base;
mod batch;
mod calibration;
mod card;
mod checkpoint;
mod error;
mod log;
mod machine;
mod net;
mod objective;
mod optimiser;
mod options;
mod presets;
mod progress;
mod recipes;
#[cfg(test)]
mod recordings;
mod rollout;
mod samples;
mod spool;
mod train;
mod validate;
mod view;

pub use card::{Gain, ModelCard, Seen};
pub use error::TrainError;
pub use objective::{LossParts, Objective};
pub use optimiser::OptimiserOptions;
pub use options::{TrainOptions, onboard_config};
pub use presets::PRESETS;
pub use recipes::{RECIPES, recipe};
pub use samples::Source;
pub use train::{Summary, train};
pub use validate::{Errors, SetScore, choose_by};
