//! Temporal attention: an agent's steps summed into one encoding, and the way back.
//!
//! ```text
//! β_k = softmax over the present steps k of f_act(w v_k)      ṽ = Σ_k β_k f_act(V v_k)      [paper, Eq. temporal]
//! ```
//!
//! The sum is that of messages from an agent's rows to the agent, as in [`super::topological`]. Every head has a w of its
//! own and its rows of V. Where there are as many heads as attributes, V is w: the paper's formula read to the letter.

use super::matrix::{Into, Matrix, by_input, by_matrix, forward};
use super::tensors::{Gradients, Tensors};
use super::topological::messages::{Messages, MessagesBackward, leaky_factor};
use super::topological::scores::softmax;
use super::topological::{BLOCK, Block, Edges, NODE};

#[cfg(test)]
mod tests;

/// The row of a step at which the agent is absent.
const ABSENT: u32 = u32::MAX;
const SCORE: &str = "gdat.temporal.score.weight";
const VALUE: &str = "gdat.temporal.value.weight";

/// Every agent's steps in one.
#[derive(Debug)]
pub(crate) struct Summary {
    /// ṽ `[agents, 64]`; zeros for an agent that is never present.
    pub(crate) encoding: Matrix,
    /// β `[present steps, heads]`, agent by agent.
    pub(crate) beta: Matrix,
    trace: Trace,
}

/// What the way back needs besides.
#[derive(Debug)]
struct Trace {
    leaky_slope: f32,
    steps_len: usize,
    /// w v `[rows, heads]`.
    score: Matrix,
    /// V v `[rows, 64]`; `None` where it is the score.
    value: Option<Matrix>,
}

/// Sums `node` `[rows, 64]` over the steps of every agent; `steps` `[agents × steps_len]` has their rows, `u32::MAX`
/// where the agent is absent.
pub(crate) fn temporal(
    weights: &Tensors,
    leaky_slope: f32,
    node: &Matrix,
    steps: &[u32],
    steps_len: usize,
) -> Summary {
    let product = |name: &str| {
        let matrix = weights.matrix(name);
        let mut product = Matrix::zeros(node.rows, matrix.rows);
        forward(node.view(), matrix, product.view_mut(), Into::Replace);
        product
    };
    let score = product(SCORE);
    let value = (score.cols != NODE).then(|| product(VALUE));
    let trace = Trace { leaky_slope, steps_len, score, value };
    let present = present(steps, steps_len);
    let mut beta = trace.score.gather(&present.sender);
    beta.values.iter_mut().for_each(|x| *x *= leaky_factor(leaky_slope, *x));
    softmax(&mut beta, &present.first);
    let mut encoding = Matrix::zeros(steps.len() / steps_len, NODE);
    let own = [0.0; BLOCK * NODE];
    for block in present.blocks() {
        trace.messages(block, &beta).sum(&own, &mut encoding);
    }
    Summary { encoding, beta, trace }
}

/// The present steps as edges from their rows to their agents.
fn present(steps: &[u32], steps_len: usize) -> Edges {
    let mut edges = Edges { first: vec![0], ..Edges::default() };
    for (agent, steps) in steps.chunks_exact(steps_len).enumerate() {
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
        let leaky_slope = self.leaky_slope;
        Messages { block, heads: beta.cols, leaky_slope, values: self.value(), alpha: block.of(beta) }
    }
}

impl Summary {
    /// Gradient by `node`, which [`temporal`] was given with `steps`, from that by the encoding.
    pub(crate) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        node: &Matrix,
        steps: &[u32],
        d_encoding: &Matrix,
    ) -> Matrix {
        let Trace { leaky_slope, steps_len, score, value } = &self.trace;
        let present = present(steps, *steps_len);
        let mut back = MessagesBackward::new(present.len(), node.rows, score.cols);
        let mut own = [0.0; BLOCK * NODE];
        for block in present.blocks() {
            own.fill(0.0);
            back.run(self.trace.messages(block, &self.beta), (&self.encoding, d_encoding), &mut own);
        }
        let mut by_score = Matrix::zeros(node.rows, score.cols);
        by_score.scatter_add(&present.sender, &back.by_scores);
        let scores = by_score.values.iter_mut().zip(&score.values);
        scores.for_each(|(gradient, score)| *gradient *= leaky_factor(*leaky_slope, *score));

        let mut by_node = Matrix::zeros(node.rows, NODE);
        let value_name = if value.is_some() { VALUE } else { SCORE };
        for (name, gradient) in [(SCORE, &by_score), (value_name, &back.by_values)] {
            by_matrix(gradient.view(), node.view(), gradients.matrix_mut(name));
            by_input(gradient.view(), weights.matrix(name), by_node.view_mut(), Into::Add);
        }
        by_node
    }
}
