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
use scene::{Choice, EdgeRule, FeatureScales, Gait, PatchOptions, Recall};
use wire::{CONTEXT_EMBEDDING, ControlGaussian, HORIZON_MAX, LATENT, STATE_FEATURES, TEMPORAL};

use crate::motion::Mover;
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
    pub(crate) fn steer(&self, agent: &Agent, said: &Said, recall: Option<&Recall>) -> Hypotheses {
        let mover = self.mover(agent);
        let recalled = recall.map(|recall| self.recalling(agent, &mover, said, recall));
        let (modes, probability) = match &recalled {
            Some((modes, probability)) => (&modes[..], probability),
            None => (&said.controls[..self.config.modes], &said.probability),
        };
        Hypotheses {
            heading_rad: f64::from(mover.heading_rad()),
            probability: probability.iter().map(|&p| f64::from(p)).collect(),
            controls: modes.iter().flatten().map(|control| mover.acting(control)).collect(),
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

    /// The forecast that is said of an agent, and what it becomes by what memories of the place tell, if anything: one of the
    /// recording alone, and one that began before.
    pub(crate) fn lead(
        &self,
        agent: &Agent,
        said: &Said,
        [recalled, revisited]: [Option<&Recall>; 2],
    ) -> Forecast {
        let mover = self.mover(agent);
        let (modes, best) = (&said.controls[..self.config.modes], self.best(said));
        let base = said.base.chunks_exact(self.config.horizon_len);
        let mut of_base: Vec<_> = base.map(|controls| mover.follow(controls.iter().copied())).collect();
        let base = of_base.pop().map(|best| Paths { modes: of_base, best });
        let with = |recall: &Recall| {
            let (modes, probability) = self.recalling(agent, &mover, said, recall);
            let (modes, covariance) = modes.iter().map(|steps| mover.spread(steps)).unzip();
            let best = mover.follow(changed(best, &mover.changes(&recall.expected)));
            Recalled { paths: Paths { modes, best }, probability, covariance }
        };
        let (recalled, revisited) = (recalled.map(with), revisited.map(with));
        let (modes, covariance) = modes.iter().map(|steps| mover.spread(steps)).unzip();
        let best = mover.follow(best.iter().map(|control| control.mean));
        Forecast { modes, probability: said.probability.clone(), covariance, best, base, recalled, revisited }
    }

    /// The controls of an agent's modes with what the memory of the place tells of it, and their probabilities.
    ///
    /// Where a remembered path takes the place of a mode, the deviations of its controls stay.
    fn recalling(
        &self,
        agent: &Agent,
        mover: &Mover,
        said: &Said,
        recall: &Recall,
    ) -> (Vec<Vec<ControlGaussian>>, Vec<f32>) {
        let (modes, best) = (&said.controls[..self.config.modes], self.best(said));
        let of_modes = mover.changes(&recall.expected_of_modes());
        let means = modes.iter().map(|controls| changed(controls, &of_modes).collect::<Vec<_>>());
        let likes = recall.likes.iter().map(|like| mover.changes(&like.departures));
        let means: Vec<_> = means.chain(likes.map(|changes| changed(best, &changes).collect())).collect();
        let (chosen, probability): (Vec<usize>, Vec<f32>) = if recall.likes.is_empty() {
            ((0..modes.len()).collect(), said.probability.clone())
        } else {
            let path = |means: &Vec<[f32; 2]>| {
                let path = mover.follow(means.iter().copied());
                std::array::from_fn(|step| path.get(step).copied().unwrap_or_default())
            };
            let paths: Vec<[Point; HORIZON_MAX]> = means.iter().map(path).collect();
            let gait = if self.config.drives(agent.agent_type) { Gait::Driving } else { Gait::Walking };
            let weights = recall.likes.iter().map(|like| like.weight);
            let mut choice = Choice::default();
            choice.choose(gait, &paths, best.len(), &said.probability, weights);
            choice.chosen().unzip()
        };
        let controls = chosen.iter().zip(modes).map(|(&chosen, own)| {
            let steps = means[chosen].iter().zip(own);
            steps.map(|(&mean, own)| ControlGaussian { mean, ..*own }).collect()
        });
        (controls.collect(), probability)
    }

    /// Where the single best forecast that is said of an agent leads.
    pub(crate) fn lead_best(&self, agent: &Agent, said: &Said) -> Vec<Point> {
        self.mover(agent).follow(self.best(said).iter().map(|control| control.mean))
    }

    /// The controls of the single best forecast: its own, or those of the likeliest mode.
    fn best<'a>(&self, said: &'a Said) -> &'a [ControlGaussian] {
        let likeliest = metrics::most_likely(&said.probability).unwrap_or(0);
        said.controls.get(self.config.modes).unwrap_or(&said.controls[likeliest])
    }

    fn mover(&self, agent: &Agent) -> Mover {
        let now = agent.newest().expect("a wanted agent is present");
        let frame = scene::agent_frame(&agent.history).expect("a present agent has a frame");
        Mover::new(agent, &now, &frame, &self.config)
    }
}

/// Controls with what is added to them at each step.
fn changed<'a>(
    controls: &'a [ControlGaussian],
    changes: &'a [[f32; 2]],
) -> impl Iterator<Item = [f32; 2]> + 'a {
    controls.iter().zip(changes).map(|(control, change)| [0, 1].map(|i| control.mean[i] + change[i]))
}
