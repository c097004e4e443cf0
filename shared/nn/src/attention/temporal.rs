use wire::{NODE_ATTRIBUTES, TEMPORAL};

use super::graph::leaky;
use crate::buffer::Buffer;
use crate::kernels::exp_in_place;
use crate::linear::{Activation, Linear};
use crate::weights::{Weights, WeightsError};
use crate::{Attention, Temporal};

/// Temporal attention: the weights of an agent's history steps.
///
/// ```text
/// β^k = softmax over present k of f_act(w_h · v̄^k)      ṽ^(h) = Σ_k β^k f_act(V^(h) v̄^k)      [model §3]
/// ```
///
/// In the literal reading V^(h) = w_hᵀ: 64 heads with one number each. In equal attention all scores are 0.
pub(super) struct TemporalAttention {
    /// `None` if attention is equal.
    scores: Option<Linear>,
    /// `None` if the scores are the values.
    values: Option<Linear>,
    heads: usize,
    slope: f32,
}

#[derive(Default)]
pub(super) struct TemporalMemory {
    /// \[node, heads padded\].
    scores: Buffer,
    /// Activated values, \[node, 64\].
    values: Buffer,
    /// \[node, head\]; zeros for absent agents.
    beta: Buffer,
    beta_len: usize,
}

impl TemporalMemory {
    /// Attention of the last call, \[step, agent, head\].
    pub(super) fn beta(&self) -> &[f32] {
        &self.beta[..self.beta_len]
    }
}

impl TemporalAttention {
    pub(super) fn read(weights: &Weights) -> Result<Self, WeightsError> {
        let config = weights.config();
        let read = |part: &str, row_count| {
            Linear::read_unbiased(weights, &format!("gdat.temporal.{part}"), row_count, NODE_ATTRIBUTES)
        };
        let heads = match config.temporal {
            Temporal::ValueMatrix => config.temporal_heads,
            Temporal::Literal => TEMPORAL,
        };
        let (scores, values) = match (config.attention, config.temporal) {
            (Attention::Dual, Temporal::ValueMatrix) => {
                (Some(read("score", heads)?), Some(read("value", TEMPORAL)?))
            }
            (Attention::Dual, Temporal::Literal) => (Some(read("score", heads)?), None),
            (Attention::Equal, Temporal::ValueMatrix) => (None, Some(read("value", TEMPORAL)?)),
            (Attention::Equal, Temporal::Literal) => (None, Some(read("score", TEMPORAL)?)),
        };
        Ok(Self { scores, values, heads, slope: config.leaky_slope })
    }

    pub(super) const fn heads(&self) -> usize {
        self.heads
    }

    /// Length of a row of scores.
    fn score_stride(&self) -> usize {
        self.scores.as_ref().map_or(self.heads, Linear::out_stride)
    }

    /// Computes ṽ of all agents from v̄, \[step, agent\].
    pub(super) fn attend(
        &self,
        agents_len: usize,
        present: &[bool],
        nodes: &[f32],
        memory: &mut TemporalMemory,
        out: &mut [[f32; TEMPORAL]],
    ) {
        let (node_count, stride) = (present.len(), self.score_stride());
        let TemporalMemory { scores, values, beta, beta_len } = memory;
        scores.reserve(node_count * stride);
        values.reserve(node_count * TEMPORAL);
        *beta_len = node_count * self.heads;
        beta.reserve(*beta_len);
        let scores = &mut scores[..node_count * stride];
        let values = &mut values[..node_count * TEMPORAL];
        match &self.scores {
            Some(layer) => layer.run(nodes, NODE_ATTRIBUTES, Activation::None, scores),
            None => scores.fill(0.0),
        }
        scores.iter_mut().for_each(|x| *x = leaky(self.slope, *x));
        match &self.values {
            Some(layer) => {
                layer.run(nodes, NODE_ATTRIBUTES, Activation::None, values);
                values.iter_mut().for_each(|x| *x = leaky(self.slope, *x));
            }
            None => values.copy_from_slice(scores),
        }
        let beta = &mut beta[..*beta_len];
        self.weigh(agents_len, present, scores, beta);
        out.as_flattened_mut().fill(0.0);
        let section = TEMPORAL / self.heads;
        let rows = values.chunks_exact(TEMPORAL).zip(beta.chunks_exact(self.heads));
        for (row, (values, beta)) in rows.enumerate() {
            let out = &mut out[row % agents_len];
            for (i, (sum, value)) in out.iter_mut().zip(values).enumerate() {
                *sum += beta[i / section] * value;
            }
        }
    }

    /// Softmax over each agent's present steps into `beta`, \[node, head\].
    fn weigh(&self, agents_len: usize, present: &[bool], scores: &[f32], beta: &mut [f32]) {
        let stride = self.score_stride();
        beta.fill(0.0);
        for agent in 0..agents_len {
            let rows = || (agent..present.len()).step_by(agents_len).filter(|&row| present[row]);
            for head in 0..self.heads {
                let most = rows().fold(f32::NEG_INFINITY, |most, row| most.max(scores[row * stride + head]));
                for row in rows() {
                    beta[row * self.heads + head] = scores[row * stride + head] - most;
                }
            }
        }
        exp_in_place(beta);
        for agent in 0..agents_len {
            let rows = || (agent..present.len()).step_by(agents_len);
            for row in rows().filter(|&row| !present[row]) {
                beta[row * self.heads..][..self.heads].fill(0.0);
            }
            for head in 0..self.heads {
                let sum: f32 = rows().map(|row| beta[row * self.heads + head]).sum();
                let share = if sum > 0.0 { 1.0 / sum } else { 0.0 };
                rows().for_each(|row| beta[row * self.heads + head] *= share);
            }
        }
    }
}
