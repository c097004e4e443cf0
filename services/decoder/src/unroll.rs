//! One worker's share of a frame: burn-in, draws and the conversion into controls.

use std::sync::Arc;

use nn::base::{Base, BaseFeatures};
use nn::{
    BurnIn, Decoder, DecoderMemory, Draws, Job, ModelConfig, RAW_CONTROL, TypeDecoder, Weights, Workers,
    control_gaussian,
};
use wire::{
    AgentControls, AgentEncoding, AgentType, ControlGaussian, HORIZON_MAX, LATENT, MODES_MAX, STATE_FEATURES,
    TEMPORAL,
};

use crate::draws::Stream;
use crate::{DecoderOptions, StartError};

/// Agents of one type that pass the network together.
const GROUP: usize = 16;
/// Length of the network's hidden state.
const HIDDEN: usize = 128;

/// A worker's agents, sorted by type, and what becomes of them.
pub(crate) struct Unroller {
    networks: Arc<Decoder>,
    config: ModelConfig,
    seed: u64,
    seq: u64,
    agents: Vec<AgentEncoding>,
    controls: Vec<AgentControls>,
    scratch: Scratch,
}

#[derive(Default)]
struct Scratch {
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
    probabilities: Vec<f32>,
    memory: DecoderMemory,
}

impl Unroller {
    /// As many as there are workers.
    pub(crate) fn pool(weights: &Weights, options: DecoderOptions) -> Result<Workers<Self>, StartError> {
        let networks = Arc::new(Decoder::new(weights)?);
        let unroller = |_| Self {
            networks: Arc::clone(&networks),
            config: weights.config().clone(),
            seed: options.seed,
            seq: 0,
            agents: Vec::new(),
            controls: Vec::new(),
            scratch: Scratch::default(),
        };
        Ok(Workers::new((0..options.workers.max(1)).map(unroller))?)
    }

    /// Takes over a share of a frame's agents.
    pub(crate) fn take<'a>(&mut self, seq: u64, agents: impl Iterator<Item = &'a AgentEncoding>) {
        self.seq = seq;
        self.agents.clear();
        self.agents.extend(agents);
    }

    /// The controls of the share.
    pub(crate) fn controls(&self) -> &[AgentControls] {
        &self.controls
    }
}

impl Job for Unroller {
    fn run(&mut self) {
        self.controls.clear();
        for of_type in self.agents.chunk_by(|a, b| a.agent_type == b.agent_type) {
            let agent_type =
                AgentType::try_from(of_type[0].agent_type).expect("the encoding's type was checked");
            for group in of_type.chunks(GROUP) {
                let network = self.networks.of(agent_type);
                let streams = group.iter().map(|agent| Stream::new(self.seed, agent.id, self.seq));
                let draws_len = self.scratch.run(network, &self.config, group, streams);
                for (i, agent) in group.iter().enumerate() {
                    let forecast = self.scratch.forecast(i, draws_len, &self.config);
                    self.controls.push(forecast.controls(agent, agent_type));
                }
            }
        }
    }
}

impl Scratch {
    /// Runs the network on a group of agents; returns the draws of each, the best forecast's among them.
    fn run(
        &mut self,
        network: &TypeDecoder,
        config: &ModelConfig,
        group: &[AgentEncoding],
        streams: impl Iterator<Item = Stream>,
    ) -> usize {
        self.states.clear();
        self.present.clear();
        for step in 0..config.history_len {
            self.states.extend(group.iter().map(|agent| agent.state[step]));
            self.present.extend(group.iter().map(|agent| agent.present >> step & 1 == 1));
        }
        self.temporal.clear();
        self.temporal.extend(group.iter().map(|agent| agent.temporal));
        self.hidden.resize(group.len(), [0.0; HIDDEN]);
        let agents = BurnIn { agents_len: group.len(), states: &self.states, present: &self.present };
        network.burn_in(&agents, &mut self.memory, &mut self.hidden);
        self.base.clear();
        if let Some(base) = network.base() {
            group.iter().for_each(|agent| self.extend_base(base, agent, config));
        }
        let (draws_len, draws) = if network.points_len() > 0 {
            (network.points_len(), Draws::Points(&self.base))
        } else {
            self.latents.clear();
            for stream in streams {
                self.latents.extend((0..config.modes).map(|draw| stream.latent(draw)));
                // Without a point of its own the best forecast takes the middle of the distribution.
                self.latents.push(network.best_latent().copied().unwrap_or([0.0; LATENT]));
            }
            (config.modes + 1, Draws::Given(&self.latents))
        };
        self.raw.resize(group.len() * draws_len * config.horizon_len, [0.0; RAW_CONTROL]);
        network.forecast(&self.hidden, &self.temporal, draws, &mut self.memory, &mut self.raw);
        self.probabilities.resize(group.len() * config.modes, 0.0);
        let probabilities = &mut self.probabilities;
        if !network.mode_probabilities(&self.hidden, &self.temporal, &mut self.memory, probabilities) {
            probabilities.fill(1.0 / config.modes as f32);
        }
        draws_len
    }

    fn extend_base(&mut self, base: &Base, agent: &AgentEncoding, config: &ModelConfig) {
        let states = &agent.state[..config.history_len];
        let features = BaseFeatures::new(states, |step| agent.present >> step & 1 == 1, config);
        let first = self.base.len();
        self.base.resize(first + base.controls_len(), [0.0; 2]);
        base.controls(&features, &mut self.base[first..]);
    }

    /// What the network said of agent `i` of the group.
    fn forecast<'a>(&'a self, i: usize, draws_len: usize, config: &'a ModelConfig) -> Forecast<'a> {
        let len = draws_len * config.horizon_len;
        let base_len = self.base.len() / self.hidden.len();
        Forecast {
            raw: &self.raw[i * len..][..len],
            base: &self.base[i * base_len..][..base_len],
            probabilities: &self.probabilities[i * config.modes..][..config.modes],
            config,
        }
    }
}

/// The network's outputs for one agent.
struct Forecast<'a> {
    /// \[draw, step\].
    raw: &'a [[f32; RAW_CONTROL]],
    /// \[mode, step\], those of the best forecast behind the modes; or empty.
    base: &'a [[f32; 2]],
    probabilities: &'a [f32],
    config: &'a ModelConfig,
}

impl Forecast<'_> {
    fn controls(&self, agent: &AgentEncoding, agent_type: AgentType) -> AgentControls {
        let ModelConfig { modes, horizon_len, .. } = *self.config;
        let mut controls = AgentControls {
            id: agent.id,
            agent_type: agent_type as u32,
            modes_len: modes as u32,
            probability: [0.0; MODES_MAX],
            modes: [[ControlGaussian::default(); HORIZON_MAX]; MODES_MAX],
            best: [ControlGaussian::default(); HORIZON_MAX],
        };
        controls.probability[..modes].copy_from_slice(self.probabilities);
        let draws = self.raw.chunks_exact(horizon_len);
        let all = controls.modes[..modes].iter_mut().chain([&mut controls.best]);
        for (draw, (out, raw)) in all.zip(draws).enumerate() {
            out.iter_mut().zip(raw).for_each(|(out, raw)| *out = control_gaussian(*raw));
            if !self.base.is_empty() {
                shift(out, &self.base[draw * horizon_len..][..horizon_len]);
            }
        }
        if self.raw.len() == modes * horizon_len {
            controls.best = controls.modes[self.likeliest()];
        }
        controls
    }

    /// The mode of the greatest probability, the first of equals.
    fn likeliest(&self) -> usize {
        let mut likeliest = 0;
        for (mode, probability) in self.probabilities.iter().enumerate() {
            if *probability > self.probabilities[likeliest] {
                likeliest = mode;
            }
        }
        likeliest
    }
}

/// Adds `offsets` to the means, step by step.
fn shift(controls: &mut [ControlGaussian], offsets: &[[f32; 2]]) {
    for (control, offset) in controls.iter_mut().zip(offsets) {
        control.mean[0] += offset[0];
        control.mean[1] += offset[1];
    }
}
