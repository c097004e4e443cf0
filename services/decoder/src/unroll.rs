//! One worker's share of a frame: burn-in, draws and the conversion into controls.

use std::sync::Arc;

use nn::{AgentDraws, Decoder, DecoderGroup, Encoded, Job, ModelConfig, Weights, Workers};
use wire::{AgentControls, AgentEncoding, AgentType, LATENT, STATE_FEATURES, TEMPORAL};

use crate::draws::Stream;
use crate::{DecoderOptions, StartError};

/// A worker's agents, sorted by type, and their controls.
pub(crate) struct Unroller {
    networks: Arc<Decoder>,
    config: ModelConfig,
    seed: u64,
    seq: u64,
    agents: Vec<AgentEncoding>,
    controls: Vec<AgentControls>,
    group: DecoderGroup,
}

/// Some agents of a frame, all of one type.
struct Share<'a> {
    agents: &'a [AgentEncoding],
    seed: u64,
    seq: u64,
}

impl Encoded for Share<'_> {
    fn agents_len(&self) -> usize {
        self.agents.len()
    }

    fn state(&self, agent: usize, step: usize) -> Option<[f32; STATE_FEATURES]> {
        let agent = &self.agents[agent];
        (agent.present >> step & 1 == 1).then_some(agent.state[step])
    }

    fn temporal(&self, agent: usize) -> [f32; TEMPORAL] {
        self.agents[agent].temporal
    }

    fn draw(&self, agent: usize, latents: &mut [[f32; LATENT]]) {
        let stream = Stream::new(self.seed, self.agents[agent].id, self.seq);
        latents.iter_mut().enumerate().for_each(|(draw, latent)| *latent = stream.latent(draw));
    }
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
            group: DecoderGroup::default(),
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
            let network = self.networks.of(agent_type);
            for agents in of_type.chunks(DecoderGroup::LEN) {
                self.group.decode(network, &self.config, &Share { agents, seed: self.seed, seq: self.seq });
                for (i, agent) in agents.iter().enumerate() {
                    self.controls.push(controls(agent, self.group.draws(i), self.config.modes));
                }
            }
        }
    }
}

/// The network's output for an agent as an element of the payload.
fn controls(agent: &AgentEncoding, decoded: AgentDraws<'_>, modes_len: usize) -> AgentControls {
    let mut controls = AgentControls {
        id: agent.id,
        agent_type: agent.agent_type,
        modes_len: modes_len as u32,
        out_of_distribution: decoded.outside,
        ..AgentControls::default()
    };
    controls.probability[..modes_len].copy_from_slice(decoded.probability);
    let all = controls.modes[..modes_len].iter_mut().chain([&mut controls.best]);
    for (draw, out) in all.enumerate().take(decoded.draws_len()) {
        out.iter_mut().zip(decoded.controls(draw)).for_each(|(out, control)| *out = control);
    }
    if decoded.draws_len() == modes_len {
        controls.best = controls.modes[most_probable(decoded.probability)];
    }
    let base = decoded.best_base();
    controls.base[..base.len()].copy_from_slice(base);
    controls
}

/// The most probable mode, the first of equals.
fn most_probable(probabilities: &[f32]) -> usize {
    let mut best = 0;
    for (mode, probability) in probabilities.iter().enumerate() {
        if *probability > probabilities[best] {
            best = mode;
        }
    }
    best
}
