//! Training of the STG-DAT network, from recordings to a weights file.
//!
//! The network is written a second time here, on tensors that can be differentiated, under the tensor names of the
//! weights file; features, maps and the base control come from the same code as onboard, and both forward passes are
//! held to the same golden vectors.
//!
//! A run has three parts. Recordings become scenes in memory (windows, and a causal map patch for every
//! agent and frame). The *base control* — ridge regression and anchors — is fitted to them. Then the network learns
//! what to add, batch by batch; its running average is validated from time to time, and the best one is written with a
//! model card.
//!
//! All tensors are created on the [`Device`] that [`train`] is given: the CPU, or any other that burn
//! was built with. A seed fixes everything random, so that a run on one machine can be repeated to the bit.

mod base;
mod batch;
mod card;
mod checkpoint;
mod error;
pub mod loss;
pub mod model;
pub mod motion;
mod net;
mod objective;
mod optimiser;
mod options;
mod parameters;
mod progress;
mod rollout;
mod samples;
mod train;
mod validate;
mod view;

pub use burn::tensor::Device;
pub use card::{Gain, ModelCard, Seen};
pub use error::TrainError;
pub use objective::{LossParts, Objective};
pub use optimiser::{Adam, OptimiserOptions};
pub use options::{TrainOptions, onboard_config};
pub use parameters::{Parameters, Precision, Role, Weights};
pub use samples::Source;
pub use train::{Summary, train};
pub use validate::{Errors, SetScore, choose_by};
