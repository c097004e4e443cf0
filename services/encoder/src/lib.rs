//! Graph dual attention over the features of a frame. The result is the temporal summary ṽ_h of each agent.

mod attender;
mod options;
mod step;

use std::sync::Arc;

pub use nn::StartError;
use nn::{AgentSet, Gdat, GdatMemory, ModelConfig, Weights, WeightsError, Workers};
use wire::{
    AGENTS_MAX, AgentEncoding, AgentFeatures, Features, Header, NODE_ATTRIBUTES, Rejected, TEMPORAL, equal,
    finite,
};

use attender::Attender;
pub use options::{Options, STAGE};
pub use step::{run, settings};

/// Settings of an [`Encoder`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EncoderOptions {
    /// Number of threads that run the network, including the stage's own thread. Results do not depend on it.
    pub workers: usize,
}

/// The encoder: its network, workers and scratch memory.
pub struct Encoder {
    config: ModelConfig,
    gdat: Arc<Gdat>,
    workers: Workers<Attender>,
    memory: GdatMemory,
    /// Node attributes after all rounds, \[step, agent\].
    attended: Vec<[f32; NODE_ATTRIBUTES]>,
    summaries: Vec<[f32; TEMPORAL]>,
    /// Scratch: (turn, place) of the agents that can be served.
    turns: Vec<(u32, usize)>,
}

impl Encoder {
    /// An encoder with the model's graph attention.
    ///
    /// # Errors
    /// [`StartError`] if the weights do not hold the model or a thread can't be started.
    pub fn new(weights: &Weights, options: EncoderOptions) -> Result<Self, StartError> {
        let config = weights.config().clone();
        config.check_frames().map_err(WeightsError::from)?;
        let gdat = Arc::new(Gdat::new(weights)?);
        Ok(Self {
            workers: Attender::pool(weights, &gdat, options.workers)?,
            gdat,
            memory: GdatMemory::default(),
            attended: Vec::with_capacity(AGENTS_MAX * config.history_len),
            summaries: Vec::with_capacity(AGENTS_MAX),
            turns: Vec::with_capacity(AGENTS_MAX),
            config,
        })
    }

    /// Encodes at most `served_max` agents of a frame into `out`, in the frame's order. Returns the number of
    /// served agents: the first ones by their turns. The other agents are marked as shed. Summaries of served
    /// agents are bit-identical for every `served_max`.
    ///
    /// # Errors
    /// [`Rejected`] if the frame does not fit the model or holds impossible numbers. `out` is then unchanged.
    pub fn step(
        &mut self,
        header: &Header,
        features: &Features<'_>,
        served_max: usize,
        out: &mut [AgentEncoding],
    ) -> Result<usize, Rejected> {
        self.check(header, features, out.len())?;
        let agents = features.agents;
        let wanted = self.choose(agents, served_max);
        self.attend(features, wanted);
        finite("temporal summary", self.summaries.as_flattened())?;
        for (place, ((out, agent), temporal)) in out.iter_mut().zip(agents).zip(&self.summaries).enumerate() {
            let is_wanted = wanted.is_none_or(|wanted| wanted[place]);
            let temporal = if is_wanted { temporal } else { &[0.0; TEMPORAL] };
            let shed = u32::from(agent.forecastable != 0 && !is_wanted);
            *out = AgentEncoding { shed, temporal: *temporal, ..AgentEncoding::of(agent) };
        }
        Ok(self.turns.len())
    }

    /// The first `served_max` agents in the order of their turns; `None` if every forecastable agent is
    /// served.
    fn choose(&mut self, agents: &[AgentFeatures], served_max: usize) -> Option<AgentSet> {
        let forecastable = agents.iter().enumerate().filter(|(_, agent)| agent.forecastable != 0);
        let forecastable_count = forecastable.clone().count();
        self.turns.clear();
        let served = forecastable.filter(|(_, agent)| agent.shed == 0);
        self.turns.extend(served.map(|(place, agent)| (agent.turn, place)));
        self.turns.sort_unstable();
        self.turns.truncate(served_max);
        if self.turns.len() == forecastable_count {
            return None;
        }
        let mut wanted = [false; AGENTS_MAX];
        self.turns.iter().for_each(|&(_, place)| wanted[place] = true);
        Some(wanted)
    }

    /// Computes the summaries of a frame's agents, or of the wanted agents only.
    fn attend(&mut self, features: &Features<'_>, wanted: Option<AgentSet>) {
        let agents_len = features.agents.len();
        let mut frame = std::mem::take(&mut *self.workers.input());
        frame.take(features, self.config.history_len, wanted);
        self.workers.each(|job| job.begin(&frame));
        let block_count = frame.block_count();
        *self.workers.input() = frame;
        self.workers.run(block_count);
        let attended = &mut self.attended;
        attended.resize(agents_len * self.config.history_len, [0.0; NODE_ATTRIBUTES]);
        self.workers.each(|job| {
            for (step, nodes) in job.attended() {
                attended[step * agents_len..][..agents_len].copy_from_slice(nodes);
            }
        });
        self.summaries.resize(agents_len, [0.0; TEMPORAL]);
        let frame = self.workers.input();
        self.gdat.summarise_attended(frame.present(), attended, &mut self.memory, &mut self.summaries);
    }

    fn check(&self, header: &Header, features: &Features<'_>, out_len: usize) -> Result<(), Rejected> {
        let agents = features.agents.len();
        header.check_agents(agents)?;
        if out_len != agents {
            return Err(Rejected::Length { found: out_len, expected: agents });
        }
        if agents > 0 {
            equal("history_len", header.counts.history_len as usize, self.config.history_len)?;
        }
        features.check(self.config.history_len)
    }
}
