//! The options of a model.

use serde::{Deserialize, Serialize};
use thiserror::Error;
use wire::AgentType;

use crate::{
    Attention, Displacement, Feedback, Integrator, Latents, NodeTypes, Stem, Temporal, VehicleMotion,
};

/// A configuration with an invalid value.
#[derive(Debug, Error, PartialEq)]
#[error("{key} = {value}: {reason}")]
pub struct ConfigError {
    /// The key.
    pub key: &'static str,
    /// Value.
    pub value: f64,
    /// The reason.
    pub reason: &'static str,
}

/// The options of a model. Weights contain them as JSON under the metadata key `config`.
///
/// Unknown keys are refused. Keys that were added later have defaults that leave earlier models unchanged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelConfig {
    /// Channels of the CNN's first stage, w.
    pub width: usize,
    /// First layers of the CNN.
    pub stem: Stem,
    /// Side of the context patches, P, in cells.
    pub patch_size: usize,
    /// Side of a patch cell.
    pub patch_cell_m: f32,
    /// Distance of a patch's centre ahead of the agent.
    #[serde(default)]
    pub patch_ahead_m: f32,
    /// Maximum distance between neighbours, d. A distance that is never reached, such as 0.001, leaves only
    /// self edges and so disables the topological attention.
    pub edge_radius_m: f32,
    /// Maximum distance between two pedestrians; `edge_radius_m` if null.
    #[serde(default)]
    pub pedestrian_edge_radius_m: Option<f32>,
    /// Steps of the history, T_h.
    pub history_len: usize,
    /// Steps of the forecast, T_f.
    pub horizon_len: usize,
    /// Spacing of the steps, Δt.
    pub dt_s: f64,
    /// Rounds of topological attention, R.
    pub rounds: usize,
    /// Heads of the topological attention, H.
    pub topological_heads: usize,
    /// Heads of the temporal attention, H_t; ignored by the literal reading, which has 64.
    pub temporal_heads: usize,
    /// Reading of the temporal attention.
    pub temporal: Temporal,
    /// Weights of neighbours and steps in the attention.
    #[serde(default)]
    pub attention: Attention,
    /// Sharing of networks between agent types.
    #[serde(default)]
    pub node_types: NodeTypes,
    /// Whether the messages carry the edge attributes.
    pub edge_in_message: bool,
    /// Whether squared distances are divided by their dimension.
    pub distance_scale: bool,
    /// Factor of position-like features.
    pub position_scale: f32,
    /// Factor of velocity-like features.
    pub velocity_scale: f32,
    /// Slope of the LeakyReLU f_act below 0.
    pub leaky_slope: f32,
    /// Motion of vehicles.
    #[serde(default)]
    pub vehicle_motion: VehicleMotion,
    /// Integrator of the bicycle.
    #[serde(default = "euler")]
    pub integrator: Integrator,
    /// Limit of the acceleration.
    #[serde(default = "accel_limit_mps2")]
    pub accel_limit_mps2: f32,
    /// Limit of the slip rate.
    #[serde(default = "slip_rate_limit_radps")]
    pub slip_rate_limit_radps: f32,
    /// Limit of the slip angle; unlimited if null.
    #[serde(default = "slip_limit_rad")]
    pub slip_limit_rad: Option<f32>,
    /// Whether the initial slip follows from the headings. If not, it is 0.
    #[serde(default = "yes")]
    pub initial_slip: bool,
    /// Distance of the rear axle, as a share of the length.
    #[serde(default = "rear_axle_ratio")]
    pub rear_axle_ratio: f32,
    /// Length of vehicles whose length is unknown.
    #[serde(default = "default_length_m")]
    pub default_length_m: f32,
    /// Whether displacements of cyclists and pedestrians are relative to constant velocity.
    #[serde(default = "residual")]
    pub displacement: Displacement,
    /// The source of latent variables.
    #[serde(default = "normal")]
    pub latents: Latents,
    /// Latent draws per agent, K.
    #[serde(default = "modes")]
    pub modes: usize,
    /// Whether a head predicts the modes' probabilities. If not, they are equal.
    #[serde(default)]
    pub mode_head: bool,
    /// Whether the single best forecast has its own latent point.
    #[serde(default)]
    pub best_latent: bool,
    /// Whether controls are residuals to the base control.
    #[serde(default)]
    pub base: bool,
    /// Whether a linear function of the base control is added to the latent points.
    #[serde(default)]
    pub base_latent: bool,
    /// Whether the base control has bounds of its features from the fit. Beyond them it shrinks to zero
    /// control.
    #[serde(default)]
    pub base_support: bool,
    /// Whether node attributes include a context embedding.
    #[serde(default = "yes")]
    pub context: bool,
    /// Input of the decoder after the first forecast step.
    #[serde(default = "zeros")]
    pub feedback: Feedback,
}

const fn euler() -> Integrator {
    Integrator::Euler
}
const fn accel_limit_mps2() -> f32 {
    6.0
}
const fn slip_rate_limit_radps() -> f32 {
    1.0
}
#[expect(clippy::unnecessary_wraps, reason = "serde wants the field's type")]
const fn slip_limit_rad() -> Option<f32> {
    Some(0.5)
}
const fn yes() -> bool {
    true
}
const fn rear_axle_ratio() -> f32 {
    0.26
}
const fn default_length_m() -> f32 {
    4.5
}
const fn residual() -> Displacement {
    Displacement::Residual
}
const fn normal() -> Latents {
    Latents::Normal
}
const fn modes() -> usize {
    20
}
const fn zeros() -> Feedback {
    Feedback::Zeros
}

impl ModelConfig {
    /// Checks that a model can have these values.
    ///
    /// # Errors
    /// [`ConfigError`] names the first invalid key.
    pub fn check(&self) -> Result<(), ConfigError> {
        let counts = [
            ("width", self.width, 1, 512),
            ("patch_size", self.patch_size, 4, 128),
            ("history_len", self.history_len, 1, 64),
            ("horizon_len", self.horizon_len, 1, 64),
            ("rounds", self.rounds, 1, 3),
            ("modes", self.modes, 1, 64),
        ];
        for (key, value, least, most) in counts {
            if value < least || value > most {
                return Err(ConfigError { key, value: value as f64, reason: "is out of range" });
            }
        }
        for (key, heads) in
            [("topological_heads", self.topological_heads), ("temporal_heads", self.temporal_heads)]
        {
            if heads == 0 || !wire::TEMPORAL.is_multiple_of(heads) {
                return Err(ConfigError { key, value: heads as f64, reason: "does not divide 64" });
            }
        }
        let positive = [
            ("patch_cell_m", self.patch_cell_m),
            ("edge_radius_m", self.edge_radius_m),
            ("pedestrian_edge_radius_m", self.pedestrian_edge_radius_m.unwrap_or(1.0)),
            ("dt_s", self.dt_s as f32),
            ("position_scale", self.position_scale),
            ("velocity_scale", self.velocity_scale),
            ("accel_limit_mps2", self.accel_limit_mps2),
            ("slip_rate_limit_radps", self.slip_rate_limit_radps),
            ("slip_limit_rad", self.slip_limit_rad.unwrap_or(1.0)),
            ("rear_axle_ratio", self.rear_axle_ratio),
            ("default_length_m", self.default_length_m),
        ];
        let finite = [("patch_ahead_m", self.patch_ahead_m), ("leaky_slope", self.leaky_slope)];
        if let Some((key, value)) = finite.into_iter().find(|(_, value)| !value.is_finite()) {
            return Err(ConfigError { key, value: f64::from(value), reason: "is not finite" });
        }
        match positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            Some((key, value)) => {
                Err(ConfigError { key, value: f64::from(value), reason: "is not positive" })
            }
            None if self.base_latent && !(self.base && self.latents == Latents::Points) => Err(ConfigError {
                key: "base_latent",
                value: 1.0,
                reason: "needs a base control and learned latent points",
            }),
            None => Ok(()),
        }
    }

    /// Checks that the model's tensors fit the pipeline's frames.
    ///
    /// # Errors
    /// [`ConfigError`] names the first invalid key.
    pub fn check_frames(&self) -> Result<(), ConfigError> {
        let limits = [
            ("patch_size", self.patch_size, wire::PATCH_SIDE_MAX),
            ("history_len", self.history_len, wire::HISTORY_MAX),
            ("horizon_len", self.horizon_len, wire::HORIZON_MAX),
            ("modes", self.modes, wire::MODES_MAX),
        ];
        match limits.into_iter().find(|(_, value, most)| value > most) {
            Some((key, value, _)) => Err(ConfigError {
                key,
                value: value as f64,
                reason: "is more than the pipeline's frames can carry",
            }),
            None => Ok(()),
        }
    }

    /// Whether agents of this type move by bicycle controls. If not, they move by displacements.
    #[must_use]
    pub fn drives(&self, agent_type: AgentType) -> bool {
        agent_type == AgentType::Vehicle && self.vehicle_motion == VehicleMotion::Bicycle
    }

    /// The type whose state MLP and decoder are used for agents of this type.
    #[must_use]
    pub const fn network_of(&self, agent_type: AgentType) -> AgentType {
        match self.node_types {
            NodeTypes::Own => agent_type,
            NodeTypes::Same => AgentType::Pedestrian,
        }
    }

    /// Components of the state embedding: half of a node attribute, or all of it without context.
    pub const fn state_embedding_len(&self) -> usize {
        if self.context { wire::STATE_EMBEDDING } else { wire::NODE_ATTRIBUTES }
    }

    /// Spacing of the steps in nanoseconds.
    pub fn step_ns(&self) -> u64 {
        (self.dt_s * 1e9).round() as u64
    }
}
