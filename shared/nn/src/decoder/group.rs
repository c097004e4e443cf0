//! A group of agents of one type that are decoded together: burn-in, base controls, draws, probabilities.

use wire::{ControlGaussian, LATENT, STATE_FEATURES, TEMPORAL};

use super::{BurnIn, DecoderMemory, Draws, HIDDEN, RAW_CONTROL, TypeDecoder, control_gaussian};
use crate::ModelConfig;
use crate::base::{Base, BaseFeatures, kept_share};

/// Agents of one type, encoded.
pub trait Encoded {
    /// Number of agents.
    fn agents_len(&self) -> usize;

    /// State features s of an agent at a history step; `None` if it is absent.
    fn state(&self, agent: usize, step: usize) -> Option<[f32; STATE_FEATURES]>;

    /// Temporal summary ṽ of an agent.
    fn temporal(&self, agent: usize) -> [f32; TEMPORAL];

    /// Fills the modes of an agent with draws from N(0, I). Called only for models without learned points.
    fn draw(&self, agent: usize, latents: &mut [[f32; LATENT]]);
}

/// A group of agents of one type, and the network's output for them.
#[derive(Default)]
pub struct DecoderGroup {
    /// \[step, agent\].
    states: Vec<[f32; STATE_FEATURES]>,
    present: Vec<bool>,
    /// The states of one agent, oldest first.
    history: Vec<[f32; STATE_FEATURES]>,
    hidden: Vec<[f32; HIDDEN]>,
    temporal: Vec<[f32; TEMPORAL]>,
    /// Base controls, \[agent, mode, step\]. The best forecast's controls follow the modes. Empty if the
    /// model has no base.
    base: Vec<[f32; 2]>,
    /// Distance of each agent from the base's support; 0 if the base has none.
    outside: Vec<f32>,
    /// \[agent, draw\].
    latents: Vec<[f32; LATENT]>,
    /// \[agent, draw, step\].
    raw: Vec<[f32; RAW_CONTROL]>,
    /// \[agent, mode\].
    probability: Vec<f32>,
    horizon_len: usize,
    memory: DecoderMemory,
}

/// The network's output for an agent.
#[derive(Clone, Copy, Debug)]
pub struct AgentDraws<'a> {
    /// \[draw, step\].
    raw: &'a [[f32; RAW_CONTROL]],
    horizon_len: usize,
    /// Base controls, \[mode, step\]. The best forecast's controls follow the modes. Empty if the model has
    /// no base.
    pub base: &'a [[f32; 2]],
    /// Distance e of the agent from the base's support.
    pub outside: f32,
    /// The probability of each mode.
    pub probability: &'a [f32],
}

impl DecoderGroup {
    /// Maximum number of agents in a group, chosen for speed: small enough to share a scene over workers, and
    /// large enough that the rows of draws fill whole register tiles.
    pub const LEN: usize = 8;

    /// Decodes agents of a type with its network. Allocates only if a group is larger than all earlier ones.
    ///
    /// The draws of a model with learned points are these points. If the model has a point for the best
    /// forecast, it is the last draw.
    ///
    /// A model without learned points calls [`Encoded::draw`] for its modes. Its last draw belongs to the
    /// best forecast: the model's point for the best forecast or, without one, the middle of the
    /// distribution.
    pub fn decode(&mut self, network: &TypeDecoder, config: &ModelConfig, agents: &impl Encoded) {
        let (agents_len, modes_len) = (agents.agents_len(), config.modes);
        self.gather(config.history_len, agents);
        self.hidden.resize(agents_len, [0.0; HIDDEN]);
        let burn_in = BurnIn { agents_len, states: &self.states, present: &self.present };
        network.burn_in(&burn_in, &mut self.memory, &mut self.hidden);
        self.base.clear();
        self.outside.clear();
        self.outside.resize(agents_len, 0.0);
        if let Some(base) = network.base() {
            (0..agents_len).for_each(|agent| self.extend_base(base, config, agent));
        }
        let (draw_count, draws) = if network.point_count() > 0 {
            (network.point_count(), Draws::Points(&self.base))
        } else {
            let draw_count = modes_len + 1;
            let best = network.best_latent().copied().unwrap_or([0.0; LATENT]);
            self.latents.clear();
            self.latents.resize(agents_len * draw_count, best);
            for (agent, latents) in self.latents.chunks_exact_mut(draw_count).enumerate() {
                agents.draw(agent, &mut latents[..modes_len]);
            }
            (draw_count, Draws::Given(&self.latents))
        };
        self.horizon_len = config.horizon_len;
        self.raw.resize(agents_len * draw_count * config.horizon_len, [0.0; RAW_CONTROL]);
        network.forecast(&self.hidden, &self.temporal, draws, &mut self.memory, &mut self.raw);
        self.probability.resize(agents_len * modes_len, 0.0);
        let Self { hidden, temporal, memory, probability, .. } = self;
        if !network.mode_probabilities(hidden, temporal, memory, probability) {
            probability.fill(1.0 / modes_len as f32);
        }
    }

    fn gather(&mut self, history_len: usize, agents: &impl Encoded) {
        self.states.clear();
        self.present.clear();
        self.temporal.clear();
        for step in 0..history_len {
            for agent in 0..agents.agents_len() {
                let state = agents.state(agent, step);
                self.states.push(state.unwrap_or_default());
                self.present.push(state.is_some());
            }
        }
        self.temporal.extend((0..agents.agents_len()).map(|agent| agents.temporal(agent)));
    }

    fn extend_base(&mut self, base: &Base, config: &ModelConfig, agent: usize) {
        let agents_len = self.hidden.len();
        self.history.clear();
        self.history.extend(self.states.iter().skip(agent).step_by(agents_len));
        let is_present = |step: usize| self.present[step * agents_len + agent];
        let features = BaseFeatures::new(&self.history, is_present, config);
        let first = self.base.len();
        self.base.resize(first + base.control_count(), [0.0; 2]);
        base.controls(&features, &mut self.base[first..]);
        self.outside[agent] = base.outside(&features);
    }

    /// The network's output for an agent of the group.
    ///
    /// # Panics
    /// If the group has no such agent.
    #[must_use]
    pub fn draws(&self, agent: usize) -> AgentDraws<'_> {
        AgentDraws {
            raw: self.share(agent, &self.raw),
            horizon_len: self.horizon_len,
            base: self.share(agent, &self.base),
            outside: self.outside[agent],
            probability: self.share(agent, &self.probability),
        }
    }

    /// An agent's slice of rows; each agent has the same number of rows.
    fn share<'a, T>(&self, agent: usize, of_all: &'a [T]) -> &'a [T] {
        let len = of_all.len() / self.hidden.len();
        &of_all[agent * len..][..len]
    }
}

impl AgentDraws<'_> {
    /// Number of draws: one per mode, plus the best forecast if the model has a latent point for it.
    #[must_use]
    pub const fn draw_count(&self) -> usize {
        self.raw.len() / self.horizon_len
    }

    /// Base controls of the best forecast, step by step; empty if the model has none.
    #[must_use]
    pub fn best_base(&self) -> &[[f32; 2]] {
        &self.base[self.base.len().saturating_sub(self.horizon_len)..]
    }

    /// Control Gaussians of a draw's steps, including the base control. The network's part of the mean fades
    /// outside of the base's support.
    pub fn controls(&self, draw: usize) -> impl Iterator<Item = ControlGaussian> + '_ {
        let steps = draw * self.horizon_len..(draw + 1) * self.horizon_len;
        let share = kept_share(self.outside);
        steps.map(move |step| {
            let mut control = control_gaussian(self.raw[step]);
            control.mean = control.mean.map(|mean| share * mean);
            if let Some([first, second]) = self.base.get(step) {
                control.mean[0] += first;
                control.mean[1] += second;
            }
            control
        })
    }
}
