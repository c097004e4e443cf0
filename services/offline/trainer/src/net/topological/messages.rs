//! Messages along the edges, weighted and summed by receiver, forward and backward.

use std::ops::Range;

use super::shape::{BLOCK, Block, NODE};
use crate::kernel::kernel;
use crate::net::matrix::{Into, Matrix, View, forward};

/// The number of heads for which the kernels are specialised.
const USUAL_HEADS: usize = 4;

type Attributes = [f32; NODE];

/// The messages f_act(W v_j + U e_ij) of a block of edges.
#[derive(Clone, Copy)]
pub(in crate::net) struct Messages<'a> {
    pub(in crate::net) block: Block<'a>,
    pub(in crate::net) heads: usize,
    pub(in crate::net) leaky_slope: f32,
    /// W v `[rows, 64]`.
    pub(in crate::net) values: &'a Matrix,
    /// α `[block, heads]`.
    pub(in crate::net) alpha: &'a [f32],
}

impl Messages<'_> {
    /// Adds the weighted messages to `attended` `[rows, 64]`. `own` is U e of the block.
    pub(in crate::net) fn sum(self, own: &[f32], attended: &mut Matrix) {
        add_messages(self, own.as_chunks().0, attended.values.as_chunks_mut().0);
    }
}

/// The backward pass of all messages, and through the softmax α to the scores s:
///
/// ```text
/// ∂m_ij = α_ij ∂v̄_i
/// ∂s_ij = α_ij (∂α_ij − Σ_k α_ik ∂α_ik) = α_ij (∂v̄_i · m_ij − ∂v̄_i · v̄_i)
/// ```
///
/// The products are over the attributes of a head.
pub(in crate::net) struct MessagesBackward {
    /// By the scores, `[edges, heads]`.
    pub(in crate::net) by_scores: Matrix,
    /// By W v, `[rows, 64]`.
    pub(in crate::net) by_values: Matrix,
    /// The terms of the products, `[block, 64]`.
    terms: Vec<f32>,
    /// Matrix `[heads, 64]` that sums the terms by head.
    head_sums: Matrix,
}

impl MessagesBackward {
    pub(in crate::net) fn new(edges_len: usize, row_count: usize, heads: usize) -> Self {
        let mut head_sums = Matrix::zeros(heads, NODE);
        for (head, section) in sections(heads).enumerate() {
            head_sums.row_mut(head)[section].fill(1.0);
        }
        let (by_scores, by_values) = (Matrix::zeros(edges_len, heads), Matrix::zeros(row_count, NODE));
        Self { by_scores, by_values, terms: vec![0.0; BLOCK * NODE], head_sums }
    }

    /// Processes a block, given v̄ and the gradient by v̄, `[rows, 64]`. `own` is U e of the block and
    /// becomes the gradient by U e.
    pub(in crate::net) fn run(
        &mut self,
        messages: Messages<'_>,
        (attended, d_attended): (&Matrix, &Matrix),
        own: &mut [f32],
    ) {
        let Messages { block, alpha, .. } = messages;
        let terms = &mut self.terms[..block.len() * NODE];
        let by_values = self.by_values.values.as_chunks_mut().0;
        messages_backward(
            messages,
            [attended, d_attended].map(|attended| attended.values.as_chunks().0),
            own.as_chunks_mut().0,
            terms.as_chunks_mut().0,
            by_values,
        );
        let terms = View::new(terms, block.len(), NODE);
        forward(terms, self.head_sums.view(), block.view_mut(&mut self.by_scores), Into::Replace);
        let by_scores = block.of_mut(&mut self.by_scores).iter_mut();
        by_scores.zip(alpha).for_each(|(by_score, alpha)| *by_score *= alpha);
    }
}

/// The derivative of f_act at x, which is also the factor that f_act applies to x.
#[inline(always)]
pub(in crate::net) const fn leaky_factor(slope: f32, x: f32) -> f32 {
    if x > 0.0 { 1.0 } else { slope }
}

/// The range of attributes of every head.
#[inline(always)]
fn sections(heads: usize) -> impl Iterator<Item = Range<usize>> {
    let len = NODE / heads;
    (0..heads).map(move |head| head * len..(head + 1) * len)
}

kernel! {
    fn add_messages<'a>(messages: Messages<'a>, own: &'a [Attributes], attended: &'a mut [Attributes]) {
        match messages.heads {
            USUAL_HEADS => add_with(USUAL_HEADS, messages, own, attended),
            heads => add_with(heads, messages, own, attended),
        }
    }
}

#[inline(always)]
fn add_with(heads: usize, messages: Messages<'_>, own: &[Attributes], attended: &mut [Attributes]) {
    let Messages { block, leaky_slope, values, alpha, .. } = messages;
    let values = values.values.as_chunks().0;
    let edges = own.iter().zip(alpha.chunks_exact(heads));
    for ((receiver, sender), (own, alpha)) in block.ends().zip(edges) {
        add_message(leaky_slope, alpha, &values[sender], own, &mut attended[receiver]);
    }
}

/// Adds one weighted message.
///
/// As a separate function, its arguments are known not to overlap, so it vectorises.
#[inline(always)]
fn add_message(slope: f32, alpha: &[f32], value: &Attributes, own: &Attributes, sum: &mut Attributes) {
    for (alpha, section) in alpha.iter().zip(sections(alpha.len())) {
        for i in section {
            let x = value[i] + own[i];
            sum[i] += alpha * x * leaky_factor(slope, x);
        }
    }
}

kernel! {
    fn messages_backward<'a>(
        messages: Messages<'a>,
        attended: [&'a [Attributes]; 2],
        own: &'a mut [Attributes],
        terms: &'a mut [Attributes],
        by_values: &'a mut [Attributes],
    ) {
        match messages.heads {
            USUAL_HEADS => backward_with(USUAL_HEADS, messages, attended, own, terms, by_values),
            heads => backward_with(heads, messages, attended, own, terms, by_values),
        }
    }
}

#[inline(always)]
fn backward_with(
    heads: usize,
    messages: Messages<'_>,
    [attended, d_attended]: [&[Attributes]; 2],
    own: &mut [Attributes],
    terms: &mut [Attributes],
    by_values: &mut [Attributes],
) {
    let Messages { block, leaky_slope, values, alpha, .. } = messages;
    let values = values.values.as_chunks().0;
    let edges = own.iter_mut().zip(terms).zip(alpha.chunks_exact(heads));
    for ((receiver, sender), ((own, terms), alpha)) in block.ends().zip(edges) {
        let received = (&attended[receiver], &d_attended[receiver]);
        let (value, by_value) = (&values[sender], &mut by_values[sender]);
        message_backward(leaky_slope, alpha, value, received, own, terms, by_value);
    }
}

/// The backward pass of one message. `terms` are the terms of ∂v̄_i · m_ij − ∂v̄_i · v̄_i. It is a separate
/// function for the same reason as [`add_message`].
#[inline(always)]
fn message_backward(
    slope: f32,
    alpha: &[f32],
    value: &Attributes,
    (attended, d_attended): (&Attributes, &Attributes),
    own: &mut Attributes,
    terms: &mut Attributes,
    by_value: &mut Attributes,
) {
    for (alpha, section) in alpha.iter().zip(sections(alpha.len())) {
        for i in section {
            let x = value[i] + own[i];
            let factor = leaky_factor(slope, x);
            terms[i] = d_attended[i] * (factor * x - attended[i]);
            own[i] = d_attended[i] * factor * alpha;
            by_value[i] += own[i];
        }
    }
}
