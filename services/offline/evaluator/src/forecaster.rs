//! The forecaster: the model's layers on whole scenes, without the pipeline around them.
//!
//! The layers and equations are those that run on board; what differs is only where scenes come from. Neighbours are
//! all agents within the model's edge radius, however many there are.

mod encode;

use kinematics::Normals;
use metrics::Point;
use nn::{
    AgentDraws, ContextCnn, ContextMemory, Decoder, DecoderGroup, Encoded, Gdat, GdatMemory, MlpMemory,
    ModelConfig, RelationMlp, StateMlp, Weights, WeightsError,
};
use retrieval::{ControlAdapter, ControlChanges, ForecastControls, Retrieved};
use scene::{EdgeRule, FeatureScales, PatchOptions};
use wire::{CONTEXT_EMBEDDING, ControlGaussian, LATENT, STATE_FEATURES, TEMPORAL};

use crate::motion;
use crate::tracking::Hypotheses;
use crate::{Agent, Scene};
use encode::Encoding;

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
    /// The base control with the network switched off, where the model has one, ridge regression and anchors: baseline B*.
    pub base: Option<Paths>,
    /// The same forecast with what the place's memory tells, where it tells anything.
    pub recalled: Option<Recalled>,
    /// The same with a memory that began with what earlier recordings showed.
    pub revisited: Option<Recalled>,
}

/// A forecast with what the memory of the place tells.
#[derive(Clone, Debug, PartialEq)]
pub struct Recalled {
    /// Where it leads.
    pub paths: Paths,
    /// The probability of each mode.
    pub probability: Vec<f32>,
    /// Covariances of each mode's positions, as those of [`Forecast`].
    pub covariance: Vec<Vec<[f32; 3]>>,
}

/// What the decoder says of an agent.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Said {
    /// Of each mode, then of the best forecast where the model has one of its own, step by step.
    controls: Vec<Vec<ControlGaussian>>,
    /// Base controls, \[mode, step\], those of the best forecast behind the modes; empty where the model has none.
    base: Vec<[f32; 2]>,
    /// The probability of each mode.
    probability: Vec<f32>,
}

/// Where modes and a single best forecast lead.
#[derive(Clone, Debug, PartialEq)]
pub struct Paths {
    /// The K modes.
    pub modes: Vec<Vec<Point>>,
    /// The single best forecast (K = 1).
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
    encoding: Encoding,
    group: DecoderGroup,
}

/// Wanted agents of a scene, all of one type.
struct Wanted<'a> {
    agents: &'a [usize],
    scene: &'a Scene,
    encoding: &'a Encoding,
    seed: u64,
}

impl Encoded for Wanted<'_> {
    fn agents_len(&self) -> usize {
        self.agents.len()
    }

    fn state(&self, agent: usize, step: usize) -> Option<[f32; STATE_FEATURES]> {
        self.encoding.state(step, self.agents[agent])
    }

    fn temporal(&self, agent: usize) -> [f32; TEMPORAL] {
        self.encoding.temporal[self.agents[agent]]
    }

    fn draw(&self, agent: usize, latents: &mut [[f32; LATENT]]) {
        let id = self.scene.agents[self.agents[agent]].id;
        let mut normals = Normals::new(self.seed, id, self.scene.stamp_ns as u64);
        latents.as_flattened_mut().fill_with(|| normals.draw());
    }
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
        let options = PatchOptions {
            side: self.config.patch_size,
            cell_m: self.config.patch_cell_m,
            ahead_m: self.config.patch_ahead_m,
        };
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
        let said = self.say(scene, context, wanted, memory);
        wanted
            .iter()
            .zip(&said)
            .map(|(&agent, said)| self.lead(&scene.agents[agent], said, [None; 2]))
            .collect()
    }

    /// What the decoder says of each wanted agent, which [`Forecaster::lead`] makes a forecast of.
    pub(crate) fn say(
        &self,
        scene: &Scene,
        context: impl Fn(usize, usize) -> [f32; CONTEXT_EMBEDDING],
        wanted: &[usize],
        memory: &mut ForecasterMemory,
    ) -> Vec<Said> {
        let mut said = vec![None; wanted.len()];
        self.decode(scene, context, wanted, memory, |place, _, draws| {
            said[place] = Some(Said {
                controls: (0..draws.draws_len()).map(|draw| draws.controls(draw).collect()).collect(),
                base: draws.base.to_vec(),
                probability: draws.probability.to_vec(),
            });
        });
        said.into_iter().flatten().collect()
    }

    /// As [`Forecaster::lead`], the controls of each mode as they act instead of where they lead.
    pub(crate) fn steer(&self, agent: &Agent, said: &Said, changes: Option<&ControlChanges>) -> Hypotheses {
        let (model, controls) = (motion::model(agent, &self.config), self.controls(said));
        let acting = |control: ControlGaussian| motion::acting(&model, &control);
        let (probability, controls) = match changes {
            Some(changes) => {
                let modes = 0..controls.modes.len();
                let steps = modes.flat_map(|mode| changes.mode(mode, &controls).map(acting));
                (changes.probability(), steps.collect())
            }
            None => (&said.probability[..], controls.modes.iter().flatten().copied().map(acting).collect()),
        };
        Hypotheses {
            heading_rad: f64::from(model.frame_heading_rad()),
            probability: probability.iter().map(|&p| f64::from(p)).collect(),
            controls,
        }
    }

    /// Hands out what the decoder says of each wanted agent, by its place among them.
    fn decode(
        &self,
        scene: &Scene,
        context: impl Fn(usize, usize) -> [f32; CONTEXT_EMBEDDING],
        wanted: &[usize],
        memory: &mut ForecasterMemory,
        mut say: impl FnMut(usize, &Agent, AgentDraws<'_>),
    ) {
        self.encode(scene, context, memory);
        for of_type in wire::AGENT_TYPES {
            let is_of_type = |place: &usize| scene.agents[wanted[*place]].agent_type == of_type;
            let places: Vec<usize> = (0..wanted.len()).filter(is_of_type).collect();
            for places in places.chunks(DecoderGroup::LEN) {
                let agents: Vec<usize> = places.iter().map(|&place| wanted[place]).collect();
                let ForecasterMemory { encoding, group, .. } = memory;
                let encoded = Wanted { agents: &agents, scene, encoding, seed: self.seed };
                group.decode(self.decoder.of(of_type), &self.config, &encoded);
                for (number, (&place, &agent)) in places.iter().zip(&agents).enumerate() {
                    say(place, &scene.agents[agent], group.draws(number));
                }
            }
        }
    }

    /// The forecast that is said of an agent, and what it becomes by what is retrieved for it, if anything: from a memory of the
    /// recording alone, and from one that began before.
    pub(crate) fn lead(
        &self,
        agent: &Agent,
        said: &Said,
        [recalled, revisited]: [Option<&Retrieved>; 2],
    ) -> Forecast {
        let (model, controls) = (motion::model(agent, &self.config), self.controls(said));
        let (modes_len, steps_len) = (controls.modes.len(), self.config.horizon_len);
        let base = said.base.chunks_exact(steps_len);
        let mut of_base: Vec<_> =
            base.map(|steps| motion::positions(&model, steps.iter().copied(), steps_len)).collect();
        let base = of_base.pop().map(|best| Paths { modes: of_base, best });
        let with = |retrieved: &Retrieved| {
            let mut changes = ControlChanges::default();
            ControlAdapter::default().adapt(retrieved, &model, &controls, &mut changes);
            let mode = |mode| motion::spread(&model, changes.mode(mode, &controls), steps_len);
            let (modes, covariance) = (0..modes_len).map(mode).unzip();
            let best = motion::positions(&model, changes.best(&controls), steps_len);
            let probability = changes.probability().to_vec();
            Recalled { paths: Paths { modes, best }, probability, covariance }
        };
        let (recalled, revisited) = (recalled.map(with), revisited.map(with));
        let mode = |steps: &Vec<ControlGaussian>| motion::spread(&model, steps.iter().copied(), steps_len);
        let (modes, covariance) = controls.modes.iter().map(mode).unzip();
        let best = self.lead_best(agent, said);
        Forecast { modes, probability: said.probability.clone(), covariance, best, base, recalled, revisited }
    }

    /// Where the single best forecast that is said of an agent leads.
    pub(crate) fn lead_best(&self, agent: &Agent, said: &Said) -> Vec<Point> {
        let means = self.best(said).iter().map(|control| control.mean);
        motion::positions(&motion::model(agent, &self.config), means, self.config.horizon_len)
    }

    /// The controls that are said of an agent.
    pub(crate) fn controls<'a>(&self, said: &'a Said) -> ForecastControls<'a, Vec<ControlGaussian>> {
        ForecastControls {
            modes: &said.controls[..self.config.modes],
            probability: &said.probability,
            best: self.best(said),
        }
    }

    /// The controls of the single best forecast: its own, or those of the likeliest mode.
    fn best<'a>(&self, said: &'a Said) -> &'a [ControlGaussian] {
        let likeliest = metrics::most_likely(&said.probability).unwrap_or(0);
        said.controls.get(self.config.modes).unwrap_or(&said.controls[likeliest])
    }
}
