//! A worker's share of a frame: burn-in, draws and conversion to controls.

use std::ops::Range;
use std::sync::Arc;

use nn::{
    AgentDraws, Decoder, DecoderGroup, Encoded, Job, ModelConfig, Precision, StartError, Weights, Workers,
};
use wire::{
    AGENT_TYPES, AGENTS_MAX, AgentControls, AgentEncoding, AgentType, LATENT, STATE_FEATURES, TEMPORAL,
};

use crate::draws::Stream;

/// Settings of a [`Decoder`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderOptions {
    /// Number of threads that run the network, including the stage's own thread. Results do not depend on it.
    pub workers: usize,
    /// Seed of the draws from N(0, I).
    pub seed: u64,
    /// Precision of the recurrent layer.
    pub precision: Precision,
}

/// The agents of a frame that are to be forecast, block by block.
#[derive(Default)]
pub(crate) struct Frame {
    seq: u64,
    agents: Vec<AgentEncoding>,
    /// Ranges of agents that are decoded together. All agents of a block have one type.
    blocks: Vec<Range<usize>>,
}

/// A worker: its scratch memory and the controls of the blocks that it decoded.
pub(crate) struct Unroller {
    networks: Arc<Decoder>,
    config: ModelConfig,
    seed: u64,
    group: DecoderGroup,
    /// The place of an agent in the frame and the agent's controls.
    controls: Vec<(usize, AgentControls)>,
}

impl Frame {
    fn with_room() -> Self {
        Self {
            agents: Vec::with_capacity(AGENTS_MAX),
            blocks: Vec::with_capacity(AGENTS_MAX),
            ..Self::default()
        }
    }

    /// Copies the agents of a frame and returns the number of blocks. Each agent comes with its block number,
    /// in ascending order of blocks. Blocks are decoded in this order or, with `largest_first`, by descending
    /// size.
    pub(crate) fn take<'a>(
        &mut self,
        seq: u64,
        agents: impl Iterator<Item = (usize, &'a AgentEncoding)>,
        largest_first: bool,
    ) -> usize {
        let Self { agents: all, blocks, .. } = self;
        self.seq = seq;
        all.clear();
        blocks.clear();
        for (block, agent) in agents {
            if block == blocks.len() {
                blocks.push(all.len()..all.len());
            }
            all.push(*agent);
            blocks[block].end = all.len();
        }
        if largest_first {
            // Small blocks at the end shorten the time that workers wait for each other.
            blocks.sort_unstable_by_key(|block| (std::cmp::Reverse(block.len()), block.start));
        }
        blocks.len()
    }
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
        agent.is_present(step).then_some(agent.state[step])
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
    /// One unroller for each worker.
    pub(crate) fn pool(weights: &Weights, options: DecoderOptions) -> Result<Workers<Self>, StartError> {
        let networks = Arc::new(Decoder::with_precision(weights, options.precision)?);
        let unroller = |_| Self {
            networks: Arc::clone(&networks),
            config: weights.config().clone(),
            seed: options.seed,
            group: DecoderGroup::default(),
            controls: Vec::with_capacity(AGENTS_MAX),
        };
        // Any worker may get any block, so each allocates its scratch memory now.
        let warm = |mut unroller: Self| {
            unroller.warm_up();
            unroller
        };
        Ok(Workers::new(Frame::with_room(), (0..options.workers.max(1)).map(unroller).map(warm))?)
    }

    fn warm_up(&mut self) {
        let agents = vec![AgentEncoding::default(); DecoderGroup::LEN];
        for agent_type in AGENT_TYPES {
            let share = Share { agents: &agents, seed: 0, seq: 0 };
            self.group.decode(self.networks.of(agent_type), &self.config, &share);
        }
    }

    /// Discards the controls of the last frame.
    pub(crate) fn clear(&mut self) {
        self.controls.clear();
    }

    /// The controls of the blocks that this worker decoded, with the places of their agents.
    pub(crate) fn controls(&self) -> &[(usize, AgentControls)] {
        &self.controls
    }
}

impl Job for Unroller {
    type Input = Frame;

    fn run(&mut self, frame: &Frame, block: usize) {
        let places = frame.blocks[block].clone();
        let agents = &frame.agents[places.clone()];
        let agent_type = AgentType::try_from(agents[0].agent_type).expect("the encoding's type was checked");
        let share = Share { agents, seed: self.seed, seq: frame.seq };
        self.group.decode(self.networks.of(agent_type), &self.config, &share);
        for (i, (agent, place)) in agents.iter().zip(places).enumerate() {
            self.controls.push((place, controls(agent, self.group.draws(i), self.config.modes)));
        }
    }
}

/// Converts the network's output for an agent to an element of the payload.
fn controls(agent: &AgentEncoding, decoded: AgentDraws<'_>, modes_len: usize) -> AgentControls {
    let mut controls = AgentControls {
        modes_len: modes_len as u32,
        out_of_distribution: decoded.outside,
        ..AgentControls::of(agent)
    };
    controls.probability[..modes_len].copy_from_slice(decoded.probability);
    let all = controls.modes[..modes_len].iter_mut().chain([&mut controls.best]);
    for (draw, out) in all.enumerate().take(decoded.draw_count()) {
        out.iter_mut().zip(decoded.controls(draw)).for_each(|(out, control)| *out = control);
    }
    if decoded.draw_count() == modes_len {
        controls.best = controls.modes[most_probable(decoded.probability)];
    }
    let base = decoded.best_base();
    controls.base[..base.len()].copy_from_slice(base);
    controls
}

/// The most probable mode; the first one if several are equal.
fn most_probable(probabilities: &[f32]) -> usize {
    let mut best = 0;
    for (mode, probability) in probabilities.iter().enumerate() {
        if *probability > probabilities[best] {
            best = mode;
        }
    }
    best
}
