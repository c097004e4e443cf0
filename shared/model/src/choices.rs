//! Alternatives in the design of a model.

use serde::{Deserialize, Serialize};

/// First layers of the context CNN.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stem {
    /// Convolution 7×7/2, batch norm, ReLU, max-pool 3×3/2: for patches of 32 cells and more.
    Imagenet,
    /// Convolution 3×3/2, batch norm, ReLU: for patches of 16 cells.
    Compact,
}

/// The two readings of the temporal attention's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Temporal {
    /// Each head has a matrix of values.
    ValueMatrix,
    /// 64 heads whose scores are also their values: the literal reading of the paper's formula.
    Literal,
}

/// Integration of the bicycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// All right-hand sides use the state before the step, as in the paper.
    Euler,
    /// Speed, slip and course in the middle of the step.
    Midpoint,
}

/// The control of a cyclist or pedestrian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Displacement {
    /// The step's displacement minus the displacement at constant velocity.
    Residual,
    /// The step's displacement, as in the paper.
    Absolute,
}

/// The source of latent variables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Latents {
    /// Draws from N(0, I).
    Normal,
    /// A learned set of points per agent type.
    Points,
}

/// Input of the decoder after the first forecast step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feedback {
    /// Zeros.
    Zeros,
}

/// The weights of neighbours and steps in the attention.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Attention {
    /// By the scores of both layers.
    #[default]
    Dual,
    /// Equal weights: means over neighbours and over steps.
    Equal,
}

/// Motion of vehicles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VehicleMotion {
    /// By acceleration and slip rate of the kinematic bicycle.
    #[default]
    Bicycle,
    /// By displacements, as cyclists and pedestrians do.
    Displacement,
}

/// Sharing of networks between agent types.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeTypes {
    /// Each type has a state MLP and a decoder.
    #[default]
    Own,
    /// All types use those of the pedestrian. The equations of motion still differ by type.
    Same,
}
