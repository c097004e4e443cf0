use std::borrow::Cow;
use std::path::PathBuf;

use kinematics::{MotionKind, MotionOptions, PARTICLES_MAX};
use lanes::{Coordinates, UnknownCoordinates};
use nn::WORKERS_MAX;
use run::{Conflict, Declaration, SpeedLimits};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize, Serializer};
use wire::{AgentType, MODES_MAX, StageId, TICK_MS, WorldOrigin};

use crate::{Degradation, Sampler};

/// The sampler.
pub const STAGE: Declaration<Options> =
    ports::declare::<Sampler, _>(StageId::Sampler).with_rule(Options::check);

/// What may be set of the sampler.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Time that a tick waits for its controls after its release, ms; at most the interval, and unlimited in
    /// lockstep.
    #[schemars(range(max = TICK_MS), extend("exclusiveMinimum" = 0.0))]
    pub deadline_ms: f64,
    /// Maximum age of a learned forecast that is republished, shifted to the current time, while an agent has
    /// no new one, in seconds. After that, zero control forecasts the agent.
    #[schemars(range(min = 0, max = 10))]
    pub held_s: f64,
    /// Time for which zero control then forecasts the agent, in seconds. After that, the agent has no
    /// forecast until it has a learned one again. Unlimited if not given.
    #[schemars(range(min = 0, max = 3600))]
    pub kinematic_s: Option<f64>,
    /// Whether the retrieval memory corrects forecasts, by the residuals of earlier agents in similar
    /// situations.
    pub retrieval: bool,
    /// Whether matured forecasts determine the blend of network and kinematic experts and the size of
    /// regions. If false, the network's forecasts are published unchanged.
    pub evidence: bool,
    /// Whether forecasts contain the conflicts of their agent: with whom, how probably and when.
    pub conflicts: bool,
    /// File of the retrieval memory: read at the start if it exists (warm start), and written at the end.
    #[schemars(extend("format" = "path"))]
    pub memory: Option<PathBuf>,
    /// File of the learned state, which is the retrieval memory and the evidence: read at the start if it exists,
    /// and written every minute and at the end. Not in lockstep.
    #[schemars(extend("format" = "path"))]
    pub state: Option<PathBuf>,
    /// File of priors of the experts, which replaces the shipped priors: what earlier recordings of these roads
    /// show. `stgdat evaluate driving --prior` and `python -m stgdat.fleet priors` write it.
    #[schemars(extend("format" = "path"))]
    pub prior: Option<PathBuf>,
    /// Lanelet2 map of the site (OSM XML). Forecasts of vehicles follow its lanes.
    #[schemars(extend("format" = "path"))]
    pub lanes: Option<PathBuf>,
    /// Origin of the world frame in that map: latitude and longitude in degrees, as in `49.01,8.42`, or a
    /// position in the map's own frame in metres, as in `81000,50000m`. If not given, it is the run's origin
    /// in the map's own frame: the tags `local_x` and `local_y` of its nodes, or latitude and longitude about
    /// 0,0.
    pub lanes_origin: Option<LanesOrigin>,
    /// How the covariance of the controls is propagated to the positions, if evidence is not in use.
    pub propagation: PropagationKind,
    /// Particles per mode of the Monte Carlo propagation.
    #[schemars(range(min = 1, max = PARTICLES_MAX))]
    pub particles: usize,
    /// Number of threads for the work of a tick; by default one per available processor, at most 4. Forecasts
    /// do not depend on it.
    #[schemars(range(min = 1, max = WORKERS_MAX))]
    pub workers: Option<usize>,
}

/// The origin of a map of lanes, as text `LATITUDE,LONGITUDE` or `X,Ym`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "String")]
pub struct LanesOrigin(pub Coordinates);

impl LanesOrigin {
    /// Where the positions of a map come from: by its own origin, else by that of the run.
    #[must_use]
    pub fn coordinates(origin: Option<Self>, run: WorldOrigin) -> Coordinates {
        let of_run = if run.is_zero() { Coordinates::Default } else { Coordinates::Less(run) };
        origin.map_or(of_run, |Self(origin)| origin)
    }
}

impl TryFrom<String> for LanesOrigin {
    type Error = UnknownCoordinates;

    fn try_from(text: String) -> Result<Self, UnknownCoordinates> {
        text.parse().map(Self)
    }
}

impl Serialize for LanesOrigin {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&self.0)
    }
}

impl JsonSchema for LanesOrigin {
    fn schema_name() -> Cow<'static, str> {
        "LanesOrigin".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "expected": "LATITUDE,LONGITUDE in degrees or X,Y in metres as in 81000,50000m" })
    }
}

/// How the covariance of the controls is propagated to the positions, by name.
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
        Self {
            deadline_ms: 72.0,
            held_s: 1.6,
            kinematic_s: None,
            retrieval: true,
            evidence: true,
            conflicts: false,
            memory: None,
            state: None,
            prior: None,
            lanes: None,
            lanes_origin: None,
            propagation,
            particles: 16,
            workers: None,
        }
    }
}

impl Options {
    pub(crate) fn degradation(&self) -> Degradation {
        let ns = |s: f64| (s * 1e9) as u64;
        Degradation { held_ns: ns(self.held_s), kinematic_ns: self.kinematic_s.map(ns) }
    }

    fn check(&self) -> Result<(), Conflict> {
        if self.lanes_origin.is_some() && self.lanes.is_none() {
            return Err(Conflict {
                key: "lanes_origin",
                reason: "an origin without a map",
                because: "`lanes` is not set",
            });
        }
        if self.prior.is_some() && !self.evidence {
            return Err(Conflict {
                key: "prior",
                reason: "a prior of experts that are not in use",
                because: "`evidence` is false",
            });
        }
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

/// How the covariance of the controls is propagated to the positions.
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
    /// Modes of the model, K.
    pub modes_len: usize,
    /// Meaning of the controls of vehicles. The controls of all others are displacements.
    pub vehicle_motion: MotionKind,
    /// The constants of motion.
    pub motion: MotionOptions,
    /// Whether a forecast's covariance begins at the track's own; 0 otherwise.
    pub initial_covariance: bool,
    /// How the covariance of the controls is propagated to the positions.
    pub propagation: Propagation,
    /// Seed of the particles' random numbers.
    pub seed: u64,
    /// Whether forecasts are corrected by the retrieval memory.
    pub retrieval: bool,
    /// Whether the forecasts that have matured decide on blend and widths.
    pub evidence: bool,
    /// Whether forecasts contain the conflicts of their agent.
    pub conflicts: bool,
    /// What is published of an agent without a learned forecast.
    pub degradation: Degradation,
    /// Highest speed of each type, as the run's tracker has it.
    pub speed_limits: SpeedLimits,
    /// Time after a tick's release for which the controls are awaited.
    pub deadline_ns: u64,
}

impl SamplerOptions {
    /// Longest step of an agent of that type.
    pub(crate) const fn step_max_m(&self, agent_type: AgentType, dt_s: f32) -> f32 {
        self.speed_limits.of(agent_type) as f32 * dt_s
    }

    /// How agents of a type move.
    pub(crate) const fn kind_of(&self, agent_type: AgentType) -> MotionKind {
        match agent_type {
            AgentType::Vehicle => self.vehicle_motion,
            AgentType::Cyclist | AgentType::Pedestrian => MotionKind::Displacement,
        }
    }
}

impl Default for SamplerOptions {
    fn default() -> Self {
        Self {
            history_len: 8,
            horizon_len: 12,
            modes_len: MODES_MAX,
            vehicle_motion: MotionKind::Bicycle,
            motion: MotionOptions::default(),
            initial_covariance: true,
            propagation: Propagation::Linearised,
            seed: 0,
            retrieval: true,
            evidence: true,
            conflicts: false,
            degradation: Degradation::default(),
            speed_limits: SpeedLimits::default(),
            deadline_ns: u64::MAX,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_of_a_stage_and_of_a_sampler_agree() {
        let (stage, sampler) = (Options::default(), SamplerOptions::default());
        assert_eq!((stage.evidence, stage.retrieval), (sampler.evidence, sampler.retrieval));
        assert_eq!(stage.degradation(), sampler.degradation);
    }
}
