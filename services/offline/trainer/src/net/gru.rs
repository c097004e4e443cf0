//! The GRU decoder: from the history of an agent and a latent variable to the Gaussians of its controls.
//! \[model §3\]
//!
//! **In:** state features `[agents, steps × 6]` with their presence, ṽ `[agents, 64]` and z `[agents × draws,
//! 32]`. **Out:** μ₁, μ₂, ln l₁₁, ln l₂₂, l₂₁ of every step `[agents × draws, horizon × 5]`, in m/s² and
//! rad/s for the bicycle model, in m for the displacement model.
//!
//! A gated recurrent unit reads the present steps of the history ([`burn_in`]), then ṽ and z once, then zeros
//! ([`unroll`]). A linear *head* reads every state of the forecast.
//!
//! Agents are processed in blocks that stay in the second-level cache over all steps, forward and backward.
//! The part of ṽ and the first recurrent product do not depend on the draw, so they are computed once per
//! agent.
//!
//! A step has two halves: the product of the state with W_h, on packed panels, and the element-wise [`step`]
//! kernels. The head's five rows are stacked below W_h, so one product reads a state for both.

mod burn_in;
mod step;
mod sum;
#[cfg(test)]
mod tests;
mod unroll;

use std::ops::Range;

use nn::kernels::product::{Gather, Panels, Product};

pub(crate) use burn_in::{BurnIn, burn_in};
pub(crate) use unroll::{Unroll, unroll};

use super::dense::{PerceptronTrace, perceptron};
use super::matrix::Matrix;
use super::tensors::{Gradients, Tensors};
use step::{GATES, HIDDEN, SUMS};

/// Components of a state feature vector.
const FEATURES: usize = 6;
/// Length of ṽ.
const ENCODING: usize = 64;
/// Length of a latent variable.
const LATENT: usize = 32;
/// The columns of W_i that read the state features, ṽ and z.
const FEATURE_COLUMNS: Range<usize> = 0..FEATURES;
const ENCODING_COLUMNS: Range<usize> = FEATURES..FEATURES + ENCODING;
const LATENT_COLUMNS: Range<usize> = FEATURES + ENCODING..FEATURES + ENCODING + LATENT;
/// Length of a row of the head.
const CONTROL: usize = 5;
/// Rows of a block.
const BLOCK: usize = 96;
/// Layers of the mode head.
const MODE_LAYERS: usize = 2;

/// Logits of the modes `[agents, modes]`, of [ṽ ‖ h]: `encoding` `[agents, 64]`, `hidden` `[agents, 128]`.
///
/// No gradient is passed to ṽ and h.
pub(crate) fn mode_logits(
    weights: &Tensors,
    name: &str,
    encoding: &Matrix,
    hidden: &Matrix,
) -> (Matrix, PerceptronTrace) {
    assert_eq!(encoding.rows, hidden.rows, "an encoding and a state per agent");
    let rows = encoding.values.chunks_exact(ENCODING).zip(hidden.values.chunks_exact(HIDDEN));
    let joined: Vec<f32> = rows.flat_map(|(encoding, hidden)| [encoding, hidden].concat()).collect();
    let input = Matrix::new(encoding.rows, ENCODING + HIDDEN, joined);
    perceptron(weights, &format!("{name}.mode"), MODE_LAYERS, input)
}

/// Packs some columns of W_i, for a product with a part of the input.
fn by_input(weights: &Tensors, name: &str, columns: Range<usize>, bias: Option<&[f32]>) -> Panels {
    let matrix = weights.tensor(&format!("{name}.gru.weight_ih"));
    let weight = |out: usize, i: usize| matrix.values[out * matrix.shape[1] + columns.start + i];
    Panels::pack(
        [GATES, 1, columns.len()],
        |out, _, i| weight(out, i),
        |out| bias.map_or(0.0, |bias| bias[out]),
    )
}

/// A matrix `[out, 128]` and its bias, packed for products with states.
fn by_state(matrix: &[f32], bias: &[f32]) -> Panels {
    Panels::pack([bias.len(), 1, HIDDEN], |out, _, i| matrix[out * HIDDEN + i], |out| bias[out])
}

/// The same matrix, packed for the gradient by the states.
fn to_state(matrix: &[f32]) -> Panels {
    Panels::pack([HIDDEN, 1, matrix.len() / HIDDEN], |i, _, out| matrix[out * HIDDEN + i], |_| 0.0)
}

/// out = input · panels + bias + residual; rows of `input` are `stride` apart.
fn product(panels: &Panels, input: &[f32], stride: usize, residual: Option<&[f32]>, out: &mut [f32]) {
    Product { input, gather: Gather::Rows { stride }, panels, residual, relu: false, out }.run();
}

/// Adds the column sums of the gates' gradients to the gradients of both biases.
fn add_biases(gradients: &mut Gradients, name: &str, sums: &[f32; SUMS]) {
    let (shared, of_new) = sums.split_at(2 * HIDDEN);
    let (by_input, by_state) = of_new.split_at(HIDDEN);
    for (bias, of_new) in [("bias_ih", by_input), ("bias_hh", by_state)] {
        let gradient = gradients.get_mut(&format!("{name}.gru.{bias}"));
        let sums = shared.iter().chain(of_new);
        gradient.iter_mut().zip(sums).for_each(|(gradient, sum)| *gradient += sum);
    }
}
