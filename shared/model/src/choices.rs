//! Choices between ways to build a model.

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
    /// 64 heads, each with its scores as values: the paper's formula to the letter.
    Literal,
}

/// How the bicycle is integrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Integrator {
    /// All right-hand sides from before the step: the paper's.
    Euler,
    /// Speed, slip and course from the middle of the step.
    Midpoint,
}

/// What the control of a cyclist or pedestrian is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Displacement {
    /// The step's displacement less that of constant velocity.
    Residual,
    /// The step's displacement: the paper's.
    Absolute,
}

/// Where latent variables come from.
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
    /// Nothing: zeros.
    Zeros,
}

/// How attention weighs neighbours and steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Attention {
    /// By the scores of both layers.
    #[default]
    Dual,
    /// All alike: means over neighbours and over steps.
    Equal,
}

/// How vehicles move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum VehicleMotion {
    /// By acceleration and slip rate of the kinematic bicycle.
    #[default]
    Bicycle,
    /// By displacements, as cyclists and pedestrians do.
    Displacement,
}

/// Which networks the agent types have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeTypes {
    /// A state MLP and a decoder each.
    #[default]
    Own,
    /// Those of the pedestrian; the equations of motion still differ by type.
    Same,
}
