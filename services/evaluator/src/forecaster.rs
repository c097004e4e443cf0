//! The forecaster: the model's layers on whole scenes, without the pipeline around them.
//!
//! The layers and equations are those that run on board; what differs is only where scenes come from. Neighbours are
//! all agents within the model's edge radius, however many there are.

mod encode;

use kinematics::Normals;
use metrics::Point;
use nn::base::BaseFeatures;
use nn::{
    BurnIn, ContextCnn, ContextMemory, Decoder, DecoderMemory, Draws, Gdat, GdatMemory, MlpMemory,
    ModelConfig, RAW_CONTROL, RelationMlp, StateMlp, TypeDecoder, Weights, WeightsError, control_gaussian,
};
use scene::{EdgeRule, FeatureScales, PatchOptions};
use wire::{CONTEXT_EMBEDDING, ControlGaussian, LATENT, STATE_FEATURES, TEMPORAL};

use crate::motion::Mover;
use crate::{Agent, Scene};
use encode::Encoding;

/// Length of the network's hidden state.
const HIDDEN: usize = 128;
/// Agents of one type that pass the decoder together.
const GROUP: usize = 16;

/// What is forecast for one agent.
#[derive(Clone, Debug, PartialEq)]
pub struct Forecast {
    /// The K modes.
    pub modes: Vec<Vec<Point>>,
    /// The probability of each mode.
    pub probability: Vec<f32>,
    /// Covariances (xx, xy, yy) of each mode's positions, m².
    pub covariance: Vec<Vec<[f32; 3]>>,
    /// The single best forecast (K = 1).
    pub best: Vec<Point>,
    /// The base control alone, where the model has one: baseline B*.
    pub base: Option<BaseForecast>,
}

/// What the base control forecasts with the network switched off.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseForecast {
    /// Ridge regression and anchor of each mode.
    pub modes: Vec<Vec<Point>>,
    /// Ridge regression alone.
    pub best: Vec<Point>,
}

/// The networks of a weights file.
pub struct Forecaster {
    config: ModelConfig,
    rule: EdgeRule,
    scales: FeatureScales,
    state_mlp: StateMlp,
    relation_mlp: RelationMlp,
    /// None where nodes carry no context.
    context: Option<ContextCnn>,
    gdat: Gdat,
    decoder: Decoder,
    seed: u64,
}

/// Scratch memory of a [`Forecaster`]; each thread has its own.
#[derive(Default)]
pub struct ForecasterMemory {
    mlp: MlpMemory,
    gdat: GdatMemory,
    decoder: DecoderMemory,
    encoding: Encoding,
    group: Group,
}

/// Agents of one type on their way through the decoder.
#[derive(Default)]
struct Group {
    /// \[step, agent\].
    states: Vec<[f32; STATE_FEATURES]>,
    present: Vec<bool>,
    hidden: Vec<[f32; HIDDEN]>,
    temporal: Vec<[f32; TEMPORAL]>,
    /// Base controls, \[agent, mode, step\], those of the best forecast behind the modes; empty where the model has none.
    base: Vec<[f32; 2]>,
    /// \[agent, draw\].
    latents: Vec<[f32; LATENT]>,
    /// \[agent, draw, step\].
    raw: Vec<[f32; RAW_CONTROL]>,
    /// \[agent, mode\].
    probability: Vec<f32>,
}

impl Forecaster {
    /// Reads the networks; `seed` is that of latent variables where the model draws them from N(0, I).
    ///
    /// # Errors
    /// [`WeightsError`] where the weights do not hold the model.
    pub fn new(weights: &Weights, seed: u64) -> Result<Self, WeightsError> {
        let config = weights.config().clone();
        Ok(Self {
            rule: EdgeRule {
                radius_m: config.edge_radius_m,
                pedestrian_radius_m: config.pedestrian_edge_radius_m.unwrap_or(config.edge_radius_m),
                neighbours_max: usize::MAX,
            },
            scales: FeatureScales { position: config.position_scale, velocity: config.velocity_scale },
            state_mlp: StateMlp::new(weights)?,
            relation_mlp: RelationMlp::new(weights)?,
            context: config.context.then(|| ContextCnn::new(weights)).transpose()?,
            gdat: Gdat::new(weights)?,
            decoder: Decoder::new(weights)?,
            seed,
            config,
        })
    }

    /// The model's options.
    #[must_use]
    pub const fn config(&self) -> &ModelConfig {
        &self.config
    }

    /// The patches that the model reads, where it reads any.
    #[must_use]
    pub fn patch_options(&self) -> Option<PatchOptions> {
        let options = PatchOptions { side: self.config.patch_size, cell_m: self.config.patch_cell_m };
        self.config.context.then_some(options)
    }

    /// Context embeddings CE of patches that lie one after the other; none where the model reads no map.
    #[must_use]
    pub fn embed_patches(&self, patches: &[f32]) -> Vec<[f32; CONTEXT_EMBEDDING]> {
        let (Some(cnn), Some(options)) = (&self.context, self.patch_options()) else { return Vec::new() };
        let mut embeddings = vec![[0.0; CONTEXT_EMBEDDING]; patches.len() / options.len()];
        cnn.embed(patches, &mut ContextMemory::default(), &mut embeddings);
        embeddings
    }

    /// Forecasts the agents of a scene whose places are `wanted`, in that order; all agents are seen.
    ///
    /// `context` gives the context embedding of an agent (its place) at a history step.
    ///
    /// # Panics
    /// Where a wanted agent does not exist or is absent at the newest step.
    pub fn forecast(
        &self,
        scene: &Scene,
        context: impl Fn(usize, usize) -> [f32; CONTEXT_EMBEDDING],
        wanted: &[usize],
        memory: &mut ForecasterMemory,
    ) -> Vec<Forecast> {
        self.encode(scene, context, memory);
        let mut forecasts = vec![None; wanted.len()];
        for of_type in wire::AGENT_TYPES {
            let is_of_type = |place: &usize| scene.agents[wanted[*place]].agent_type == of_type;
            let places: Vec<usize> = (0..wanted.len()).filter(is_of_type).collect();
            for places in places.chunks(GROUP) {
                let agents: Vec<usize> = places.iter().map(|&place| wanted[place]).collect();
                let network = self.decoder.of(of_type);
                let draws_len = self.decode(network, scene, &agents, memory);
                let base_len = memory.group.base.len() / agents.len();
                for (number, (&place, &agent)) in places.iter().zip(&agents).enumerate() {
                    let raw = &memory.group.raw[number * draws_len * self.config.horizon_len..];
                    let said = Said {
                        controls: raw
                            .chunks_exact(self.config.horizon_len)
                            .take(draws_len)
                            .map(gaussians)
                            .collect(),
                        probability: memory.group.probability[number * self.config.modes..]
                            [..self.config.modes]
                            .to_vec(),
                        base: &memory.group.base[number * base_len..][..base_len],
                    };
                    forecasts[place] = Some(self.move_agent(&scene.agents[agent], said));
                }
            }
        }
        forecasts.into_iter().flatten().collect()
    }

    /// Runs the decoder on a group of agents of one type; returns the draws of each, the best forecast's among them.
    fn decode(
        &self,
        network: &TypeDecoder,
        scene: &Scene,
        agents: &[usize],
        memory: &mut ForecasterMemory,
    ) -> usize {
        let config = &self.config;
        let ForecasterMemory { decoder: scratch, encoding, group, .. } = memory;
        group.gather(encoding, agents, config.history_len);
        let burn_in = BurnIn { agents_len: agents.len(), states: &group.states, present: &group.present };
        group.hidden.resize(agents.len(), [0.0; HIDDEN]);
        network.burn_in(&burn_in, scratch, &mut group.hidden);
        group.base.clear();
        if let Some(base) = network.base() {
            for &agent in agents {
                let states = encoding.states_of(agent);
                let rows: Vec<_> = states.iter().map(|state| state.unwrap_or_default()).collect();
                let features = BaseFeatures::new(&rows, |step| states[step].is_some(), config);
                let first = group.base.len();
                group.base.resize(first + base.controls_len(), [0.0; 2]);
                base.controls(&features, &mut group.base[first..]);
            }
        }
        let (draws_len, draws) = if network.points_len() > 0 {
            (network.points_len(), Draws::Points(&group.base))
        } else {
            group.latents.clear();
            for &agent in agents {
                let mut normals = Normals::new(self.seed, scene.agents[agent].id, scene.stamp_ns as u64);
                let draws = (0..config.modes).map(|_| std::array::from_fn(|_| normals.draw()));
                group.latents.extend(draws);
                // Without a point of its own the best forecast takes the middle of the distribution.
                group.latents.push(network.best_latent().copied().unwrap_or([0.0; LATENT]));
            }
            (config.modes + 1, Draws::Given(&group.latents))
        };
        group.raw.resize(agents.len() * draws_len * config.horizon_len, [0.0; RAW_CONTROL]);
        network.forecast(&group.hidden, &group.temporal, draws, scratch, &mut group.raw);
        group.probability.resize(agents.len() * config.modes, 0.0);
        if !network.mode_probabilities(&group.hidden, &group.temporal, scratch, &mut group.probability) {
            group.probability.fill(1.0 / config.modes as f32);
        }
        draws_len
    }

    /// Adds the base control and moves the agent.
    fn move_agent(&self, agent: &Agent, said: Said<'_>) -> Forecast {
        let ModelConfig { modes: modes_len, horizon_len, .. } = self.config;
        let now = agent.newest().expect("a wanted agent is present");
        let frame = scene::agent_frame(&agent.history).expect("a present agent has a frame");
        let mover = Mover::new(agent, &now, &frame, &self.config);
        let Said { mut controls, probability, base } = said;
        let base = base.chunks_exact(horizon_len);
        controls.iter_mut().zip(base.clone()).for_each(|(steps, base)| shift(steps, base));
        let mut of_base: Vec<_> = base.map(|controls| mover.follow(controls.iter().copied())).collect();
        let base_forecast = of_base.pop().map(|best| BaseForecast { modes: of_base, best });
        let best = controls.get(modes_len).map(Vec::as_slice);
        let likeliest = metrics::most_likely(&probability).unwrap_or(0);
        let best = best.unwrap_or(&controls[likeliest]).iter().map(|control| control.mean);
        let best = mover.follow(best);
        let (modes, covariance) = controls[..modes_len].iter().map(|steps| mover.spread(steps)).unzip();
        Forecast { modes, probability, covariance, best, base: base_forecast }
    }
}

/// What the network said of an agent.
struct Said<'a> {
    /// Control Gaussians of each draw and step.
    controls: Vec<Vec<ControlGaussian>>,
    probability: Vec<f32>,
    /// Base controls, \[mode, step\], those of the best forecast behind the modes; or empty.
    base: &'a [[f32; 2]],
}

impl Group {
    fn gather(&mut self, encoding: &Encoding, agents: &[usize], history_len: usize) {
        self.states.clear();
        self.present.clear();
        for step in 0..history_len {
            self.states.extend(agents.iter().map(|&agent| encoding.state(step, agent).unwrap_or_default()));
            self.present.extend(agents.iter().map(|&agent| encoding.state(step, agent).is_some()));
        }
        self.temporal.clear();
        self.temporal.extend(agents.iter().map(|&agent| encoding.temporal[agent]));
    }
}

fn gaussians(raw: &[[f32; RAW_CONTROL]]) -> Vec<ControlGaussian> {
    raw.iter().copied().map(control_gaussian).collect()
}

/// Adds `offsets` to the means, step by step.
fn shift(controls: &mut [ControlGaussian], offsets: &[[f32; 2]]) {
    for (control, offset) in controls.iter_mut().zip(offsets) {
        control.mean[0] += offset[0];
        control.mean[1] += offset[1];
    }
}
