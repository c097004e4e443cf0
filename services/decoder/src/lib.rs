//! Control Gaussians of each agent, mode and step, from the agents' temporal summaries.
//!
//! The modes are the model's latent points in their order, with the probabilities of the mode head; or draws
//! from N(0, I), all equally probable, that depend on seed, track and tick alone. Beside them stands the
//! single best forecast.

mod base;
mod draws;
mod options;
pub mod stage;
mod unroll;

pub use base::BaseDecoder;
pub use nn::StartError;
use nn::{ModelConfig, Weights, WeightsError, Workers};
pub use options::{Options, STAGE};
use wire::{AGENT_TYPES, AGENTS_MAX, AgentControls, AgentEncoding, Header, Rejected};

use unroll::Unroller;

/// Settings of a [`Decoder`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DecoderOptions {
    /// Threads that run the network, the stage's own among them; results do not depend on it.
    pub workers: usize,
    /// Seed of the draws from N(0, I).
    pub seed: u64,
}

/// The decoder: its workers and the order in which they take the agents.
pub struct Decoder {
    config: ModelConfig,
    workers: Workers<Unroller>,
    /// Forecastable agents by type: (place in the frame, place in the output).
    order: Vec<(usize, usize)>,
}

impl Decoder {
    /// A decoder with the model's networks.
    ///
    /// # Errors
    /// [`StartError`] where the weights do not hold the model or a thread can't be had.
    pub fn new(weights: &Weights, options: DecoderOptions) -> Result<Self, StartError> {
        let config = weights.config().clone();
        config.check_frames().map_err(WeightsError::from)?;
        Ok(Self { config, workers: Unroller::pool(weights, options)?, order: Vec::with_capacity(AGENTS_MAX) })
    }

    /// Agents of a frame that are forecast.
    #[must_use]
    pub fn len(encodings: &[AgentEncoding]) -> usize {
        encodings.iter().filter(|agent| agent.forecastable != 0).count()
    }

    /// Decodes the forecastable agents of a frame into `out`, in their order.
    ///
    /// # Errors
    /// [`Rejected`] where the frame does not fit the model or holds impossible numbers; `out` is then
    /// unchanged.
    pub fn step(
        &mut self,
        header: &Header,
        encodings: &[AgentEncoding],
        out: &mut [AgentControls],
    ) -> Result<(), Rejected> {
        self.check(header, encodings, out.len())?;
        self.order.clear();
        for of_type in AGENT_TYPES {
            let forecastable = encodings.iter().enumerate().filter(|(_, agent)| agent.forecastable != 0);
            let numbered =
                forecastable.enumerate().map(|(place, (agent, encoding))| (agent, place, encoding));
            let of_type = numbered.filter(|(.., encoding)| encoding.agent_type == of_type as u32);
            self.order.extend(of_type.map(|(agent, place, _)| (agent, place)));
        }
        let blocks_len =
            self.workers.input().take(header.seq, self.order.iter().map(|&(agent, _)| &encodings[agent]));
        self.workers.each(Unroller::clear);
        self.workers.run(blocks_len);
        let mut verdict = Ok(());
        self.workers.each(|job| {
            if verdict.is_ok() {
                verdict = job.controls().iter().try_for_each(|(_, controls)| controls.check());
            }
        });
        verdict?;
        self.workers.each(|job| {
            for (ordered, controls) in job.controls() {
                out[self.order[*ordered].1] = *controls;
            }
        });
        Ok(())
    }

    fn check(&self, header: &Header, encodings: &[AgentEncoding], out_len: usize) -> Result<(), Rejected> {
        header.check()?;
        if encodings.len() > AGENTS_MAX {
            let (found, most) = (encodings.len() as u64, AGENTS_MAX as u64);
            return Err(Rejected::TooMany { field: "agents_len", found, most });
        }
        let expected = Self::len(encodings);
        if out_len != expected {
            return Err(Rejected::Length { found: out_len, expected });
        }
        let history_len = self.config.history_len;
        for agent in encodings {
            agent.check()?;
            if agent.present >> history_len != 0 {
                return Err(Rejected::Impossible { field: "presence", value: f64::from(agent.present) });
            }
        }
        Ok(())
    }
}
