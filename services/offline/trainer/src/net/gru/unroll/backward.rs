//! The backward pass over the horizon.

use std::ops::Range;

use nn::kernels::dispatch;
use nn::kernels::product::Panels;

use super::super::super::matrix::{Into, Matrix, by_input};
use super::super::super::tensors::{Gradients, Tensors};
use super::super::step::{GATES, HIDDEN, KEPT, KEPT_STATE, SUMS, StepBackward};
use super::super::sum::{MatrixSum, columns};
use super::super::{
    CONTROL, ENCODING, ENCODING_COLUMNS, LATENT, LATENT_COLUMNS, add_biases, product, to_state,
};
use super::{Inputs, Kept, STACKED, STRIDE, Unroll, blocks, stacked};

/// Gradients by the inputs of [`super::unroll`].
#[derive(Clone, Debug)]
pub(crate) struct UnrollGradients {
    /// By the state before the first step, `[agents, 128]`.
    pub(crate) hidden: Matrix,
    /// By ṽ, `[agents, 64]`.
    pub(crate) encoding: Matrix,
    /// By the latent variables, `[agents × draws, 32]`.
    pub(crate) latent: Matrix,
}

impl Unroll {
    /// Adds to the gradients of recurrent unit and head, given the gradient by `raw`. Returns the gradients
    /// by the inputs.
    pub(crate) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        d_raw: &Matrix,
    ) -> UnrollGradients {
        assert_eq!((d_raw.rows, d_raw.cols), (self.raw.rows, self.raw.cols), "a gradient per control");
        let kept = self.trace.as_ref().expect("the backward pass needs a trace");
        kept.backward(weights, gradients, d_raw)
    }
}

impl Kept {
    fn backward(&self, weights: &Tensors, gradients: &mut Gradients, d_raw: &Matrix) -> UnrollGradients {
        let Self { inputs, .. } = self;
        let draw_count = inputs.draw_count();
        let stacked = stacked(weights, &inputs.name, "weight");
        let mut pass = HorizonBackward {
            kept: self,
            to_state: to_state(&stacked),
            head_to_state: to_state(&stacked[GATES * HIDDEN..]),
            horizon_len: d_raw.cols / CONTROL,
            by_stacked: MatrixSum::zeros(STACKED, HIDDEN),
            by_head: MatrixSum::zeros(CONTROL, HIDDEN),
            sums: [0.0; SUMS],
            first: First {
                d_state: Matrix::zeros(d_raw.rows, HIDDEN),
                d_recurrent: Some(Matrix::zeros(d_raw.rows, GATES)),
                d_input: Matrix::zeros(d_raw.rows, GATES),
            },
        };
        for agents in blocks(inputs.hidden.rows, draw_count) {
            pass.block(agents.start * draw_count..agents.end * draw_count, d_raw);
        }
        pass.add_to(gradients, d_raw);
        pass.first.backward(weights, gradients, inputs)
    }
}

/// A backward pass in progress.
struct HorizonBackward<'a> {
    kept: &'a Kept,
    to_state: Panels,
    head_to_state: Panels,
    horizon_len: usize,
    /// The gradient by the stacked matrix, without the head's part of the last states.
    by_stacked: MatrixSum,
    /// The gradient by the head through the last states.
    by_head: MatrixSum,
    sums: [f32; SUMS],
    first: First,
}

/// Gradients of all rows at the first step.
pub(in super::super) struct First {
    /// By the state before it, `[agents × draws, 128]`.
    pub(in super::super) d_state: Matrix,
    /// By H, `[agents × draws, 384]`, until the gradients by the state and by W_h include it.
    pub(in super::super) d_recurrent: Option<Matrix>,
    /// By I, `[agents × draws, 384]`.
    pub(in super::super) d_input: Matrix,
}

impl HorizonBackward<'_> {
    /// Processes a block of rows from the last step to the first.
    fn block(&mut self, rows: Range<usize>, d_raw: &Matrix) {
        let (len, horizon_len) = (rows.len(), self.horizon_len);
        let d_raw = &d_raw.values[rows.start * d_raw.cols..rows.end * d_raw.cols];
        let last = &self.kept.last[rows.start * HIDDEN..rows.end * HIDDEN];
        let d_last = &d_raw[(horizon_len - 1) * CONTROL..];
        self.by_head.add(d_last, horizon_len * CONTROL, columns(last, HIDDEN, 0, HIDDEN));
        let [mut d_state, mut d_earlier] = [(); 2].map(|()| Matrix::zeros(len, HIDDEN));
        product(&self.head_to_state, d_last, horizon_len * CONTROL, None, &mut d_state.values);
        let kept = &self.kept.kept[rows.start * horizon_len * KEPT..rows.end * horizon_len * KEPT];
        let mut d_recurrent = Matrix::zeros(len, STRIDE);
        for step in (1..horizon_len).rev() {
            let kept = &kept[step * len * KEPT..][..len * KEPT];
            for (d_recurrent, d_raw) in
                d_recurrent.values.chunks_exact_mut(STRIDE).zip(d_raw.chunks_exact(horizon_len * CONTROL))
            {
                d_recurrent[GATES..STACKED].copy_from_slice(&d_raw[(step - 1) * CONTROL..][..CONTROL]);
            }
            dispatch(StepBackward {
                kept,
                d_state: &mut d_state.values,
                d_recurrent: &mut d_recurrent.values,
                d_input: None,
                sums: &mut self.sums,
            });
            let state = columns(kept, KEPT, KEPT_STATE, HIDDEN);
            self.by_stacked.add(&d_recurrent.values, STRIDE, state);
            let through = Some(&d_state.values[..]);
            product(&self.to_state, &d_recurrent.values, STRIDE, through, &mut d_earlier.values);
            std::mem::swap(&mut d_state, &mut d_earlier);
        }
        self.first.set(rows, &kept[..len * KEPT], &d_state, &mut self.sums);
    }

    /// Adds the sums over all steps to the gradients.
    fn add_to(&self, gradients: &mut Gradients, d_raw: &Matrix) {
        let name = &self.kept.inputs.name;
        add_biases(gradients, name, &self.sums);
        let recurrent = gradients.get_mut(&format!("{name}.gru.weight_hh"));
        self.by_stacked.add_to(0..GATES, recurrent, 0..HIDDEN);
        let head = gradients.get_mut(&format!("{name}.head.weight"));
        self.by_stacked.add_to(GATES..STACKED, head, 0..HIDDEN);
        self.by_head.add_to(0..CONTROL, head, 0..HIDDEN);
        let bias = gradients.get_mut(&format!("{name}.head.bias"));
        for controls in d_raw.values.chunks_exact(CONTROL) {
            bias.iter_mut().zip(controls).for_each(|(sum, value)| *sum += value);
        }
    }
}

impl First {
    /// Processes the first step's gates for a block of rows. `d_state` is the gradient by the state after the
    /// step.
    fn set(&mut self, rows: Range<usize>, kept: &[f32], d_state: &Matrix, sums: &mut [f32; SUMS]) {
        let through = &mut self.d_state.values[rows.start * HIDDEN..rows.end * HIDDEN];
        through.copy_from_slice(&d_state.values);
        let d_recurrent = &mut self.d_recurrent.as_mut().expect("the processor leaves it").values;
        dispatch(StepBackward {
            kept,
            d_state: through,
            d_recurrent: &mut d_recurrent[rows.start * GATES..rows.end * GATES],
            d_input: Some(&mut self.d_input.values[rows.start * GATES..rows.end * GATES]),
            sums,
        });
    }

    /// The products of the first step. Products with z use each row, the others the sum over an agent's
    /// draws.
    pub(in super::super) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        inputs: &Inputs,
    ) -> UnrollGradients {
        let agents_len = inputs.hidden.rows;
        let [input_name, recurrent_name] =
            ["weight_ih", "weight_hh"].map(|part| format!("{}.gru.{part}", inputs.name));
        let mut backward = |name: &str, part: Range<usize>, dy: &Matrix, x: &Matrix, dx: &mut Matrix| {
            by_input(
                dy.view(),
                weights.matrix(name).columns(part.start, part.len()),
                dx.view_mut(),
                Into::Add,
            );
            let mut sum = MatrixSum::zeros(GATES, x.cols);
            sum.add(&dy.values, GATES, columns(&x.values, x.cols, 0, x.cols));
            sum.add_to(0..GATES, gradients.get_mut(name), part);
        };
        let mut latent = Matrix::zeros(inputs.latent.rows, LATENT);
        backward(&input_name, LATENT_COLUMNS, &self.d_input, &inputs.latent, &mut latent);
        let d_input = sum_of_draws(&self.d_input, agents_len);
        let mut encoding = Matrix::zeros(agents_len, ENCODING);
        backward(&input_name, ENCODING_COLUMNS, &d_input, &inputs.encoding, &mut encoding);
        let mut hidden = sum_of_draws(&self.d_state, agents_len);
        if let Some(d_recurrent) = &self.d_recurrent {
            let d_recurrent = sum_of_draws(d_recurrent, agents_len);
            backward(&recurrent_name, 0..HIDDEN, &d_recurrent, &inputs.hidden, &mut hidden);
        }
        UnrollGradients { hidden, encoding, latent }
    }
}

/// The sum of each agent's rows. All agents have the same number of rows.
fn sum_of_draws(rows: &Matrix, agents_len: usize) -> Matrix {
    let mut sums = Matrix::zeros(agents_len, rows.cols);
    let draw_count = rows.rows / agents_len.max(1);
    for (row, values) in rows.values.chunks_exact(rows.cols).enumerate() {
        let sum = sums.row_mut(row / draw_count);
        sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
    sums
}
