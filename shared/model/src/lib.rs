//! A model's configuration, without its tensors: the sizes of its layers, its equations of motion, its
//! history and horizon.
//!
//! Weights carry the [`ModelConfig`] that they were trained for. The launcher of a run writes it as [`FILE`]
//! into the run's directory, so that a stage that needs sizes alone opens no weights.

mod choices;
mod config;
mod file;

pub use choices::{
    Attention, Displacement, Feedback, Integrator, Latents, NodeTypes, Stem, Temporal, VehicleMotion,
};
pub use config::{ConfigError, ModelConfig};
pub use file::{FILE, ModelFileError};
