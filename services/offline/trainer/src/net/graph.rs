//! The graph network: from the features of a batch to the encoding of every agent, forward and backward.
//! \[model §3\]
//!
//! **In:** the rows, edges, relation features and map patches of [`Graph`](crate::batch::Graph). **Out:** ṽ
//! `[agents, 64]`, dimensionless; in the backward pass, the gradients of all weights up to ṽ.

use nn::ModelConfig;

use super::context::{self, Embedded, Normalisation};
use super::dense::{PerceptronTrace, perceptron, perceptron_backward};
use super::layout::PERCEPTRON_LAYERS;
use super::matrix::Matrix;
use super::temporal::{self, Reading, Summary};
use super::tensors::{Gradients, Tensors};
use super::topological::{self, AttentionShape, Round};
use crate::batch::Graph;

/// Minimum number of patches for batch statistics.
const NORMALISED_PATCHES_MIN: usize = 16;

/// Output of the graph network for a batch.
pub(crate) struct Encoded {
    /// ṽ `[agents, 64]`.
    pub(crate) encoding: Matrix,
    states: Vec<(usize, PerceptronTrace)>,
    context: Option<Embedded>,
    relation: PerceptronTrace,
    relation_count: usize,
    rounds: Vec<Round>,
    summary: Summary,
}

/// Encodes the graph of a batch.
pub(crate) fn encode(
    weights: &Tensors,
    config: &ModelConfig,
    graph: &Graph,
    normalisation: Normalisation,
    keep_trace: bool,
) -> Encoded {
    let (mut node, states) = embed_states(weights, config, graph);
    let context = config.context.then(|| {
        let few = graph.patches.rows < NORMALISED_PATCHES_MIN;
        let normalisation = if few { Normalisation::Running } else { normalisation };
        context::embed(weights, config, &graph.patches.values, normalisation, keep_trace)
    });
    if let Some(context) = &context {
        let width = context.embedding.cols;
        for (row, &patch) in graph.patch_of_row.iter().enumerate() {
            let start = node.cols - width;
            node.row_mut(row)[start..].copy_from_slice(context.embedding.row(patch as usize));
        }
    }
    let (relation, relation_trace) =
        perceptron(weights, "fe.relation", PERCEPTRON_LAYERS, graph.relation.clone());
    let mut edge = relation.gather(&graph.relation_of_edge);
    let mut rounds: Vec<Round> = Vec::with_capacity(config.rounds);
    for number in 0..config.rounds {
        let last = number + 1 == config.rounds;
        let round =
            topological::round(weights, AttentionShape::of(config), number, node, edge, &graph.edges, last);
        node = round.node.clone();
        edge = round.edge.clone().unwrap_or_default();
        rounds.push(round);
    }
    let summary = temporal::temporal(weights, Reading::of(config), &node, &graph.steps, graph.step_count);
    Encoded {
        encoding: summary.encoding.clone(),
        states,
        context,
        relation: relation_trace,
        relation_count: relation.rows,
        rounds,
        summary,
    }
}

/// Prefix of the tensor names of a type's state perceptron.
fn state_perceptron(config: &ModelConfig, of_type: usize) -> String {
    format!("fe.state.{}", config.network_of(wire::AGENT_TYPES[of_type]).name())
}

/// State embeddings in the first columns of the node attributes `[rows, 64]`.
fn embed_states(
    weights: &Tensors,
    config: &ModelConfig,
    graph: &Graph,
) -> (Matrix, Vec<(usize, PerceptronTrace)>) {
    let width = config.state_embedding_len();
    let mut node = Matrix::zeros(graph.state.rows, wire::NODE_ATTRIBUTES);
    let mut traces = Vec::new();
    for (of_type, rows) in graph.type_rows.iter().enumerate().filter(|(_, rows)| !rows.is_empty()) {
        let name = state_perceptron(config, of_type);
        let state = graph.state.rows_of(rows.clone());
        let (embedded, trace) = perceptron(weights, &name, PERCEPTRON_LAYERS, state);
        for (row, embedded) in rows.clone().zip(embedded.values.chunks_exact(width)) {
            node.row_mut(row)[..width].copy_from_slice(embedded);
        }
        traces.push((of_type, trace));
    }
    (node, traces)
}

impl Encoded {
    /// New running values of the batch norms.
    pub(crate) fn statistics(&self) -> &[(String, Vec<f32>)] {
        self.context.as_ref().map_or(&[], |context| &context.statistics)
    }

    /// Adds the gradients of the weights, given the gradient by the encodings.
    pub(crate) fn backward(
        &self,
        weights: &Tensors,
        config: &ModelConfig,
        gradients: &mut Gradients,
        graph: &Graph,
        d_encoding: &Matrix,
    ) {
        let Some(last) = self.rounds.last() else { return };
        let mut d_node = self.summary.backward(weights, gradients, &last.node, &graph.steps, d_encoding);
        let mut d_edge = None;
        for round in self.rounds.iter().rev() {
            let (node, edge) = round.backward(weights, gradients, &graph.edges, d_node, d_edge);
            (d_node, d_edge) = (node, Some(edge));
        }
        if let Some(d_edge) = d_edge {
            let mut d_relation = Matrix::zeros(self.relation_count, d_edge.cols);
            d_relation.scatter_add(&graph.relation_of_edge, &d_edge);
            perceptron_backward(weights, gradients, "fe.relation", &self.relation, d_relation, false);
        }
        let width = config.state_embedding_len();
        for (of_type, trace) in &self.states {
            let rows = graph.type_rows[*of_type].clone();
            let d_state = rows.clone().flat_map(|row| &d_node.row(row)[..width]).copied().collect();
            let d_state = Matrix::new(rows.len(), width, d_state);
            let name = state_perceptron(config, *of_type);
            perceptron_backward(weights, gradients, &name, trace, d_state, false);
        }
        if let Some(context) = &self.context {
            let mut d_embedding = Matrix::zeros(context.embedding.rows, context.embedding.cols);
            for (row, &patch) in graph.patch_of_row.iter().enumerate() {
                let d_row = &d_node.row(row)[width..];
                d_embedding.row_mut(patch as usize).iter_mut().zip(d_row).for_each(|(sum, d)| *sum += d);
            }
            context.backward(weights, gradients, &d_embedding);
        }
    }
}
