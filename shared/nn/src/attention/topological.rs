mod edges;

use wire::{EDGE_ATTRIBUTES, NODE_ATTRIBUTES};

use super::graph::{Graph, leaky};
use crate::buffer::Buffer;
use crate::kernels::{dispatch, exp_in_place};
use crate::linear::{Activation, Linear};
use crate::weights::{Weights, WeightsError};
use crate::{Attention, ModelConfig};
use edges::{Gather, Score, Sum, SumWithEdges, UPDATE_HIDDEN};

/// Edges that are processed together.
const BLOCK: usize = 48;

/// A round r of topological attention, followed by the edge update.
///
/// ```text
/// α_ij = softmax_j∈N(i) of −(λ_h ‖v_i − v_j‖² + μ_h ‖e_ij‖²)
/// v̄_i  = Σ_j α_ij f_act(W v_j + U e_ij)          (α ≥ 0: f_act(α x) = α f_act(x))
/// e'_ij = MLP([v̄_i ‖ v̄_j ‖ e_ij])                                                   [model §3]
/// ```
///
/// In equal attention λ = μ = 0.
pub(super) struct Round {
    values: Linear,
    /// U of the option `edge_in_message`.
    edge_values: Option<Linear>,
    /// \[λ_h, μ_h\] of each head h. With the option `distance_scale`, λ_h is divided by the dimension of v
    /// and μ_h by the dimension of e.
    factors: Vec<[f32; 2]>,
    update: Option<EdgeUpdate>,
    slope: f32,
}

/// The MLP of the edge update. Its first matrix is split into the parts of receiver, sender and edge: the
/// parts that depend on a node are computed once per node.
struct EdgeUpdate {
    receiver: Linear,
    sender: Linear,
    edge: Linear,
    out: Linear,
}

#[derive(Default)]
pub(super) struct RoundMemory {
    /// \[edge, head\].
    alpha: Buffer,
    alpha_len: usize,
    /// W v, activated unless the message carries the edge, \[node, 64\].
    values: Buffer,
    /// The node parts of the edge update, \[node, 128\].
    receivers: Buffer,
    senders: Buffer,
    /// A block of edges.
    wide: Buffer,
    hidden: Buffer,
}

impl RoundMemory {
    /// Attention of the last round, \[edge, head\].
    pub(super) fn alpha(&self) -> &[f32] {
        &self.alpha[..self.alpha_len]
    }
}

/// ln(1 + e^x) without overflow.
fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

impl Round {
    pub(super) fn read(weights: &Weights, round: usize, last: bool) -> Result<Self, WeightsError> {
        let config = weights.config();
        let name = |part: &str| format!("gdat.topological.{round}.{part}");
        let edge_values = config
            .edge_in_message
            .then(|| Linear::read_unbiased(weights, &name("u_e"), NODE_ATTRIBUTES, EDGE_ATTRIBUTES))
            .transpose()?;
        Ok(Self {
            values: Linear::read_unbiased(weights, &name("w_n"), NODE_ATTRIBUTES, NODE_ATTRIBUTES)?,
            edge_values,
            factors: factors(weights, config, &name(""))?,
            update: (!last).then(|| EdgeUpdate::read(weights, &name("edge"))).transpose()?,
            slope: config.leaky_slope,
        })
    }

    pub(super) const fn is_last(&self) -> bool {
        self.update.is_none()
    }

    /// Reserves memory for graphs of this many nodes and edges.
    pub(super) fn make_room(&self, node_count: usize, edges_len: usize, memory: &mut RoundMemory) {
        let RoundMemory { alpha, values, receivers, senders, wide, hidden, .. } = memory;
        alpha.reserve(edges_len * self.factors.len());
        values.reserve(node_count * NODE_ATTRIBUTES);
        receivers.reserve(node_count * UPDATE_HIDDEN);
        senders.reserve(node_count * UPDATE_HIDDEN);
        wide.reserve(BLOCK * UPDATE_HIDDEN);
        hidden.reserve(BLOCK * UPDATE_HIDDEN);
    }

    /// Computes v̄ of all nodes into `out`; rows of absent agents are 0.
    pub(super) fn attend(
        &self,
        graph: &Graph<'_>,
        nodes: &[f32],
        attributes: &[[f32; EDGE_ATTRIBUTES]],
        memory: &mut RoundMemory,
        out: &mut [f32],
    ) {
        self.weigh(graph, nodes, attributes, memory);
        memory.values.reserve(nodes.len());
        self.values.run(nodes, NODE_ATTRIBUTES, Activation::None, &mut memory.values[..nodes.len()]);
        out.fill(0.0);
        let heads = self.factors.len();
        if let Some(edge_values) = &self.edge_values {
            self.sum_with_edges(edge_values, graph, attributes, memory, out);
            return;
        }
        let values = &mut memory.values[..nodes.len()];
        values.iter_mut().for_each(|x| *x = leaky(self.slope, *x));
        let alpha = &memory.alpha[..memory.alpha_len];
        dispatch(Sum { graph, edges: graph.edges, alpha, heads, values, out });
    }

    /// α of all edges, \[edge, head\].
    fn weigh(
        &self,
        graph: &Graph<'_>,
        nodes: &[f32],
        attributes: &[[f32; EDGE_ATTRIBUTES]],
        memory: &mut RoundMemory,
    ) {
        let heads = self.factors.len();
        memory.alpha_len = graph.edges.len() * heads;
        memory.alpha.reserve(memory.alpha_len);
        let alpha = &mut memory.alpha[..memory.alpha_len];
        dispatch(Score { graph, nodes, attributes, factors: &self.factors, scores: &mut *alpha });
        let mut start = 0;
        for received in graph.edges.chunk_by(|a, b| (a.step, a.receiver) == (b.step, b.receiver)) {
            let end = start + received.len() * heads;
            softmax_columns(&mut alpha[start..end], heads);
            start = end;
        }
    }

    /// v̄ if the messages contain the edges: activated per edge, in blocks.
    fn sum_with_edges(
        &self,
        edge_values: &Linear,
        graph: &Graph<'_>,
        attributes: &[[f32; EDGE_ATTRIBUTES]],
        memory: &mut RoundMemory,
        out: &mut [f32],
    ) {
        let heads = self.factors.len();
        memory.wide.reserve(BLOCK * NODE_ATTRIBUTES);
        let blocks = graph.edges.chunks(BLOCK).zip(attributes.chunks(BLOCK));
        for ((edges, attributes), alpha) in blocks.zip(memory.alpha.chunks(BLOCK * heads)) {
            let messages = &mut memory.wide[..edges.len() * NODE_ATTRIBUTES];
            edge_values.run(attributes.as_flattened(), EDGE_ATTRIBUTES, Activation::None, messages);
            let (values, slope) = (&memory.values[..], self.slope);
            dispatch(SumWithEdges { graph, edges, alpha, heads, values, slope, messages, out: &mut *out });
        }
    }

    /// Replaces the edge attributes by the updated ones; does nothing after the last round.
    pub(super) fn update_edges(
        &self,
        graph: &Graph<'_>,
        nodes: &[f32],
        attributes: &mut [[f32; EDGE_ATTRIBUTES]],
        memory: &mut RoundMemory,
    ) {
        let Some(update) = &self.update else { return };
        let len = nodes.len() / NODE_ATTRIBUTES * UPDATE_HIDDEN;
        let RoundMemory { receivers, senders, wide, hidden, .. } = memory;
        receivers.reserve(len);
        senders.reserve(len);
        wide.reserve(BLOCK * UPDATE_HIDDEN);
        hidden.reserve(BLOCK * UPDATE_HIDDEN);
        update.receiver.run(nodes, NODE_ATTRIBUTES, Activation::None, &mut receivers[..len]);
        update.sender.run(nodes, NODE_ATTRIBUTES, Activation::None, &mut senders[..len]);
        for (edges, attributes) in graph.edges.chunks(BLOCK).zip(attributes.chunks_mut(BLOCK)) {
            let len = edges.len() * UPDATE_HIDDEN;
            dispatch(Gather { graph, edges, receivers, senders, sums: &mut wide[..len] });
            let from = attributes.as_flattened();
            update.edge.run_onto(from, EDGE_ATTRIBUTES, &wide[..len], Activation::Relu, &mut hidden[..len]);
            update.out.run(&hidden[..len], UPDATE_HIDDEN, Activation::None, attributes.as_flattened_mut());
        }
    }
}

/// λ_h and μ_h of the round whose tensor names start with `prefix`.
fn factors(weights: &Weights, config: &ModelConfig, prefix: &str) -> Result<Vec<[f32; 2]>, WeightsError> {
    let heads = config.topological_heads;
    if config.attention == Attention::Equal {
        return Ok(vec![[0.0; 2]; heads]);
    }
    let lambda = weights.tensor(&format!("{prefix}lambda_raw"), &[heads])?;
    let mu = weights.tensor(&format!("{prefix}mu_raw"), &[heads])?;
    let [of_node, of_edge] = if config.distance_scale {
        [NODE_ATTRIBUTES, EDGE_ATTRIBUTES].map(|dimension| 1.0 / dimension as f32)
    } else {
        [1.0; 2]
    };
    let both = lambda.iter().zip(mu);
    Ok(both.map(|(lambda, mu)| [softplus(*lambda) * of_node, softplus(*mu) * of_edge]).collect())
}

impl EdgeUpdate {
    fn read(weights: &Weights, name: &str) -> Result<Self, WeightsError> {
        let in_len = 2 * NODE_ATTRIBUTES + EDGE_ATTRIBUTES;
        let shape = [UPDATE_HIDDEN, in_len];
        let matrix = weights.tensor(&format!("{name}.0.weight"), &shape)?;
        let bias = weights.tensor(&format!("{name}.0.bias"), &[UPDATE_HIDDEN])?;
        Ok(Self {
            receiver: Linear::pack(matrix, Some(bias), shape, 0..NODE_ATTRIBUTES),
            sender: Linear::pack(matrix, None, shape, NODE_ATTRIBUTES..2 * NODE_ATTRIBUTES),
            edge: Linear::pack(matrix, None, shape, 2 * NODE_ATTRIBUTES..in_len),
            out: Linear::read(weights, &format!("{name}.1"), EDGE_ATTRIBUTES, UPDATE_HIDDEN)?,
        })
    }
}

/// Softmax down each column of \[row, column\].
fn softmax_columns(scores: &mut [f32], columns: usize) {
    for column in 0..columns {
        let most = scores[column..].iter().step_by(columns).fold(f32::NEG_INFINITY, |most, &x| most.max(x));
        scores[column..].iter_mut().step_by(columns).for_each(|x| *x -= most);
    }
    exp_in_place(scores);
    for column in 0..columns {
        let sum: f32 = scores[column..].iter().step_by(columns).sum();
        let share = 1.0 / sum;
        scores[column..].iter_mut().step_by(columns).for_each(|x| *x *= share);
    }
}
