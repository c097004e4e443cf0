//! Temporal attention: an agent's steps summed into one encoding, and the way back.
//!
//! ```text
//! β_k = softmax over the present steps k of f_act(w v_k)      ṽ = Σ_k β_k f_act(V v_k)      [paper, Eq. temporal]
//! ```
//!
//! Every head has a w of its own and its rows of V. Where there are as many heads as attributes, V is w: the formula of
//! the paper read to the letter.

use nn::kernels::exp_in_place;

use super::matrix::{Into, Matrix, by_input, by_matrix, forward};
use super::tensors::{Gradients, Tensors};

#[cfg(test)]
mod tests;

/// Node attributes.
const NODE: usize = 64;
/// The row of a step at which the agent is absent.
const ABSENT: u32 = u32::MAX;
const SCORE: &str = "gdat.temporal.score.weight";
const VALUE: &str = "gdat.temporal.value.weight";

/// Every agent's steps in one.
#[derive(Debug)]
pub(crate) struct Summary {
    /// ṽ `[agents, 64]`; zeros for an agent that is never present.
    pub(crate) encoding: Matrix,
    /// β `[agents × steps, heads]`; zeros where the agent is absent.
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

/// Sums `node` `[rows, 64]` over the steps of every agent; `steps` `[agents × steps_len]` has their rows, `u32::MAX` where
/// the agent is absent.
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
    let beta = trace.weigh(steps);
    let encoding = trace.sum(steps, &beta);
    Summary { encoding, beta, trace }
}

/// x, or `slope` times x where it is not positive.
fn leaky(slope: f32, x: f32) -> f32 {
    x * leaky_factor(slope, x)
}

/// The derivative of [`leaky`] at x.
const fn leaky_factor(slope: f32, x: f32) -> f32 {
    if x > 0.0 { 1.0 } else { slope }
}

/// (place among `steps`, row) where the agent is present.
fn present(steps: &[u32]) -> impl Iterator<Item = (usize, usize)> {
    steps.iter().enumerate().filter(|(_, row)| **row != ABSENT).map(|(step, row)| (step, *row as usize))
}

impl Trace {
    fn value(&self) -> &Matrix {
        self.value.as_ref().unwrap_or(&self.score)
    }

    /// β of every agent and step, `[agents × steps, heads]`.
    fn weigh(&self, steps: &[u32]) -> Matrix {
        let heads = self.score.cols;
        let mut beta = Matrix::zeros(steps.len(), heads);
        for (at, row) in present(steps) {
            let scores = beta.row_mut(at).iter_mut().zip(self.score.row(row));
            scores.for_each(|(beta, score)| *beta = leaky(self.leaky_slope, *score));
        }
        let agents = || steps.chunks_exact(self.steps_len);
        let mut by_head = vec![0.0; heads];
        for (steps, beta) in agents().zip(beta.values.chunks_exact_mut(self.steps_len * heads)) {
            by_head.fill(f32::NEG_INFINITY);
            for (step, _) in present(steps) {
                let scores = by_head.iter_mut().zip(&beta[step * heads..]);
                scores.for_each(|(most, score)| *most = most.max(*score));
            }
            for (step, _) in present(steps) {
                let scores = beta[step * heads..].iter_mut().zip(&by_head);
                scores.for_each(|(score, most)| *score -= most);
            }
        }
        exp_in_place(&mut beta.values);
        for (steps, beta) in agents().zip(beta.values.chunks_exact_mut(self.steps_len * heads)) {
            by_head.fill(0.0);
            for (step, _) in present(steps) {
                by_head.iter_mut().zip(&beta[step * heads..]).for_each(|(sum, beta)| *sum += beta);
            }
            for (row, beta) in steps.iter().zip(beta.chunks_exact_mut(heads)) {
                if *row == ABSENT {
                    beta.fill(0.0);
                } else {
                    beta.iter_mut().zip(&by_head).for_each(|(beta, sum)| *beta /= sum);
                }
            }
        }
        beta
    }

    /// ṽ of every agent.
    fn sum(&self, steps: &[u32], beta: &Matrix) -> Matrix {
        let mut encoding = Matrix::zeros(steps.len() / self.steps_len, NODE);
        let section = NODE / beta.cols;
        for (at, row) in present(steps) {
            let sections = encoding.row_mut(at / self.steps_len).chunks_exact_mut(section);
            let values = self.value().row(row).chunks_exact(section);
            for (beta, (sum, value)) in beta.row(at).iter().zip(sections.zip(values)) {
                let terms = sum.iter_mut().zip(value);
                terms.for_each(|(sum, value)| *sum += beta * leaky(self.leaky_slope, *value));
            }
        }
        encoding
    }
}

impl Summary {
    /// Gradient by `node`, which [`temporal`] was given with `steps`, from that by the encoding.
    ///
    /// ```text
    /// ∂β_k = ∂ṽ · f(V v_k)      ∂f(w v_k) = β_k (∂β_k − ∂ṽ · ṽ)      since Σ_k β_k ∂β_k = ∂ṽ · Σ_k β_k f(V v_k)
    /// ```
    pub(crate) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        node: &Matrix,
        steps: &[u32],
        d_encoding: &Matrix,
    ) -> Matrix {
        let Trace { leaky_slope, steps_len, score, .. } = &self.trace;
        let value = self.trace.value();
        let heads = score.cols;
        let section = NODE / heads;
        let mut by_score = Matrix::zeros(node.rows, heads);
        let mut by_value = Matrix::zeros(node.rows, NODE);
        for (at, row) in present(steps) {
            let (d_encoding, encoding) = (d_encoding.row(at / steps_len), self.encoding.row(at / steps_len));
            let (value, by_value) = (value.row(row), by_value.row_mut(row));
            for head in 0..heads {
                let beta = self.beta.row(at)[head];
                let mut by_exponent = 0.0;
                for i in head * section..(head + 1) * section {
                    let factor = leaky_factor(*leaky_slope, value[i]);
                    by_exponent += d_encoding[i] * (value[i] * factor - encoding[i]);
                    by_value[i] = beta * d_encoding[i] * factor;
                }
                let factor = leaky_factor(*leaky_slope, score.row(row)[head]);
                by_score.row_mut(row)[head] = beta * by_exponent * factor;
            }
        }
        let mut by_node = Matrix::zeros(node.rows, NODE);
        let mut take_back = |name: &str, gradient: &Matrix| {
            by_matrix(gradient.view(), node.view(), gradients.matrix_mut(name));
            by_input(gradient.view(), weights.matrix(name), by_node.view_mut(), Into::Add);
        };
        take_back(SCORE, &by_score);
        take_back(if self.trace.value.is_some() { VALUE } else { SCORE }, &by_value);
        by_node
    }
}
