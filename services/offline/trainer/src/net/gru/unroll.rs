//! The recurrent unit over the horizon.

mod backward;

use std::ops::Range;

use nn::kernels::dispatch;
use nn::kernels::product::{PANEL, Panels};

use super::super::matrix::Matrix;
use super::super::tensors::Tensors;
use super::step::{GATES, HIDDEN, KEPT, Step};
use super::{
    BLOCK, CONTROL, ENCODING, ENCODING_COLUMNS, LATENT, LATENT_COLUMNS, by_input, by_state, product,
};

/// Rows of W_h and the head, stacked.
pub(super) const STACKED: usize = GATES + CONTROL;
/// Columns of the product with the stacked matrix: a multiple of 16.
const STRIDE: usize = STACKED.next_multiple_of(PANEL);
/// Columns of the head's output.
const HEAD_STRIDE: usize = CONTROL.next_multiple_of(PANEL);

/// Controls of every draw of every agent.
#[derive(Debug)]
pub(crate) struct Unroll {
    /// Output of the head, `[agents × draws, horizon × 5]`.
    pub(crate) raw: Matrix,
    trace: Option<Kept>,
}

/// Inputs of the recurrent unit.
#[derive(Clone, Debug)]
pub(super) struct Inputs {
    /// Prefix of the tensor names of the unit's weights.
    pub(super) name: String,
    /// `[agents, 128]`
    pub(super) hidden: Matrix,
    /// `[agents, 64]`
    pub(super) encoding: Matrix,
    /// `[agents × draws, 32]`
    pub(super) latent: Matrix,
}

/// The values that the backward pass needs.
#[derive(Debug)]
struct Kept {
    inputs: Inputs,
    /// `[block, step, row of the block, KEPT]`.
    kept: Vec<f32>,
    /// States after the last step, `[agents × draws, 128]`.
    last: Vec<f32>,
}

/// Controls of all draws over `horizon_len` steps: `hidden` `[agents, 128]`, `encoding` `[agents, 64]`,
/// `latent` `[agents × draws, 32]`.
///
/// Without `keep_trace`, less is written and no backward pass is possible.
pub(crate) fn unroll(
    weights: &Tensors,
    (name, hidden, encoding, latent): (&str, &Matrix, &Matrix, &Matrix),
    horizon_len: usize,
    keep_trace: bool,
) -> Unroll {
    assert!(horizon_len > 0, "a step to forecast");
    let draw_count = draw_count(hidden, encoding, latent);
    // Only the backward pass needs the copies.
    let inputs = keep_trace.then(|| Inputs {
        name: name.to_owned(),
        hidden: hidden.clone(),
        encoding: encoding.clone(),
        latent: latent.clone(),
    });
    let entering = Entering::new(weights, name, encoding);
    let network = Network::new(weights, name, hidden, entering);
    let mut raw = Matrix::zeros(latent.rows, horizon_len * CONTROL);
    let mut trace = inputs.map(|inputs| Kept {
        inputs,
        kept: Vec::with_capacity(latent.rows * horizon_len * KEPT),
        last: Vec::with_capacity(latent.rows * HIDDEN),
    });
    let mut memory = Memory::default();
    for agents in blocks(hidden.rows, draw_count) {
        let rows = agents.start * draw_count..agents.end * draw_count;
        network.start(agents, hidden, &latent.values[rows.start * LATENT..rows.end * LATENT], &mut memory);
        let raw = &mut raw.values[rows.start * horizon_len * CONTROL..rows.end * horizon_len * CONTROL];
        network.run(&mut memory, horizon_len, raw, trace.as_mut());
    }
    Unroll { raw, trace }
}

impl Inputs {
    /// Draws per agent.
    pub(super) fn draw_count(&self) -> usize {
        draw_count(&self.hidden, &self.encoding, &self.latent)
    }
}

/// Draws per agent.
fn draw_count(hidden: &Matrix, encoding: &Matrix, latent: &Matrix) -> usize {
    assert_eq!((hidden.cols, encoding.cols, latent.cols), (HIDDEN, ENCODING, LATENT), "columns");
    assert_eq!(hidden.rows, encoding.rows, "a state and an encoding per agent");
    assert!(latent.rows.is_multiple_of(hidden.rows.max(1)), "as many draws for each agent");
    latent.rows / hidden.rows.max(1)
}

/// The agents of each block; empty without draws.
fn blocks(agents_len: usize, draw_count: usize) -> impl Iterator<Item = Range<usize>> {
    let block = (BLOCK / draw_count.max(1)).max(1);
    let agents_len = if draw_count == 0 { 0 } else { agents_len };
    (0..agents_len).step_by(block).map(move |first| first..agents_len.min(first + block))
}

/// W_h with the head's matrix below it, or their biases.
pub(super) fn stacked(weights: &Tensors, name: &str, part: &str) -> Vec<f32> {
    let gru = if part == "weight" { "weight_hh" } else { "bias_hh" };
    [weights.get(&format!("{name}.gru.{gru}")), weights.get(&format!("{name}.head.{part}"))].concat()
}

/// The input I of the steps.
struct Entering<'a> {
    /// The columns of W_i that read z.
    latent: Panels,
    /// I after the first step, which is the bias only.
    idle: &'a [f32],
    /// I of the first step without z, `[agents, 384]`.
    context: Matrix,
}

/// The matrices that all blocks share.
struct Network<'a> {
    entering: Entering<'a>,
    stacked: Panels,
    head: Panels,
    /// Output of the stacked matrix for the states before the first step, `[agents, STRIDE]`.
    first: Matrix,
}

/// Buffers of a block.
#[derive(Default)]
struct Memory {
    /// I of the first step, without and with z.
    context: Vec<f32>,
    input: Vec<f32>,
    /// Output of the stacked matrix.
    recurrent: Vec<f32>,
    state: Vec<f32>,
    /// Output of the head for the last states.
    head: Vec<f32>,
}

impl<'a> Entering<'a> {
    fn new(weights: &'a Tensors, name: &str, encoding: &Matrix) -> Self {
        let idle = weights.get(&format!("{name}.gru.bias_ih"));
        let mut context = Matrix::zeros(encoding.rows, GATES);
        let by_encoding = by_input(weights, name, ENCODING_COLUMNS, Some(idle));
        product(&by_encoding, &encoding.values, ENCODING, None, &mut context.values);
        Self { latent: by_input(weights, name, LATENT_COLUMNS, None), idle, context }
    }

    /// Writes I of the first step for all draws of `agents` to `input`, and its part without z to `context`.
    fn put(&self, agents: Range<usize>, latent: &[f32], context: &mut Vec<f32>, input: &mut Vec<f32>) {
        let row_count = latent.len() / LATENT;
        let draw_count = row_count / agents.len().max(1);
        context.clear();
        agents.for_each(|agent| {
            (0..draw_count).for_each(|_| context.extend_from_slice(self.context.row(agent)));
        });
        input.resize(row_count * GATES, 0.0);
        product(&self.latent, latent, LATENT, Some(context), input);
    }
}

impl<'a> Network<'a> {
    fn new(weights: &Tensors, name: &str, hidden: &Matrix, entering: Entering<'a>) -> Self {
        let [matrix, bias] = ["weight", "bias"].map(|part| stacked(weights, name, part));
        let stacked = by_state(&matrix, &bias);
        let mut first = Matrix::zeros(hidden.rows, STRIDE);
        product(&stacked, &hidden.values, HIDDEN, None, &mut first.values);
        Self { entering, stacked, head: by_state(&matrix[GATES * HIDDEN..], &bias[GATES..]), first }
    }

    /// Sets state, I and H of the first step for all draws of `agents`.
    fn start(&self, agents: Range<usize>, hidden: &Matrix, latent: &[f32], memory: &mut Memory) {
        let row_count = latent.len() / LATENT;
        let draw_count = row_count / agents.len().max(1);
        self.entering.put(agents.clone(), latent, &mut memory.context, &mut memory.input);
        memory.recurrent.clear();
        memory.state.clear();
        for agent in agents.flat_map(|agent| std::iter::repeat_n(agent, draw_count)) {
            memory.recurrent.extend_from_slice(self.first.row(agent));
            memory.state.extend_from_slice(hidden.row(agent));
        }
        memory.head.resize(row_count * HEAD_STRIDE, 0.0);
    }

    /// Runs a block over the horizon; `raw` `[rows, horizon × 5]`.
    fn run(&self, memory: &mut Memory, horizon_len: usize, raw: &mut [f32], mut trace: Option<&mut Kept>) {
        let Memory { input, recurrent, state, head, .. } = memory;
        for step in 0..horizon_len {
            if step > 0 {
                product(&self.stacked, state, HIDDEN, None, recurrent);
                copy_controls(raw, horizon_len, step - 1, &recurrent[GATES..], STRIDE);
            }
            dispatch(Step {
                input: if step == 0 { input } else { self.entering.idle },
                recurrent,
                state,
                present: None,
                kept: trace.as_deref_mut().map(|trace| &mut trace.kept),
            });
        }
        product(&self.head, state, HIDDEN, None, head);
        copy_controls(raw, horizon_len, horizon_len - 1, head, HEAD_STRIDE);
        if let Some(trace) = trace {
            trace.last.extend_from_slice(state);
        }
    }
}

/// Copies the head's output at a step. Rows of `from` are `stride` floats apart.
fn copy_controls(raw: &mut [f32], horizon_len: usize, step: usize, from: &[f32], stride: usize) {
    for (raw, from) in raw.chunks_exact_mut(horizon_len * CONTROL).zip(from.chunks(stride)) {
        raw[step * CONTROL..][..CONTROL].copy_from_slice(&from[..CONTROL]);
    }
}
