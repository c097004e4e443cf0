//! The options of a model.

use serde::{Deserialize, Serialize};
use thiserror::Error;
use wire::AgentType;

use crate::{
    Attention, Displacement, Feedback, Integrator, Latents, NodeTypes, Stem, Temporal, VehicleMotion,
};

/// A configuration that no model can have.
#[derive(Debug, Error, PartialEq)]
#[error("{key} = {value}: {reason}")]
pub struct ConfigError {
    /// The key.
    pub key: &'static str,
    /// Its value.
    pub value: f64,
    /// The reason.
    pub reason: &'static str,
}

/// The options of a model, as the JSON that its weights carry under the metadata key `config`.
///
/// Unknown keys are refused. Keys that later models added have defaults which leave earlier ones as they
/// were.
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
    /// How far ahead of the agent a patch's centre lies.
    #[serde(default)]
    pub patch_ahead_m: f32,
    /// Largest distance between neighbours, d. One that no two agents come within, such as 0.001, leaves self
    /// edges alone: the topological attention is off.
    pub edge_radius_m: f32,
    /// Largest distance where both are pedestrians; `edge_radius_m` where it is null.
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
    /// How attention weighs neighbours and steps.
    #[serde(default)]
    pub attention: Attention,
    /// Which networks the agent types have.
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
    /// How vehicles move.
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
    /// Limit of the slip angle; none where it is null.
    #[serde(default = "slip_limit_rad")]
    pub slip_limit_rad: Option<f32>,
    /// Whether the first slip follows from the headings; 0 otherwise.
    #[serde(default = "yes")]
    pub initial_slip: bool,
    /// Distance of the rear axle over the length.
    #[serde(default = "rear_axle_ratio")]
    pub rear_axle_ratio: f32,
    /// Length of vehicles whose length is unknown.
    #[serde(default = "default_length_m")]
    pub default_length_m: f32,
    /// What the displacements of cyclists and pedestrians are relative to.
    #[serde(default = "residual")]
    pub displacement: Displacement,
    /// Where latent variables come from.
    #[serde(default = "normal")]
    pub latents: Latents,
    /// Latent draws per agent, K.
    #[serde(default = "modes")]
    pub modes: usize,
    /// Whether a head predicts the modes' probabilities; they are equal otherwise.
    #[serde(default)]
    pub mode_head: bool,
    /// Whether the single best forecast has a latent point of its own.
    #[serde(default)]
    pub best_latent: bool,
    /// Whether controls are residuals to the base control.
    #[serde(default)]
    pub base: bool,
    /// Whether latent points depend on the base control: a linear function of it is added to the point.
    #[serde(default)]
    pub base_latent: bool,
    /// Whether the base control has bounds of the features that it was fitted to, beyond which it shrinks to
    /// zero control.
    #[serde(default)]
    pub base_support: bool,
    /// Whether nodes carry a context embedding.
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
    /// Refuses values that no model can have.
    ///
    /// # Errors
    /// [`ConfigError`] names the first key that is off.
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

    /// Refuses a model whose tensors do not fit the pipeline's frames.
    ///
    /// # Errors
    /// [`ConfigError`] names the first key that is off.
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

    /// Whether agents of a type are moved by the controls of a bicycle, and by displacements otherwise.
    #[must_use]
    pub fn drives(&self, agent_type: AgentType) -> bool {
        agent_type == AgentType::Vehicle && self.vehicle_motion == VehicleMotion::Bicycle
    }

    /// The type whose state MLP and decoder serve agents of a type.
    #[must_use]
    pub const fn network_of(&self, agent_type: AgentType) -> AgentType {
        match self.node_types {
            NodeTypes::Own => agent_type,
            NodeTypes::Same => AgentType::Pedestrian,
        }
    }

    /// Components of the state embedding: half of a node attribute, or all of it without context.
    #[must_use]
    pub const fn state_embedding_len(&self) -> usize {
        if self.context { wire::STATE_EMBEDDING } else { wire::NODE_ATTRIBUTES }
    }

    /// Spacing of the steps in nanoseconds.
    #[must_use]
    pub fn step_ns(&self) -> u64 {
        (self.dt_s * 1e9).round() as u64
    }
}
