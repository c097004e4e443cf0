//! The GRU decoder: from an encoding and latent variables to the Gaussians of the controls.

use burn::tensor::{Tensor, activation};

use super::layers::dense;
use crate::parameters::Weights;

/// Width of the hidden state.
const HIDDEN: usize = 128;
/// Smallest and largest ln of a diagonal Cholesky entry.
const LN_DIAGONAL: (f64, f64) = (-5.0, 2.0);

/// Gaussians of the controls, before saturation and without the base control.
#[derive(Clone, Debug)]
pub struct Controls {
    /// What the head put out, `[agents × draws, steps, 5]`.
    pub raw: Tensor<3>,
}

impl Controls {
    /// Means, `[agents × draws, steps, 2]`.
    #[must_use]
    pub fn mean(&self) -> Tensor<3> {
        self.raw.clone().narrow(2, 0, 2)
    }

    /// ln l₁₁ and ln l₂₂, clamped, `[agents × draws, steps, 2]`.
    #[must_use]
    pub fn ln_diagonal(&self) -> Tensor<3> {
        self.raw.clone().narrow(2, 2, 2).clamp(LN_DIAGONAL.0, LN_DIAGONAL.1)
    }

    /// l₂₁, `[agents × draws, steps, 1]`.
    #[must_use]
    pub fn off_diagonal(&self) -> Tensor<3> {
        self.raw.clone().narrow(2, 4, 1)
    }
}

/// The weights of the decoder of one agent type.
pub(crate) struct Decoder<'a> {
    weights: &'a Weights,
    name: String,
    input: Tensor<2>,
    hidden: Tensor<2>,
    input_bias: Tensor<1>,
    hidden_bias: Tensor<1>,
}

impl<'a> Decoder<'a> {
    pub(crate) fn new(weights: &'a Weights, agent_type: &str) -> Self {
        let name = format!("decoder.{agent_type}");
        Self {
            input: weights.get::<2>(&format!("{name}.gru.weight_ih")).transpose(),
            hidden: weights.get::<2>(&format!("{name}.gru.weight_hh")).transpose(),
            input_bias: weights.get(&format!("{name}.gru.bias_ih")),
            hidden_bias: weights.get(&format!("{name}.gru.bias_hh")),
            weights,
            name,
        }
    }

    /// Hidden state after the present history steps: `state` `[agents, steps, 6]`, `present` `[agents, steps]` of 0
    /// and 1.
    pub(crate) fn burn_in(&self, state: &Tensor<3>, present: &Tensor<2>) -> Tensor<2> {
        let [agents_len, steps_len, features_len] = state.dims();
        let matrix = self.input.clone().narrow(0, 0, features_len);
        let mut hidden = Tensor::zeros([agents_len, HIDDEN], &self.input.device());
        for step in 0..steps_len {
            let input = state.clone().narrow(1, step, 1).reshape([agents_len, features_len]);
            let gates = input.matmul(matrix.clone()) + self.input_bias.clone().unsqueeze();
            let next = self.cell(gates, hidden.clone());
            let present = present.clone().narrow(1, step, 1);
            hidden = hidden.clone() + (next - hidden) * present;
        }
        hidden
    }

    /// Controls of every draw: `hidden` `[agents, 128]`, `encoding` `[agents, 64]`, `latent` `[agents, draws, 32]`.
    pub(crate) fn forward(
        &self,
        hidden: &Tensor<2>,
        encoding: Tensor<2>,
        latent: Tensor<3>,
        horizon_len: usize,
    ) -> Controls {
        let [agents_len, draws_len, latent_len] = latent.dims();
        let rows_len = agents_len * draws_len;
        let inputs_len = self.input.dims()[0];
        let encoding_len = encoding.dims()[1];
        let latent_start = inputs_len - latent_len;
        let part = |start: usize, len: usize| self.input.clone().narrow(0, start, len);
        let by_encoding = encoding.matmul(part(latent_start - encoding_len, encoding_len));
        let by_latent = latent.reshape([rows_len, latent_len]).matmul(part(latent_start, latent_len));
        let bias = self.input_bias.clone().unsqueeze::<2>();
        let mut gates = repeat(by_encoding, draws_len) + by_latent + bias.clone();
        let mut hidden = repeat(hidden.clone(), draws_len);
        let mut raw = Vec::with_capacity(horizon_len);
        for step in 0..horizon_len {
            if step == 1 {
                gates = bias.clone().expand([rows_len, 3 * HIDDEN]);
            }
            hidden = self.cell(gates.clone(), hidden);
            let head = dense(self.weights, &format!("{}.head", self.name), hidden.clone());
            raw.push(head.unsqueeze_dim::<3>(1));
        }
        Controls { raw: Tensor::cat(raw, 1) }
    }

    /// Logits of the modes `[agents, modes]`, of [ṽ ‖ h].
    pub(crate) fn mode_logits(&self, encoding: Tensor<2>, hidden: Tensor<2>) -> Tensor<2> {
        let input = Tensor::cat(vec![encoding, hidden], 1);
        super::layers::perceptron(self.weights, &format!("{}.mode", self.name), 2, input)
    }

    /// One GRU step; `gates` are those of the input, in the order reset, update, new.
    fn cell(&self, gates: Tensor<2>, hidden: Tensor<2>) -> Tensor<2> {
        let recurrent = hidden.clone().matmul(self.hidden.clone()) + self.hidden_bias.clone().unsqueeze();
        let reset_update = activation::sigmoid(
            gates.clone().narrow(1, 0, 2 * HIDDEN) + recurrent.clone().narrow(1, 0, 2 * HIDDEN),
        );
        let reset = reset_update.clone().narrow(1, 0, HIDDEN);
        let update = reset_update.narrow(1, HIDDEN, HIDDEN);
        let new =
            (gates.narrow(1, 2 * HIDDEN, HIDDEN) + reset * recurrent.narrow(1, 2 * HIDDEN, HIDDEN)).tanh();
        new.clone() + update * (hidden - new)
    }
}

/// Repeats every row `times` times in a row.
pub(crate) fn repeat(values: Tensor<2>, times: usize) -> Tensor<2> {
    let [rows_len, width] = values.dims();
    if times == 1 {
        return values;
    }
    values.unsqueeze_dim::<3>(1).expand([rows_len, times, width]).reshape([rows_len * times, width])
}
