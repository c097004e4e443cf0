//! The way back over the horizon.

use std::ops::Range;

use nn::kernels::dispatch;
use nn::kernels::product::Panels;

use super::super::super::matrix::{Into, Matrix, View, ViewMut, by_input, by_matrix};
use super::super::super::tensors::{Gradients, Tensors};
use super::super::step::{GATES, HIDDEN, KEPT, KEPT_STATE, SUMS, StepBackward};
use super::super::{CONTROL, ENCODING_COLUMNS, LATENT_COLUMNS, add_biases, product, to_state};
use super::{STACKED, STRIDE, Trace, Unroll, blocks, draws_len, stacked};

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
    /// Adds to the gradients of recurrent unit and head, given that of `raw`; returns those by the inputs.
    ///
    /// # Panics
    /// Where no trace was kept.
    pub(crate) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        d_raw: &Matrix,
    ) -> UnrollGradients {
        let trace = self.trace.as_ref().expect("the way back needs a trace");
        assert_eq!((d_raw.rows, d_raw.cols), (self.raw.rows, self.raw.cols), "a gradient per control");
        let draws_len = draws_len(&trace.hidden, &trace.encoding, &trace.latent);
        let stacked = stacked(weights, &trace.name, "weight");
        let mut back = Back {
            trace,
            to_state: to_state(&stacked),
            head: stacked[GATES * HIDDEN..].to_vec(),
            horizon_len: d_raw.cols / CONTROL,
            d_stacked: Matrix::zeros(STACKED, HIDDEN),
            sums: [0.0; SUMS],
            first: First {
                d_state: Matrix::zeros(d_raw.rows, HIDDEN),
                d_recurrent: Matrix::zeros(d_raw.rows, GATES),
                d_input: Matrix::zeros(d_raw.rows, GATES),
            },
        };
        for agents in blocks(trace.hidden.rows, draws_len) {
            back.block(agents.start * draws_len..agents.end * draws_len, d_raw);
        }
        back.add_to(gradients, d_raw);
        back.first.backward(weights, gradients, trace)
    }
}

/// The way back in progress.
struct Back<'a> {
    trace: &'a Trace,
    to_state: Panels,
    head: Vec<f32>,
    horizon_len: usize,
    d_stacked: Matrix,
    sums: [f32; SUMS],
    first: First,
}

/// Gradients of all rows at the first step.
struct First {
    /// By the state before it, what passes H left out.
    d_state: Matrix,
    d_recurrent: Matrix,
    d_input: Matrix,
}

impl Back<'_> {
    /// Takes a block of rows from the last step to the first.
    fn block(&mut self, rows: Range<usize>, d_raw: &Matrix) {
        let (len, horizon_len) = (rows.len(), self.horizon_len);
        let d_raw = &d_raw.values[rows.start * d_raw.cols..rows.end * d_raw.cols];
        let d_controls = View::new(d_raw, len, horizon_len * CONTROL);
        let d_controls = d_controls.columns((horizon_len - 1) * CONTROL, CONTROL);
        let last = &self.trace.last[rows.start * HIDDEN..rows.end * HIDDEN];
        let d_head = &mut self.d_stacked.values[GATES * HIDDEN..];
        by_matrix(d_controls, View::new(last, len, HIDDEN), ViewMut::new(d_head, CONTROL, HIDDEN));
        let [mut d_state, mut d_earlier] = [(); 2].map(|()| Matrix::zeros(len, HIDDEN));
        by_input(d_controls, View::new(&self.head, CONTROL, HIDDEN), d_state.view_mut(), Into::Replace);
        let kept = &self.trace.kept[rows.start * horizon_len * KEPT..rows.end * horizon_len * KEPT];
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
            let state = View::new(kept, len, KEPT).columns(KEPT_STATE, HIDDEN);
            by_matrix(d_recurrent.view().columns(0, STACKED), state, self.d_stacked.view_mut());
            let through = Some(&d_state.values[..]);
            product(&self.to_state, &d_recurrent.values, STRIDE, through, &mut d_earlier.values);
            std::mem::swap(&mut d_state, &mut d_earlier);
        }
        self.first.set(rows, &kept[..len * KEPT], &d_state, &mut self.sums);
    }

    /// Adds to the gradients what all steps share.
    fn add_to(&self, gradients: &mut Gradients, d_raw: &Matrix) {
        let name = &self.trace.name;
        add_biases(gradients, name, &self.sums);
        let (recurrent, head) = self.d_stacked.values.split_at(GATES * HIDDEN);
        for (tensor, sums) in [("gru.weight_hh", recurrent), ("head.weight", head)] {
            let gradient = gradients.get_mut(&format!("{name}.{tensor}"));
            gradient.iter_mut().zip(sums).for_each(|(gradient, sum)| *gradient += sum);
        }
        let bias = gradients.get_mut(&format!("{name}.head.bias"));
        for controls in d_raw.values.chunks_exact(CONTROL) {
            bias.iter_mut().zip(controls).for_each(|(sum, value)| *sum += value);
        }
    }
}

impl First {
    /// Takes a block of rows back through the first step's gates; `d_state` is the gradient by the state after it.
    fn set(&mut self, rows: Range<usize>, kept: &[f32], d_state: &Matrix, sums: &mut [f32; SUMS]) {
        let through = &mut self.d_state.values[rows.start * HIDDEN..rows.end * HIDDEN];
        through.copy_from_slice(&d_state.values);
        dispatch(StepBackward {
            kept,
            d_state: through,
            d_recurrent: &mut self.d_recurrent.values[rows.start * GATES..rows.end * GATES],
            d_input: Some(&mut self.d_input.values[rows.start * GATES..rows.end * GATES]),
            sums,
        });
    }

    /// The products of the first step: those with z row by row, the others with the sum over an agent's draws.
    fn backward(&self, weights: &Tensors, gradients: &mut Gradients, trace: &Trace) -> UnrollGradients {
        let agents_len = trace.hidden.rows;
        let [input_name, recurrent_name] =
            ["weight_ih", "weight_hh"].map(|part| format!("{}.gru.{part}", trace.name));
        let mut part = |columns: Range<usize>, dy: &Matrix, x: &Matrix| {
            let mut dx = Matrix::zeros(x.rows, x.cols);
            let matrix = weights.matrix(&input_name).columns(columns.start, columns.len());
            by_input(dy.view(), matrix, dx.view_mut(), Into::Replace);
            let d_matrix = gradients.matrix_mut(&input_name).columns(columns.start, columns.len());
            by_matrix(dy.view(), x.view(), d_matrix);
            dx
        };
        let latent = part(LATENT_COLUMNS, &self.d_input, &trace.latent);
        let encoding = part(ENCODING_COLUMNS, &sum_of_draws(&self.d_input, agents_len), &trace.encoding);
        let d_recurrent = sum_of_draws(&self.d_recurrent, agents_len);
        let mut hidden = sum_of_draws(&self.d_state, agents_len);
        by_input(d_recurrent.view(), weights.matrix(&recurrent_name), hidden.view_mut(), Into::Add);
        by_matrix(d_recurrent.view(), trace.hidden.view(), gradients.matrix_mut(&recurrent_name));
        UnrollGradients { hidden, encoding, latent }
    }
}

/// The sum of the rows of each agent, as many for each.
fn sum_of_draws(rows: &Matrix, agents_len: usize) -> Matrix {
    let mut sums = Matrix::zeros(agents_len, rows.cols);
    let draws_len = rows.rows / agents_len.max(1);
    for (row, values) in rows.values.chunks_exact(rows.cols).enumerate() {
        let sum = sums.row_mut(row / draws_len);
        sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }
    sums
}
