//! Errors of the weights on validation scenes, compared with forecasts without a network. \[model §6\]
//!
//! **In:** weights and the validation samples. **Out:** a [`SetScore`] per data set: ADE and FDE in metres of
//! the best mode, of the single best forecast, of the base control (B\*) and of two baselines, over the
//! agents with a target.

use std::collections::BTreeMap;
use std::sync::Arc;

use data::sets::DataSet;
use metrics::{Anchors, DisplacementMean, Errors, Point, constant_velocity, displacement, min_displacement};
use nn::{Latents, ModelConfig};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use scene::AgentType;

use crate::TrainError;
use crate::agent_view::SceneView;
use crate::base::BaseControl;
use crate::batch::{Batch, BatchOptions};
use crate::net::context::Normalisation;
use crate::net::graph::encode;
use crate::net::layout::LATENT;
use crate::net::matrix::Matrix;
use crate::net::tensors::Tensors;
use crate::rollout::TypeForecast;
use crate::samples::{Agent, MapKind, Samples, SetSamples, Window};
use crate::score::{SetScore, rounded};
use crate::threads;
use crate::view;

/// Maximum number of agents shown from a crowd.
const SCENE_AGENTS: usize = 48;
const BATCH_AGENTS: usize = 96;
/// Maximum number of windows per set and type that anchors are fitted to.
const ANCHOR_WINDOWS: usize = 20_000;

/// The 20 residual anchors of every (set, type), fitted to training windows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Baselines {
    of_set: BTreeMap<(DataSet, AgentType), Anchors>,
    pooled: BTreeMap<AgentType, Anchors>,
}

impl Baselines {
    pub(crate) fn fit(training: &Samples, config: &ModelConfig, seed: u64) -> Result<Self, TrainError> {
        let mut baselines = Self::default();
        for agent_type in wire::AGENT_TYPES {
            let fit = |sets: &[SetSamples]| {
                let agents = training.spread(sets, agent_type, ANCHOR_WINDOWS);
                fit_anchors(agents, agent_type, config, seed)
            };
            for set in &training.sets {
                if let Some(anchors) = fit(std::slice::from_ref(set))? {
                    baselines.of_set.insert((set.set, agent_type), anchors);
                }
            }
            if let Some(anchors) = fit(&training.sets)? {
                baselines.pooled.insert(agent_type, anchors);
            }
        }
        Ok(baselines)
    }

    /// The anchors of the set, or of all sets if the set's training data have no agent of this type.
    fn of(&self, set: DataSet, agent_type: AgentType) -> Option<&Anchors> {
        self.of_set.get(&(set, agent_type)).or_else(|| self.pooled.get(&agent_type))
    }
}

fn fit_anchors(
    agents: impl Iterator<Item = Result<Arc<Agent>, TrainError>>,
    agent_type: AgentType,
    config: &ModelConfig,
    seed: u64,
) -> Result<Option<Anchors>, TrainError> {
    let agents = agents.collect::<Result<Vec<_>, _>>()?;
    let windows: Vec<_> = agents.iter().map(|agent| (&agent.history, agent.future_m())).collect();
    let windows: Vec<metrics::Window<'_>> =
        windows.iter().map(|(history, future)| metrics::Window { history, future }).collect();
    let cuts_mps = metrics::speed_cuts_mps(agent_type);
    Ok(Anchors::fit(&windows, config.dt_s as f32, config.horizon_len, cuts_mps, seed))
}

/// The inputs of a validation besides the samples.
#[derive(Clone, Copy)]
pub(crate) struct Validation<'a> {
    pub(crate) config: &'a ModelConfig,
    pub(crate) base: &'a BaseControl,
    pub(crate) baselines: &'a Baselines,
    pub(crate) map: Option<MapKind>,
    /// Maximum number of agents per set.
    pub(crate) agents_max: usize,
    /// Number of threads.
    pub(crate) workers: usize,
}

/// Sums over the agents of a set: the network's modes and its single best forecast, the same of the base
/// control, constant velocity, and anchors.
type Sums = [DisplacementMean; 6];

impl Validation<'_> {
    /// The scores of every set in `samples` that has windows.
    pub(crate) fn scores(&self, weights: &Tensors, samples: &Samples) -> Result<Vec<SetScore>, TrainError> {
        let sets = samples.sets.iter().filter(|set| !set.windows.is_empty());
        sets.map(|set| self.score(weights, set, samples)).collect()
    }

    fn score(&self, weights: &Tensors, set: &SetSamples, samples: &Samples) -> Result<SetScore, TrainError> {
        let stride = set.counted_count().div_ceil(self.agents_max).max(1);
        let windows: Vec<Window> = set.windows.iter().copied().step_by(stride).collect();
        let parts: Vec<&[Window]> = windows.chunks(windows.len().div_ceil(self.workers).max(1)).collect();
        let of_parts = threads::each(&parts, |_, windows| self.sums(weights, set.set, windows, samples))?;
        let mut sums = Sums::default();
        for part in of_parts {
            sums.iter_mut().zip(part).for_each(|(sum, part)| sum.merge(&part));
        }
        let agents = usize::try_from(sums[1].ade_m.len()).unwrap_or(usize::MAX);
        let [best_of_modes, single, base_best_of_modes, base_single, constant_velocity, anchors_best_of_20] =
            sums.map(|mean| Errors {
                ade_m: rounded(mean.ade_m.value().unwrap_or_default()),
                fde_m: rounded(mean.fde_m.value().unwrap_or_default()),
            });
        Ok(SetScore {
            set: set.set.name().to_owned(),
            windows: windows.len(),
            agents,
            best_of_modes,
            single,
            base_best_of_modes,
            base_single,
            constant_velocity,
            anchors_best_of_20,
        })
    }

    fn sums(
        &self,
        weights: &Tensors,
        set: DataSet,
        windows: &[Window],
        samples: &Samples,
    ) -> Result<Sums, TrainError> {
        let mut sums = Sums::default();
        let mut batch: Vec<SceneView<'_>> = Vec::new();
        for (number, window) in windows.iter().enumerate() {
            let map = self.map.and_then(|kind| samples.map(window.recording, kind));
            batch.push(view::plain(&samples.scene(window)?, map, SCENE_AGENTS));
            let agents_len: usize = batch.iter().map(|view| view.agents.len()).sum();
            if agents_len >= BATCH_AGENTS || number + 1 == windows.len() {
                self.add(weights, set, &batch, &mut sums)?;
                batch.clear();
            }
        }
        Ok(sums)
    }

    fn add(
        &self,
        weights: &Tensors,
        set: DataSet,
        scenes: &[SceneView<'_>],
        sums: &mut Sums,
    ) -> Result<(), TrainError> {
        let config = self.config;
        let batch = Batch::new(scenes, BatchOptions::of_run(config, self.base))?;
        let encoded = encode(weights, config, &batch.graph, Normalisation::Running, false);
        for of_type in 0..3 {
            let Some(forecast) = TypeForecast::new(weights, config, &batch, &encoded, of_type) else {
                continue;
            };
            let [modes, single] = self.trajectories(&forecast);
            let [base_modes, base_single] = self.base_trajectories(&forecast);
            for (i, position) in forecast.agents.clone().enumerate() {
                let (scene, agent) = batch.origin[position];
                let view = &scenes[scene].agents[agent];
                let truth: Vec<Option<Point>> = view.truth().collect();
                let [best, of_single, base_best, of_base_single, baselines @ ..] = &mut *sums;
                best.add(min_displacement(modes.of(i), &truth));
                of_single.add(displacement(&single.of(i)[0], &truth));
                base_best.add(min_displacement(base_modes.of(i), &truth));
                of_base_single.add(displacement(&base_single.of(i)[0], &truth));
                self.add_baselines(set, &view.agent, baselines);
            }
        }
        Ok(())
    }

    fn add_baselines(&self, set: DataSet, agent: &Agent, [steady, of_anchors]: &mut [DisplacementMean; 2]) {
        let truth = agent.future_m();
        let dt_s = self.config.dt_s as f32;
        if let Some(forecast) = constant_velocity(&agent.history, dt_s, self.config.horizon_len) {
            steady.add(displacement(&forecast, &truth));
        }
        let anchors = self.baselines.of(set, agent.agent_type);
        if let Some(modes) = anchors.and_then(|anchors| anchors.predict(&agent.history)) {
            of_anchors.add(min_displacement(&modes, &truth));
        }
    }

    /// All modes, and the single best forecast.
    fn trajectories(&self, forecast: &TypeForecast<'_>) -> [Trajectories; 2] {
        let (agents_len, modes_len) = (forecast.agents.len(), self.config.modes);
        if self.config.latents == Latents::Points {
            return both(agents_len, modes_len)
                .map(|modes| Trajectories::new(&forecast.by_points(&modes, false).positions, agents_len));
        }
        // Every validation uses the same draws, so that the figures of two checkpoints are comparable.
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let draws = (0..agents_len * modes_len * LATENT).map(|_| StandardNormal.sample(&mut random));
        let draws = Matrix::new(agents_len * modes_len, LATENT, draws.collect());
        [draws, Matrix::zeros(agents_len, LATENT)]
            .map(|latent| Trajectories::new(&forecast.decode(&latent, None, false).positions, agents_len))
    }

    fn base_trajectories(&self, forecast: &TypeForecast<'_>) -> [Trajectories; 2] {
        let agents_len = forecast.agents.len();
        both(agents_len, self.config.modes)
            .map(|modes| Trajectories::new(&forecast.positions(&forecast.base(&modes)), agents_len))
    }
}

/// All modes of every agent, and the single best forecast of every agent.
fn both(agents_len: usize, modes_len: usize) -> [Vec<usize>; 2] {
    [(0..agents_len).flat_map(|_| 0..modes_len).collect(), vec![modes_len; agents_len]]
}

/// Trajectories, the same number for every agent.
struct Trajectories {
    positions: Vec<Vec<Point>>,
    per_agent: usize,
}

impl Trajectories {
    fn new(positions: &Matrix, agents_len: usize) -> Self {
        let rows = (0..positions.rows).map(|row| positions.row(row).as_chunks::<2>().0.to_vec());
        Self { positions: rows.collect(), per_agent: positions.rows / agents_len }
    }

    fn of(&self, agent: usize) -> &[Vec<Point>] {
        &self.positions[agent * self.per_agent..][..self.per_agent]
    }
}
