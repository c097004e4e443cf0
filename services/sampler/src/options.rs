use std::path::PathBuf;

use kinematics::{MotionKind, MotionOptions, PARTICLES_MAX};
use run::{Conflict, Declaration};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::{ControlsTopic, ForecastsTopic, StageId, TICK_MS, Topic, TracksTopic};

/// The sampler.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Sampler, &[TracksTopic::NAME, ControlsTopic::NAME], &[ForecastsTopic::NAME])
        .with_rule(Options::check);

/// What may be set of the sampler.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Time after its release for which a tick waits for its controls, in milliseconds; at most the interval,
    /// and without limit in lockstep.
    #[schemars(range(max = TICK_MS), extend("exclusiveMinimum" = 0.0))]
    pub deadline_ms: f64,
    /// Whether forecasts are corrected by the retrieval memory: by the residuals that agents before had to
    /// their forecasts.
    #[schemars(extend("formerly" = "recall"))]
    pub retrieval: bool,
    /// Whether the forecasts that have matured decide how network and kinematic experts are blended, and how
    /// wide regions are; without, the network's are published as they are.
    pub evidence: bool,
    /// File of the retrieval memory: read at the start, if it exists (warm start), and written at the end.
    #[schemars(extend("format" = "path"))]
    pub memory: Option<PathBuf>,
    /// How the covariance of the controls becomes that of the positions.
    pub propagation: PropagationKind,
    /// Particles per mode of the Monte Carlo propagation.
    #[schemars(range(min = 1, max = PARTICLES_MAX))]
    pub particles: usize,
}

/// How the covariance of the controls becomes that of the positions, by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PropagationKind {
    /// Gaussians through the derivatives of the motion model.
    #[default]
    Linearised,
    /// Particles through the motion model itself.
    MonteCarlo,
}

impl Default for Options {
    fn default() -> Self {
        let propagation = PropagationKind::default();
        Self { deadline_ms: 72.0, retrieval: true, evidence: true, memory: None, propagation, particles: 16 }
    }
}

impl Options {
    fn check(&self) -> Result<(), Conflict> {
        match &self.memory {
            Some(_) if !self.retrieval => Err(Conflict {
                key: "memory",
                reason: "a memory that nothing is to be retrieved from",
                because: "`retrieval` is false",
            }),
            _ => Ok(()),
        }
    }
}

/// How the covariance of the controls becomes that of the positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Propagation {
    /// One Gaussian per mode, through the derivatives of the motion model.
    #[default]
    Linearised,
    /// Particles per mode, through the motion model itself.
    MonteCarlo {
        /// Particles of each mode, at most [`kinematics::PARTICLES_MAX`].
        particles: usize,
    },
}

/// Settings of a [`Sampler`](crate::Sampler).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplerOptions {
    /// Steps of the history window, T_h.
    pub history_len: usize,
    /// Steps of the forecast, T_f.
    pub horizon_len: usize,
    /// What the controls of vehicles are; those of all others are displacements.
    pub vehicle_motion: MotionKind,
    /// The constants of motion.
    pub motion: MotionOptions,
    /// Whether a forecast's covariance begins at the track's own; 0 otherwise.
    pub initial_covariance: bool,
    /// How the covariance of the controls becomes that of the positions.
    pub propagation: Propagation,
    /// Seed of the particles' random numbers.
    pub seed: u64,
    /// Whether forecasts are corrected by the retrieval memory.
    pub retrieval: bool,
    /// Whether the forecasts that have matured decide on blend and widths.
    pub evidence: bool,
    /// Greatest age at which a learned forecast is published again as held.
    pub max_age_ns: u64,
}

impl Default for SamplerOptions {
    fn default() -> Self {
        Self {
            history_len: 8,
            horizon_len: 12,
            vehicle_motion: MotionKind::Bicycle,
            motion: MotionOptions::default(),
            initial_covariance: true,
            propagation: Propagation::Linearised,
            seed: 0,
            retrieval: true,
            evidence: false,
            max_age_ns: 1_600_000_000,
        }
    }
}
