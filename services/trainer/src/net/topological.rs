//! Topological attention over ragged graphs, and its way back.
//!
//! A *row* is an agent at one step where it is present; an *edge* joins the row that receives to a row that sends. With
//! λ and μ of its own, every head computes
//!
//! ```text
//! d_ij = ‖v_i − v_j‖²   l_ij = ‖e_ij‖²   α_ij = softmax_j∈N(i) of −(λ d_ij + μ l_ij)
//! m_ij = f_act(W v_j + U e_ij)           v̄_i = Σ_j α_ij m_ij                       [paper, Eq. topological]
//! ```
//!
//! (f(α x) = α f(x) since α ≥ 0.) What is wide and by edge is never kept: blocks of edges that fit the cache pass all of
//! a layer, and the way back computes their messages anew.

use super::matrix::{Into, Matrix, View, ViewMut, by_input, by_matrix, forward};
use super::tensors::{Gradients, Tensors};
use messages::{Messages, MessagesBackward};
use scores::Coefficients;
use update::Update;

mod messages;
mod scores;
#[cfg(test)]
mod tests;
mod update;

/// Node attributes.
const NODE: usize = 64;
/// Edge attributes.
const EDGE: usize = 16;
/// Edges that pass a layer together.
const BLOCK: usize = 256;

/// Which rows are joined.
#[derive(Clone, Debug, Default)]
pub(crate) struct Edges {
    /// Row that receives, per edge, ascending.
    pub(crate) receiver: Vec<u32>,
    /// Row that sends, per edge.
    pub(crate) sender: Vec<u32>,
    /// First edge of every row, and the number of edges.
    pub(crate) first: Vec<u32>,
}

impl Edges {
    pub(crate) fn len(&self) -> usize {
        self.receiver.len()
    }

    fn blocks(&self) -> impl Iterator<Item = Block<'_>> {
        let ends = self.receiver.chunks(BLOCK).zip(self.sender.chunks(BLOCK));
        ends.enumerate().map(|(number, (receiver, sender))| Block { start: number * BLOCK, receiver, sender })
    }
}

/// Some edges in a row.
#[derive(Clone, Copy)]
struct Block<'a> {
    start: usize,
    receiver: &'a [u32],
    sender: &'a [u32],
}

impl Block<'_> {
    const fn len(&self) -> usize {
        self.receiver.len()
    }

    /// Rows that receive and send.
    fn ends(&self) -> impl Iterator<Item = (usize, usize)> {
        self.receiver.iter().zip(self.sender).map(|(receiver, sender)| (*receiver as usize, *sender as usize))
    }

    /// The block's part of a matrix by edge.
    fn of<'m>(&self, matrix: &'m Matrix) -> &'m [f32] {
        &matrix.values[self.start * matrix.cols..][..self.len() * matrix.cols]
    }

    fn of_mut<'m>(&self, matrix: &'m mut Matrix) -> &'m mut [f32] {
        &mut matrix.values[self.start * matrix.cols..][..self.len() * matrix.cols]
    }

    fn view<'m>(&self, matrix: &'m Matrix) -> View<'m> {
        View::new(self.of(matrix), self.len(), matrix.cols)
    }

    fn view_mut<'m>(&self, matrix: &'m mut Matrix) -> ViewMut<'m> {
        let cols = matrix.cols;
        ViewMut::new(self.of_mut(matrix), self.len(), cols)
    }
}

/// What the layer takes from the model's configuration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AttentionShape {
    /// Divides 64.
    pub(crate) heads: usize,
    pub(crate) leaky_slope: f32,
    /// Whether messages have the part U e.
    pub(crate) edge_in_message: bool,
    /// Whether d and l are divided by their dimensions.
    pub(crate) distance_scale: bool,
}

/// One round of topological attention.
#[derive(Debug)]
pub(crate) struct Round {
    /// α `[edges, heads]`.
    pub(crate) alpha: Matrix,
    /// New node attributes v̄ `[rows, 64]`; zeros where a row receives nothing.
    pub(crate) node: Matrix,
    /// New edge attributes `[edges, 16]`; `None` after the last round.
    pub(crate) edge: Option<Matrix>,
    trace: Trace,
}

/// What the way back needs besides.
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

/// A round on `node` `[rows, 64]` and `edge` `[edges, 16]`, with the edge update unless it is the `last`.
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
        let (values, alpha) = (&values, block.of(&alpha));
        Messages { shape, block, values, own, alpha }.sum(&mut attended);
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
    /// Gradients by the node and edge attributes that the round was given, from those by its new ones.
    pub(crate) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        edges: &Edges,
        mut d_node: Matrix,
        d_edge: Option<Matrix>,
    ) -> (Matrix, Matrix) {
        let Trace { name, shape, node, edge, values, squares, update } = &self.trace;
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

        let u = edge_matrix(weights, *shape, name);
        let coefficients = Coefficients::read(weights, *shape, name);
        let mut back = MessagesBackward::new(*shape, &coefficients, node, &self.node, &d_node);
        let mut own = vec![0.0; BLOCK * NODE];
        for block in edges.blocks() {
            let own = own_messages(u, block, edge, &mut own);
            back.run(block, (values, edge), (block.of(&self.alpha), block.of(squares)), own, &mut by_edge);
            if let Some(u) = u {
                let d_message = View::new(own, block.len(), NODE);
                by_matrix(d_message, block.view(edge), gradients.matrix_mut(&format!("{name}.u_e.weight")));
                by_input(d_message, u, block.view_mut(&mut by_edge), Into::Add);
            }
        }
        let MessagesBackward { mut by_node, by_values, by_coefficients, .. } = back;
        coefficients.backward(weights, gradients, name, &by_coefficients);
        let matrix = format!("{name}.w_n.weight");
        by_matrix(by_values.view(), node.view(), gradients.matrix_mut(&matrix));
        by_input(by_values.view(), weights.matrix(&matrix), by_node.view_mut(), Into::Add);
        (by_node, by_edge)
    }
}

/// U of the option `edge_in_message`.
fn edge_matrix<'w>(weights: &'w Tensors, shape: AttentionShape, name: &str) -> Option<View<'w>> {
    shape.edge_in_message.then(|| weights.matrix(&format!("{name}.u_e.weight")))
}

/// U e of the block's edges, zeros without U, `[block, 64]` in `memory`.
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

/// Sum in pairs, so that it vectorises.
#[inline(always)]
fn sum(values: &[f32]) -> f32 {
    let mut sums = [0.0_f32; 8];
    for part in values.chunks(8) {
        sums.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
    }
    let [a, b, c, d, e, f, g, h] = sums;
    ((a + e) + (c + g)) + ((b + f) + (d + h))
}
