//! Control Gaussians of each agent, mode and step, from the agents' temporal summaries.
//!
//! A model has one of two kinds of modes:
//!
//! * latent points of the model, in their order, with the probabilities of the mode head;
//! * draws from N(0, I), all equally probable. They depend only on seed, track and tick.
//!
//! In addition, the decoder outputs the controls of the single best forecast.

mod base;
mod draws;
mod options;
mod step;
mod unroll;

pub use base::BaseDecoder;
pub use nn::StartError;
use nn::{Deadline, DecoderGroup, ModelConfig, Weights, WeightsError, Workers};
pub use options::{Options, STAGE};
use ports::Allowance;
pub use step::{run, settings};
use wire::{AGENT_TYPES, AGENTS_MAX, AgentControls, AgentEncoding, Header, Rejected};

pub use unroll::DecoderOptions;
use unroll::Unroller;

/// The decoder: its workers and the order in which they decode the agents.
pub struct Decoder {
    config: ModelConfig,
    workers: Workers<Unroller>,
    /// The agents to be served. Agents that are decoded together are adjacent.
    order: Vec<Turn>,
    /// Whether an agent was decoded, by its place in the frame.
    is_served: [bool; AGENTS_MAX],
}

/// An agent to be served.
#[derive(Clone, Copy)]
struct Turn {
    /// Index of the block in which the agent is decoded.
    block: usize,
    /// The agent's turn.
    turn: u32,
    /// The agent's place in the frame.
    agent: usize,
}

impl Decoder {
    /// A decoder with the model's networks.
    ///
    /// # Errors
    /// [`StartError`] if the weights do not hold the model, the process can't compute in the precision or a
    /// thread can't be started.
    pub fn new(weights: &Weights, options: DecoderOptions) -> Result<Self, StartError> {
        let config = weights.config().clone();
        config.check_frames().map_err(WeightsError::from)?;
        Ok(Self {
            config,
            workers: Unroller::pool(weights, options)?,
            order: Vec::with_capacity(AGENTS_MAX),
            is_served: [false; AGENTS_MAX],
        })
    }

    /// The numbers of horizon steps and modes of the model.
    pub(crate) const fn sizes(&self) -> (u32, u32) {
        (self.config.horizon_len as u32, self.config.modes as u32)
    }

    /// The number of agents in a frame that are to be forecast.
    #[must_use]
    pub fn len(encodings: &[AgentEncoding]) -> usize {
        encodings.iter().filter(|agent| is_wanted(agent)).count()
    }

    /// Decodes the forecastable agents of a frame that the allowance permits, and returns their number.
    /// [`Decoder::write`] writes their controls.
    ///
    /// A block is a few agents of one type that are decoded together. With a deadline, agents are decoded in
    /// the order of their turns, and at least the first block is decoded. An agent's controls are
    /// bit-identical for every block and for every set of other agents.
    ///
    /// # Errors
    /// [`Rejected`] if the frame does not fit the model or holds impossible numbers.
    pub fn serve(
        &mut self,
        header: &Header,
        encodings: &[AgentEncoding],
        allowance: Allowance<'_>,
    ) -> Result<usize, Rejected> {
        self.check(header, encodings)?;
        self.is_served.fill(false);
        let deadline = match allowance {
            Allowance::Until { until_ns, clock } => Some(Deadline { until_ns, clock }),
            _ => None,
        };
        self.assign(encodings, allowance);
        let in_order = self.order.iter().map(|turn| (turn.block, &encodings[turn.agent]));
        let block_count = self.workers.input().take(header.seq, in_order, deadline.is_none());
        self.workers.each(Unroller::clear);
        self.workers.run_until(block_count, deadline);
        let (mut verdict, mut served_count) = (Ok(()), 0);
        self.workers.each(|job| {
            if verdict.is_ok() {
                verdict = job.controls().iter().try_for_each(|(_, controls)| controls.check());
            }
            served_count += job.controls().len();
            job.controls().iter().for_each(|(place, _)| self.is_served[self.order[*place].agent] = true);
        });
        if verdict.is_err() {
            self.is_served.fill(false);
        }
        verdict.map(|()| served_count)
    }

    /// Whether the agent at this place of the last frame was served.
    #[must_use]
    pub fn is_served(&self, agent: usize) -> bool {
        self.is_served[agent]
    }

    /// Writes the controls of the agents that [`Decoder::serve`] served, in the order of the frame.
    ///
    /// # Panics
    /// If `out` is shorter than the number of served agents.
    pub fn write(&mut self, out: &mut [AgentControls]) {
        let mut places = [0; AGENTS_MAX];
        let served = self.is_served.iter().enumerate().filter(|(_, served)| **served);
        for (place, (agent, _)) in served.enumerate() {
            places[agent] = place;
        }
        self.workers.each(|job| {
            for (place, controls) in job.controls() {
                out[places[self.order[*place].agent]] = *controls;
            }
        });
    }

    /// Assigns the agents to be served to blocks of one type each. Agents are assigned type by type or, with
    /// a deadline, in the order of their turns. Each agent joins the open block of its type. Blocks are
    /// numbered by their first agents.
    fn assign(&mut self, encodings: &[AgentEncoding], allowance: Allowance<'_>) {
        let by_turn = matches!(allowance, Allowance::Until { .. });
        let is_allowed = |place: usize| match allowance {
            Allowance::AsRecorded(header) => !header.is_shed(place),
            _ => true,
        };
        self.order.clear();
        let wanted =
            encodings.iter().enumerate().filter(|(place, agent)| is_wanted(agent) && is_allowed(*place));
        self.order.extend(wanted.map(|(agent, encoding)| Turn { block: 0, turn: encoding.turn, agent }));
        let type_of = |turn: &Turn| encodings[turn.agent].agent_type as usize;
        if by_turn {
            self.order.sort_unstable_by_key(|turn| (turn.turn, turn.agent));
        } else {
            self.order.sort_unstable_by_key(|turn| (type_of(turn), turn.agent));
        }
        // The open block of each type and its number of agents.
        let (mut open, mut block_count) = ([(0, DecoderGroup::LEN); AGENT_TYPES.len()], 0);
        for turn in &mut self.order {
            let (block, len) = &mut open[type_of(turn)];
            if *len == DecoderGroup::LEN {
                (*block, *len) = (block_count, 0);
                block_count += 1;
            }
            *len += 1;
            turn.block = *block;
        }
        self.order.sort_unstable_by_key(|turn| (turn.block, turn.turn, turn.agent));
    }

    fn check(&self, header: &Header, encodings: &[AgentEncoding]) -> Result<(), Rejected> {
        header.check_agents(encodings.len())?;
        encodings.iter().try_for_each(|agent| agent.check(self.config.history_len))
    }
}

/// Whether an agent is to be forecast.
const fn is_wanted(agent: &AgentEncoding) -> bool {
    agent.forecastable != 0 && agent.shed == 0
}
