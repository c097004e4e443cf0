//! The recurrent unit over the history.

use nn::kernels::dispatch;

use super::super::matrix::Matrix;
use super::super::tensors::{Gradients, Tensors};
use super::step::{GATES, HIDDEN, KEPT, KEPT_STATE, SUMS, Step, StepBackward};
use super::sum::{MatrixSum, columns};
use super::{BLOCK, FEATURE_COLUMNS, FEATURES, add_biases, by_input, by_state, product, to_state};

/// The recurrent unit after the history.
#[derive(Debug)]
pub(crate) struct BurnIn {
    /// h of every agent, `[agents, 128]`.
    pub(crate) hidden: Matrix,
    name: String,
    state: Matrix,
    /// `[block, step, agent of the block, KEPT]`.
    kept: Vec<f32>,
}

/// Hidden states after the present history steps, from 0: `state` `[agents, steps × 6]`, `present` `[agents,
/// steps]` of 0 and 1.
pub(crate) fn burn_in(weights: &Tensors, name: &str, state: &Matrix, present: &Matrix) -> BurnIn {
    let (agents_len, step_count) = (present.rows, present.cols);
    assert_eq!((state.rows, state.cols), (agents_len, step_count * FEATURES), "a state per agent and step");
    let tensor = |part: &str| weights.get(&format!("{name}.gru.{part}"));
    let recurrent_bias = tensor("bias_hh");
    let input = by_input(weights, name, FEATURE_COLUMNS, Some(tensor("bias_ih")));
    let recurrent = by_state(tensor("weight_hh"), recurrent_bias);
    let mut hidden = Matrix::zeros(agents_len, HIDDEN);
    let mut kept = Vec::with_capacity(agents_len * step_count * KEPT);
    let [mut input_gates, mut state_gates] = [(); 2].map(|()| vec![0.0; BLOCK * GATES]);
    for (block, hidden) in hidden.values.chunks_mut(BLOCK * HIDDEN).enumerate() {
        let (first, len) = (block * BLOCK, hidden.len() / HIDDEN);
        let input_gates = &mut input_gates[..len * GATES];
        let state_gates = &mut state_gates[..len * GATES];
        for step in 0..step_count {
            let features = &state.values[first * state.cols + step * FEATURES..];
            product(&input, features, state.cols, None, input_gates);
            if step == 0 {
                state_gates.chunks_exact_mut(GATES).for_each(|row| row.copy_from_slice(recurrent_bias));
            } else {
                product(&recurrent, hidden, HIDDEN, None, state_gates);
            }
            let present: Vec<f32> = (first..first + len).map(|agent| present.row(agent)[step]).collect();
            dispatch(Step {
                input: input_gates,
                recurrent: state_gates,
                state: hidden,
                present: Some(&present),
                kept: Some(&mut kept),
            });
        }
    }
    BurnIn { hidden, name: name.to_owned(), state: state.clone(), kept }
}

impl BurnIn {
    /// Adds to the gradients of the recurrent unit, given the gradient by `hidden`.
    pub(crate) fn backward(&self, weights: &Tensors, gradients: &mut Gradients, mut d_hidden: Matrix) {
        let step_count = self.state.cols / FEATURES;
        let recurrent = to_state(weights.get(&format!("{}.gru.weight_hh", self.name)));
        let mut by_hidden = MatrixSum::zeros(GATES, HIDDEN);
        let mut by_features = MatrixSum::zeros(GATES, FEATURES);
        let mut sums = [0.0; SUMS];
        let mut d_earlier = vec![0.0; BLOCK * HIDDEN];
        let [mut d_recurrent, mut d_input] = [(); 2].map(|()| vec![0.0; BLOCK * GATES]);
        for (block, d_state) in d_hidden.values.chunks_mut(BLOCK * HIDDEN).enumerate() {
            let (first, len) = (block * BLOCK, d_state.len() / HIDDEN);
            let d_earlier = &mut d_earlier[..len * HIDDEN];
            let d_recurrent = &mut d_recurrent[..len * GATES];
            let d_input = &mut d_input[..len * GATES];
            let state = &self.state.values[first * self.state.cols..][..len * self.state.cols];
            for step in (0..step_count).rev() {
                let kept = &self.kept[(first * step_count + step * len) * KEPT..][..len * KEPT];
                dispatch(StepBackward {
                    kept,
                    d_state,
                    d_recurrent,
                    d_input: Some(d_input),
                    sums: &mut sums,
                });
                by_features.add(d_input, GATES, columns(state, self.state.cols, step * FEATURES, FEATURES));
                // The state before the first step is always 0, so this step has no such gradient.
                if step > 0 {
                    by_hidden.add(d_recurrent, GATES, columns(kept, KEPT, KEPT_STATE, HIDDEN));
                    product(&recurrent, d_recurrent, GATES, Some(d_state), d_earlier);
                    d_state.copy_from_slice(d_earlier);
                }
            }
        }
        add_biases(gradients, &self.name, &sums);
        for (matrix, sum, columns) in
            [("weight_hh", by_hidden, 0..HIDDEN), ("weight_ih", by_features, FEATURE_COLUMNS)]
        {
            sum.add_to(0..GATES, gradients.get_mut(&format!("{}.gru.{matrix}", self.name)), columns);
        }
    }
}
