//! The edge update between two rounds. \[model §3\]
//!
//! ```text
//! e'_ij = W₁ ReLU(W₀ [v̄_i ‖ v̄_j ‖ e_ij] + b₀) + b₁
//! ```
//!
//! The columns of W₀ that multiply a node's attributes are applied once per node.

use super::shape::{BLOCK, Block, EDGE, Edges, NODE};
use crate::kernel::kernel;
use crate::net::matrix::{Into, Matrix, View, ViewMut, by_bias, by_input, by_matrix, forward};
use crate::net::tensors::{Gradients, Tensors};

/// Hidden units.
const HIDDEN: usize = 128;
type Units = [f32; HIDDEN];

/// First columns of W₀ that multiply the receiver, the sender and the edge.
const RECEIVER: usize = 0;
const SENDER: usize = NODE;
const OWN: usize = 2 * NODE;

/// The nodes' part of the hidden units.
#[derive(Debug)]
pub(super) struct Update {
    /// Parts of the receivers, including b₀, `[rows, 128]`.
    receivers: Matrix,
    senders: Matrix,
}

impl Update {
    pub(super) fn new(weights: &Tensors, name: &str, node: &Matrix) -> Self {
        let matrix = weights.matrix(&format!("{name}.edge.0.weight"));
        let bias = weights.get(&format!("{name}.edge.0.bias"));
        let mut receivers = Matrix::new(node.rows, HIDDEN, bias.repeat(node.rows));
        forward(node.view(), matrix.columns(RECEIVER, NODE), receivers.view_mut(), Into::Add);
        let mut senders = Matrix::zeros(node.rows, HIDDEN);
        forward(node.view(), matrix.columns(SENDER, NODE), senders.view_mut(), Into::Replace);
        Self { receivers, senders }
    }

    /// The new attributes `[edges, 16]`.
    pub(super) fn run(&self, weights: &Tensors, name: &str, edge: &Matrix, edges: &Edges) -> Matrix {
        let bias = weights.get(&format!("{name}.edge.1.bias"));
        let mut updated = Matrix::new(edges.len(), EDGE, bias.repeat(edges.len()));
        let out = weights.matrix(&format!("{name}.edge.1.weight"));
        let mut memory = vec![0.0; BLOCK * HIDDEN];
        for block in edges.blocks() {
            let hidden = self.hidden(weights, name, block, edge, &mut memory);
            forward(View::new(hidden, block.len(), HIDDEN), out, block.view_mut(&mut updated), Into::Add);
        }
        updated
    }

    /// The hidden units of a block, `[block, 128]` in `memory`.
    fn hidden<'m>(
        &self,
        weights: &Tensors,
        name: &str,
        block: Block<'_>,
        edge: &Matrix,
        memory: &'m mut [f32],
    ) -> &'m [f32] {
        let hidden = &mut memory[..block.len() * HIDDEN];
        let matrix = weights.matrix(&format!("{name}.edge.0.weight")).columns(OWN, EDGE);
        forward(block.view(edge), matrix, ViewMut::new(hidden, block.len(), HIDDEN), Into::Replace);
        let (receivers, senders) = (self.receivers.values.as_chunks().0, self.senders.values.as_chunks().0);
        rectify(block, receivers, senders, hidden.as_chunks_mut().0);
        hidden
    }

    /// Adds to the gradients by `node` and `edge`, the attributes before the update, given the gradient
    /// `d_edge` by the new ones.
    pub(super) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        name: &str,
        edges: &Edges,
        (node, edge): (&Matrix, &Matrix),
        d_edge: &Matrix,
        (by_node, by_edge): (&mut Matrix, &mut Matrix),
    ) {
        let [first, first_bias] = ["weight", "bias"].map(|part| format!("{name}.edge.0.{part}"));
        let [out, out_bias] = ["weight", "bias"].map(|part| format!("{name}.edge.1.{part}"));
        let mut by_receivers = Matrix::zeros(node.rows, HIDDEN);
        let mut by_senders = Matrix::zeros(node.rows, HIDDEN);
        let (mut memory, mut d_memory) = (vec![0.0; BLOCK * HIDDEN], vec![0.0; BLOCK * HIDDEN]);
        for block in edges.blocks() {
            let hidden = self.hidden(weights, name, block, edge, &mut memory);
            let d_hidden = &mut d_memory[..block.len() * HIDDEN];
            let view = ViewMut::new(d_hidden, block.len(), HIDDEN);
            by_input(block.view(d_edge), weights.matrix(&out), view, Into::Replace);
            let by_ends = [&mut by_receivers, &mut by_senders].map(|by_end| by_end.values.as_chunks_mut().0);
            rectify_backward(block, hidden.as_chunks().0, d_hidden.as_chunks_mut().0, by_ends);
            let [hidden, d_hidden] = [hidden, d_hidden].map(|values| View::new(values, block.len(), HIDDEN));
            by_matrix(block.view(d_edge), hidden, gradients.matrix_mut(&out));
            by_matrix(d_hidden, block.view(edge), gradients.matrix_mut(&first).columns(OWN, EDGE));
            let matrix = weights.matrix(&first).columns(OWN, EDGE);
            by_input(d_hidden, matrix, block.view_mut(by_edge), Into::Add);
        }
        by_bias(d_edge, gradients.get_mut(&out_bias));
        by_bias(&by_receivers, gradients.get_mut(&first_bias));
        for (part, by_part) in [(RECEIVER, &by_receivers), (SENDER, &by_senders)] {
            by_matrix(by_part.view(), node.view(), gradients.matrix_mut(&first).columns(part, NODE));
            by_input(
                by_part.view(),
                weights.matrix(&first).columns(part, NODE),
                by_node.view_mut(),
                Into::Add,
            );
        }
    }
}

kernel! {
    /// Adds the parts of receiver and sender to the edges' own part, and rectifies the sum.
    fn rectify<'a>(block: Block<'a>, receivers: &'a [Units], senders: &'a [Units], hidden: &'a mut [Units]) {
        for ((receiver, sender), hidden) in block.ends().zip(hidden) {
            add_rectified(hidden, &receivers[receiver], &senders[sender]);
        }
    }
}

/// The same for one edge.
#[inline(always)]
fn add_rectified(hidden: &mut Units, receiver: &Units, sender: &Units) {
    for i in 0..HIDDEN {
        hidden[i] = (hidden[i] + receiver[i] + sender[i]).max(0.0);
    }
}

kernel! {
    /// Stops the gradient if a hidden unit is 0, and adds it to the gradients of receiver and sender.
    fn rectify_backward<'a>(
        block: Block<'a>,
        hidden: &'a [Units],
        d_hidden: &'a mut [Units],
        by_ends: [&'a mut [Units]; 2],
    ) {
        let [by_receivers, by_senders] = by_ends;
        let edges = hidden.iter().zip(d_hidden);
        for ((receiver, sender), (hidden, d_hidden)) in block.ends().zip(edges) {
            rectified_backward(hidden, d_hidden, &mut by_receivers[receiver], &mut by_senders[sender]);
        }
    }
}

/// The same for one edge. As a separate function, its arguments are known not to overlap, so it vectorises.
#[inline(always)]
fn rectified_backward(hidden: &Units, d_hidden: &mut Units, by_receiver: &mut Units, by_sender: &mut Units) {
    for i in 0..HIDDEN {
        d_hidden[i] = if hidden[i] > 0.0 { d_hidden[i] } else { 0.0 };
        by_receiver[i] += d_hidden[i];
        by_sender[i] += d_hidden[i];
    }
}
