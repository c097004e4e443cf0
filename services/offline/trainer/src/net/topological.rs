//! Topological attention over ragged graphs, forward and backward. \[model §3\]
//!
//! A *row* is an agent at one step at which it is present. An *edge* joins a receiving row to a sending row.
//! Every head has its own λ and μ and computes
//!
//! ```text
//! d_ij = ‖v_i − v_j‖²   l_ij = ‖e_ij‖²   α_ij = softmax_j∈N(i) of −(λ d_ij + μ l_ij)
//! m_ij = f_act(W v_j + U e_ij)           v̄_i = Σ_j α_ij m_ij                       [paper, Eq. topological]
//! ```
//!
//! (f(α x) = α f(x) since α ≥ 0.) Equal attention is the same with λ = μ = 0. Wide values per edge are never
//! kept. Blocks of edges that fit the cache go through the whole layer, and the backward pass computes their
//! messages again.

use super::matrix::{Into, Matrix, View, ViewMut, by_input, by_matrix, forward};
use super::tensors::{Gradients, Tensors};
use messages::{Messages, MessagesBackward};
use scores::Coefficients;
use shape::EDGE;
pub(crate) use shape::{AttentionShape, Edges};
pub(super) use shape::{BLOCK, Block, NODE};
use update::Update;

pub(super) mod messages;
pub(super) mod scores;
mod shape;
#[cfg(test)]
mod tests;
mod update;

/// One round of topological attention.
#[derive(Debug)]
pub(crate) struct Round {
    /// α `[edges, heads]`.
    pub(crate) alpha: Matrix,
    /// New node attributes v̄ `[rows, 64]`; zeros for a row without edges.
    pub(crate) node: Matrix,
    /// New edge attributes `[edges, 16]`; `None` after the last round.
    pub(crate) edge: Option<Matrix>,
    trace: Trace,
}

/// The values that the backward pass also needs.
#[derive(Debug)]
struct Trace {
    /// Prefix of the tensors' names.
    name: String,
    shape: AttentionShape,
    node: Matrix,
    edge: Matrix,
    /// W v `[rows, 64]`.
    values: Matrix,
    /// d and l, `[edges, 2]`.
    squares: Matrix,
    update: Option<Update>,
}

/// The messages of a block.
fn messages<'a>(
    shape: AttentionShape,
    block: Block<'a>,
    values: &'a Matrix,
    alpha: &'a Matrix,
) -> Messages<'a> {
    let AttentionShape { heads, leaky_slope, .. } = shape;
    Messages { block, heads, leaky_slope, values, alpha: block.of(alpha) }
}

/// A round on `node` `[rows, 64]` and `edge` `[edges, 16]`. All rounds but the `last` update the edges.
pub(crate) fn round(
    weights: &Tensors,
    shape: AttentionShape,
    round: usize,
    node: Matrix,
    edge: Matrix,
    edges: &Edges,
    last: bool,
) -> Round {
    assert_eq!((node.cols, edge.cols), (NODE, EDGE), "attributes of nodes and edges");
    assert_eq!((node.rows + 1, edge.rows), (edges.first.len(), edges.len()), "rows and edges");
    let name = format!("gdat.topological.{round}");
    let squares = scores::squares(&node, &edge, edges);
    let alpha = Coefficients::read(weights, shape, &name).weigh(&squares, edges);
    let mut values = Matrix::zeros(node.rows, NODE);
    forward(node.view(), weights.matrix(&format!("{name}.w_n.weight")), values.view_mut(), Into::Replace);

    let u = edge_matrix(weights, shape, &name);
    let mut attended = Matrix::zeros(node.rows, NODE);
    let mut own = vec![0.0; BLOCK * NODE];
    for block in edges.blocks() {
        let own = own_messages(u, block, &edge, &mut own);
        messages(shape, block, &values, &alpha).sum(own, &mut attended);
    }
    let mut new_edge = None;
    let update = (!last).then(|| Update::new(weights, &name, &attended));
    if let Some(update) = &update {
        new_edge = Some(update.run(weights, &name, &edge, edges));
    }
    let trace = Trace { name, shape, node, edge, values, squares, update };
    Round { alpha, node: attended, edge: new_edge, trace }
}

impl Round {
    /// Gradients by the node and edge attributes before the round, given the gradients by the new ones.
    pub(crate) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        edges: &Edges,
        mut d_node: Matrix,
        d_edge: Option<Matrix>,
    ) -> (Matrix, Matrix) {
        let Trace { name, shape, node, edge, squares, update, .. } = &self.trace;
        let mut by_edge = Matrix::zeros(edge.rows, EDGE);
        if let (Some(update), Some(d_edge)) = (update, d_edge) {
            let attributes = (&self.node, edge);
            update.backward(
                weights,
                gradients,
                name,
                edges,
                attributes,
                &d_edge,
                (&mut d_node, &mut by_edge),
            );
        }
        let MessagesBackward { by_scores, by_values, .. } =
            self.messages_backward(weights, gradients, edges, &d_node, &mut by_edge);
        let coefficients = Coefficients::read(weights, *shape, name);
        let by_squares = coefficients.backward(weights, gradients, name, squares, &by_scores);

        let matrix = format!("{name}.w_n.weight");
        by_matrix(by_values.view(), node.view(), gradients.matrix_mut(&matrix));
        let mut by_node = Matrix::zeros(node.rows, NODE);
        by_input(by_values.view(), weights.matrix(&matrix), by_node.view_mut(), Into::Replace);
        scores::squares_backward(node, edge, edges, &by_squares, &mut by_node, &mut by_edge);
        (by_node, by_edge)
    }

    /// Gradients by the scores and by W v, given the gradient by v̄. Adds to the gradients of U and by the
    /// edges' attributes.
    fn messages_backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        edges: &Edges,
        d_node: &Matrix,
        by_edge: &mut Matrix,
    ) -> MessagesBackward {
        let Trace { name, shape, node, edge, values, .. } = &self.trace;
        let u = edge_matrix(weights, *shape, name);
        let mut back = MessagesBackward::new(edges.len(), node.rows, shape.heads);
        let mut own = vec![0.0; BLOCK * NODE];
        for block in edges.blocks() {
            let own = own_messages(u, block, edge, &mut own);
            back.run(messages(*shape, block, values, &self.alpha), (&self.node, d_node), own);
            if let Some(u) = u {
                let by_own = View::new(own, block.len(), NODE);
                by_matrix(by_own, block.view(edge), gradients.matrix_mut(&format!("{name}.u_e.weight")));
                by_input(by_own, u, block.view_mut(by_edge), Into::Add);
            }
        }
        back
    }
}

/// U, if the option `edge_in_message` is set.
fn edge_matrix<'w>(weights: &'w Tensors, shape: AttentionShape, name: &str) -> Option<View<'w>> {
    shape.edge_in_message.then(|| weights.matrix(&format!("{name}.u_e.weight")))
}

/// U e of the block's edges, `[block, 64]` in `memory`; zeros without U.
fn own_messages<'m>(
    u: Option<View<'_>>,
    block: Block<'_>,
    edge: &Matrix,
    memory: &'m mut [f32],
) -> &'m mut [f32] {
    let own = &mut memory[..block.len() * NODE];
    match u {
        Some(u) => forward(block.view(edge), u, ViewMut::new(own, block.len(), NODE), Into::Replace),
        None => own.fill(0.0),
    }
    own
}
