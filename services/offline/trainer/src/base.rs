//! The base control: the forecast to which the network adds a residual. \[model §3, Base control\]
//!
//! A ridge regression per history class and speed bin maps 26 features of the newest states to a control
//! sequence `[horizon × 2]`. The residuals between its forecasts and the recorded futures form 20 clusters
//! per bin of (speed, acceleration, yaw rate). The mean control residual of a cluster is an *anchor*. Ridge
//! plus anchors is a forecaster with modes (B\*), and the network starts from it.

mod fit;
mod fitness;
mod tables;
mod targets;

use std::collections::BTreeMap;
use std::sync::Arc;

use nn::{ModelConfig, base as binning};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scene::{AgentFrame, AgentType, State};
use wire::AGENT_TYPES;

use crate::TrainError;
use crate::net::layout::TYPE_NAMES;
use crate::net::tensors::{TensorRole, Tensors};
use crate::samples::Agent;
pub(crate) use fit::Augmentation;
use fit::Sample;
pub use fitness::Fitness;
use tables::{EVERYWHERE, TypeBase, describe};

/// Maximum number of agents per type in the fit, spread evenly.
pub(crate) const FITTED_MAX: usize = 60_000;

/// Fewest agents of a type to which its base control is fitted again.
pub(crate) const REFITTED_MIN: usize = 100;

/// The base control of all agent types.
#[derive(Clone, Debug)]
pub(crate) struct BaseControl {
    config: ModelConfig,
    types: Vec<TypeBase>,
}

/// Base control of one agent.
#[derive(Debug)]
pub(crate) struct AgentBase<'a> {
    /// `[horizon × 2]`.
    pub(crate) ridge: Vec<f32>,
    /// `[(modes + 1) × horizon × 2]`.
    pub(crate) anchors: &'a [f32],
    /// Share of the network's controls that is kept at this distance from the support.
    pub(crate) share: f32,
}

impl BaseControl {
    /// A base that adds nothing: constant velocity for cyclists and pedestrians, zero control for vehicles.
    pub(crate) fn zero(config: &ModelConfig) -> Self {
        let zero = |agent_type: &AgentType| TypeBase::zero(config, *agent_type);
        Self { config: config.clone(), types: AGENT_TYPES.iter().map(zero).collect() }
    }

    /// Fits ridge and anchors to the agents with a known future. Each history is also cut to every class. A type
    /// with fewer than [`REFITTED_MIN`] agents keeps the base that it has in `before`.
    ///
    /// `agents` reads the agents of a type; the fit uses at most [`FITTED_MAX`] of them.
    pub(crate) fn fit<A>(
        config: &ModelConfig,
        before: Option<&Self>,
        agents: impl Fn(AgentType) -> A,
        augmentation: Augmentation,
        vehicle_speed_cuts_mps: Option<[f32; binning::SPEED_BINS - 1]>,
        seed: u64,
    ) -> Result<Self, TrainError>
    where
        A: Iterator<Item = Result<Arc<Agent>, TrainError>>,
    {
        let types = AGENT_TYPES.iter().map(|&agent_type| {
            let mut zero = TypeBase::zero(config, agent_type);
            if let Some(cuts_mps) = vehicle_speed_cuts_mps
                && agent_type == AgentType::Vehicle
            {
                zero.speed_cuts_mps = cuts_mps;
            }
            if let Some(before) = before
                && agents(agent_type).take(REFITTED_MIN).count() < REFITTED_MIN
            {
                return Ok(before.types[agent_type as usize].clone());
            }
            let samples = samples(
                config,
                agents(agent_type),
                &zero.speed_cuts_mps,
                augmentation,
                &mut ChaCha8Rng::seed_from_u64(seed),
            )?;
            zero.fit(agent_type, &samples, config, seed)?;
            Ok(zero)
        });
        Ok(Self { config: config.clone(), types: types.collect::<Result<_, TrainError>>()? })
    }

    /// Fits only the support, to the windows that [`BaseControl::fit`] would use.
    pub(crate) fn fit_support<A>(
        &mut self,
        agents: impl Fn(AgentType) -> A,
        augmentation: Augmentation,
        seed: u64,
    ) -> Result<(), TrainError>
    where
        A: Iterator<Item = Result<Arc<Agent>, TrainError>>,
    {
        for (&agent_type, base) in AGENT_TYPES.iter().zip(&mut self.types) {
            let samples = samples(
                &self.config,
                agents(agent_type),
                &base.speed_cuts_mps,
                augmentation,
                &mut ChaCha8Rng::seed_from_u64(seed),
            )?;
            base.fit_support(&samples);
        }
        Ok(())
    }

    /// The base control of an agent with this history.
    pub(crate) fn of(
        &self,
        agent_type: AgentType,
        history: &[Option<State>],
        frame: &AgentFrame,
    ) -> AgentBase<'_> {
        let base = &self.types[agent_type as usize];
        let (features, bins) = describe(history, frame, &base.speed_cuts_mps, &self.config);
        let control_count = 2 * self.config.horizon_len;
        let per_bin = (self.config.modes + 1) * control_count;
        let (features, outside) = base.supported(&features, bins);
        let share = binning::kept_share(outside);
        let mut ridge = base.ridge(&features, bins, control_count);
        let anchors = &base.anchors[bins.bin * per_bin..][..per_bin];
        if share < 1.0 {
            ridge.iter_mut().for_each(|control| *control *= share);
        }
        AgentBase { ridge, anchors, share }
    }

    /// The motion within the support of each agent type, for whole histories; empty without a support.
    pub(crate) fn fitness(&self) -> BTreeMap<String, Fitness> {
        let of_type = |(name, base): (&&str, &TypeBase)| {
            let whole = (binning::CLASSES - 1) * binning::FEATURES;
            let bounds = base.support.as_ref()?.get(whole..)?;
            Some(((*name).to_owned(), Fitness::within(bounds)))
        };
        TYPE_NAMES.iter().zip(&self.types).filter_map(of_type).collect()
    }

    /// Adds the tensors `base.*`.
    pub(crate) fn store(&self, weights: &mut Tensors) {
        let control_count = 2 * self.config.horizon_len;
        let (modes, horizon) = (self.config.modes, self.config.horizon_len);
        for (name, base) in TYPE_NAMES.iter().zip(&self.types) {
            let mut fixed = |tensor: &str, shape: &[usize], values: Vec<f32>| {
                weights.insert(&format!("base.{name}.{tensor}"), shape, values, TensorRole::Fixed);
            };
            let shape = [binning::CLASSES, binning::SPEED_BINS, binning::FEATURES, control_count];
            fixed("ridge", &shape, base.ridge.clone());
            let per_bin = base.anchors.chunks_exact((modes + 1) * control_count);
            let anchors = per_bin.flat_map(|bin| &bin[..modes * control_count]).copied().collect();
            fixed("anchors", &[binning::BINS, modes, horizon, 2], anchors);
            fixed("speed_cuts", &[binning::SPEED_BINS - 1], base.speed_cuts_mps.to_vec());
            if let Some(support) = &base.support {
                let bounds = support.as_flattened().to_vec();
                fixed("support", &[binning::CLASSES, binning::FEATURES, 2], bounds);
            }
        }
    }

    /// Reads the tensors `base.*`; `None` if they are missing.
    pub(crate) fn load(weights: &Tensors, config: &ModelConfig) -> Option<Self> {
        let control_count = 2 * config.horizon_len;
        let types = TYPE_NAMES.iter().map(|name| {
            let values = |tensor: &str| Some(weights.0.get(&format!("base.{name}.{tensor}"))?.values.clone());
            let per_bin = config.modes * control_count;
            let with_zero =
                |bin: &[f32]| bin.iter().copied().chain(std::iter::repeat_n(0.0, control_count)).collect();
            Some(TypeBase {
                speed_cuts_mps: values("speed_cuts")?.try_into().ok()?,
                support: match (config.base_support, values("support")) {
                    (true, Some(bounds)) => Some(bounds.as_chunks().0.to_vec()),
                    (true, None) => Some(vec![EVERYWHERE; binning::CLASSES * binning::FEATURES]),
                    (false, _) => None,
                },
                ridge: values("ridge")?,
                anchors: values("anchors")?
                    .chunks_exact(per_bin)
                    .flat_map(|bin| -> Vec<f32> { with_zero(bin) })
                    .collect(),
            })
        });
        Some(Self { config: config.clone(), types: types.collect::<Option<_>>()? })
    }
}

/// The windows of a type that a fit uses.
fn samples(
    config: &ModelConfig,
    agents: impl Iterator<Item = Result<Arc<Agent>, TrainError>>,
    cuts_mps: &[f32],
    augmentation: Augmentation,
    random: &mut ChaCha8Rng,
) -> Result<Vec<Sample>, TrainError> {
    let mut samples = Vec::new();
    for agent in agents {
        samples.extend(Sample::of_every_class(&agent?, config, cuts_mps, augmentation, random));
    }
    Ok(samples)
}
