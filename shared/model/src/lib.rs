//! A model's configuration without its tensors: sizes of layers, equations of motion, history and horizon.
//!
//! Weights contain the [`ModelConfig`] that they were trained for. The launcher writes it to the run's
//! directory as [`FILE`]. So a stage that needs only sizes does not open the weights.

mod choices;
mod config;
mod file;

pub use choices::{
    Attention, Displacement, Feedback, Integrator, Latents, NodeTypes, Stem, Temporal, VehicleMotion,
};
pub use config::{ConfigError, ModelConfig};
pub use file::{FILE, ModelFileError};
