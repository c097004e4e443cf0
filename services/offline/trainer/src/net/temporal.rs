//! Temporal attention: the steps of an agent summed to one encoding, forward and backward. \[model §3\]
//!
//! ```text
//! β_k = softmax over the present steps k of f_act(w v_k)    ṽ = Σ_k β_k f_act(V v_k)   [paper, Eq. temporal]
//! ```
//!
//! The sum is over messages from an agent's rows to the agent, as in [`super::topological`]. Each head has
//! its own w and its own rows of V. In the `literal` reading of the paper's formula, w replaces V, so each
//! attribute is a head. Equal attention sets all scores to 0.

use nn::{Attention, ModelConfig, Temporal};

use super::matrix::{Into, Matrix, by_input, by_matrix, forward};
use super::tensors::{Gradients, Tensors};
use super::topological::messages::{Messages, MessagesBackward, leaky_factor};
use super::topological::scores::softmax;
use super::topological::{BLOCK, Block, Edges, NODE};

#[cfg(test)]
mod tests;

/// The row of a step without the agent.
const ABSENT: u32 = u32::MAX;
const SCORE: &str = "gdat.temporal.score.weight";
const VALUE: &str = "gdat.temporal.value.weight";

/// The reading of the paper's formula.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reading {
    pub(crate) leaky_slope: f32,
    pub(crate) attention: Attention,
    pub(crate) temporal: Temporal,
}

impl Reading {
    pub(crate) const fn of(config: &ModelConfig) -> Self {
        let ModelConfig { leaky_slope, attention, temporal, .. } = *config;
        Self { leaky_slope, attention, temporal }
    }

    /// The tensor of V.
    const fn value(self) -> &'static str {
        match self.temporal {
            Temporal::ValueMatrix => VALUE,
            Temporal::Literal => SCORE,
        }
    }
}

/// The encodings of a batch.
#[derive(Debug)]
pub(crate) struct Summary {
    /// ṽ `[agents, 64]`; zeros for an agent that is never present.
    pub(crate) encoding: Matrix,
    /// β `[present steps, heads]`, agent by agent.
    pub(crate) beta: Matrix,
    trace: Trace,
}

/// The values that the backward pass also needs.
#[derive(Debug)]
struct Trace {
    reading: Reading,
    step_count: usize,
    /// w v `[rows, heads]`; with equal attention, zeros of one head.
    score: Matrix,
    /// V v `[rows, 64]`; `None` if it is the score.
    value: Option<Matrix>,
}

/// Sums `node` `[rows, 64]` over the steps of every agent. `steps` `[agents × step_count]` are the agents'
/// rows, `u32::MAX` if the agent is absent.
pub(crate) fn temporal(
    weights: &Tensors,
    reading: Reading,
    node: &Matrix,
    steps: &[u32],
    step_count: usize,
) -> Summary {
    let product = |name: &str| {
        let matrix = weights.matrix(name);
        let mut product = Matrix::zeros(node.rows, matrix.rows);
        forward(node.view(), matrix, product.view_mut(), Into::Replace);
        product
    };
    let (score, value) = match (reading.attention, reading.temporal) {
        (Attention::Dual, Temporal::Literal) => (product(SCORE), None),
        (Attention::Dual, Temporal::ValueMatrix) => (product(SCORE), Some(product(VALUE))),
        (Attention::Equal, _) => (Matrix::zeros(node.rows, 1), Some(product(reading.value()))),
    };
    let trace = Trace { reading, step_count, score, value };
    let present = present(steps, step_count);
    let mut beta = trace.score.gather(&present.sender);
    beta.values.iter_mut().for_each(|x| *x *= leaky_factor(reading.leaky_slope, *x));
    softmax(&mut beta, &present.first);
    let mut encoding = Matrix::zeros(steps.len() / step_count, NODE);
    let own = [0.0; BLOCK * NODE];
    for block in present.blocks() {
        trace.messages(block, &beta).sum(&own, &mut encoding);
    }
    Summary { encoding, beta, trace }
}

/// The present steps as edges from their rows to their agents.
fn present(steps: &[u32], step_count: usize) -> Edges {
    let mut edges = Edges { first: vec![0], ..Edges::default() };
    for (agent, steps) in steps.chunks_exact(step_count).enumerate() {
        for row in steps.iter().filter(|row| **row != ABSENT) {
            edges.receiver.push(agent as u32);
            edges.sender.push(*row);
        }
        edges.first.push(edges.len() as u32);
    }
    edges
}

impl Trace {
    fn value(&self) -> &Matrix {
        self.value.as_ref().unwrap_or(&self.score)
    }

    fn messages<'a>(&'a self, block: Block<'a>, beta: &'a Matrix) -> Messages<'a> {
        let leaky_slope = self.reading.leaky_slope;
        Messages { block, heads: beta.cols, leaky_slope, values: self.value(), alpha: block.of(beta) }
    }
}

impl Summary {
    /// Gradient by the inputs `node` of [`temporal`], given the gradient by the encoding.
    pub(crate) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        node: &Matrix,
        steps: &[u32],
        d_encoding: &Matrix,
    ) -> Matrix {
        let Trace { reading, step_count, score, .. } = &self.trace;
        let present = present(steps, *step_count);
        let mut back = MessagesBackward::new(present.len(), node.rows, score.cols);
        let mut own = [0.0; BLOCK * NODE];
        for block in present.blocks() {
            own.fill(0.0);
            back.run(self.trace.messages(block, &self.beta), (&self.encoding, d_encoding), &mut own);
        }
        let mut by_node = Matrix::zeros(node.rows, NODE);
        let mut add = |name: &str, gradient: &Matrix| {
            by_matrix(gradient.view(), node.view(), gradients.matrix_mut(name));
            by_input(gradient.view(), weights.matrix(name), by_node.view_mut(), Into::Add);
        };
        if reading.attention == Attention::Dual {
            let mut by_score = Matrix::zeros(node.rows, score.cols);
            by_score.scatter_add(&present.sender, &back.by_scores);
            let scores = by_score.values.iter_mut().zip(&score.values);
            scores.for_each(|(gradient, score)| *gradient *= leaky_factor(reading.leaky_slope, *score));
            add(SCORE, &by_score);
        }
        add(reading.value(), &back.by_values);
        by_node
    }
}
