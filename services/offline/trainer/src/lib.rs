//! Training of the STG-DAT network, from recordings to a weights file. \[model §5\]
//!
//! * **In:** [`TrainOptions`] (a [recipe](recipe()), possibly with [`PRESETS`]) and a folder of data sets,
//!   which crate `data` reads.
//! * **Out:** [`TrainOptions::out`], a safetensors file with the tensors of \[model §3\] in half precision,
//!   the model's configuration and a [`ModelCard`]. Checkpoints and a log of JSON lines are in the checkpoint
//!   folder. Errors are in metres.
//!
//! This crate has its own implementation of the layers, each with its backward pass (`net`), under the tensor
//! names of the weights file. Features, maps, base control and equations of motion are the onboard code. Both
//! forward passes are tested against the same golden vectors.
//!
//! [`train`] has three parts:
//!
//! 1. Recordings become scenes in a scratch file: windows, and a causal map patch for every agent and frame.
//!    So only the largest recording must fit into memory.
//! 2. The *base control*, ridge regression and anchors, is fitted to the scenes.
//! 3. The network learns the residual to the base control, batch by batch. The running average of its weights
//!    is validated periodically, and the best is written.
//!
//! One seed determines all random numbers: a run on one machine repeats to the bit.

mod agent_view;
mod base;
mod batch;
mod calibration;
mod card;
mod checkpoint;
mod error;
mod kernel;
mod log;
mod machine;
mod net;
mod objective;
mod optimiser;
mod options;
mod own;
mod presets;
mod progress;
mod recipes;
mod rollout;
mod samples;
mod score;
mod spool;
#[cfg(test)]
mod tests;
mod threads;
mod train;
mod validate;
mod view;
mod windows;

pub use batch::{Array, Values};
pub use card::{Gain, ModelCard, Seen};
pub use error::{TensorError, TrainError};
pub use objective::{LossParts, Objective};
pub use optimiser::OptimiserOptions;
pub use options::TrainOptions;
pub use own::{begin_with_onboard, own, split_in_time, validation_recordings};
pub use presets::PRESETS;
pub use recipes::{RECIPES, recipe};
pub use samples::Source;
pub use score::SetScore;
pub use train::{Summary, train};
pub use windows::{BatchGradients, Windows};
