//! Topological and temporal attention over ragged graphs.
//!
//! A *row* is an agent at one step where it is present. Every row has a fixed number of *slots*, one per possible
//! neighbour; the edge in a slot is an index into the edge list, or the index past its end where the slot is empty.

use burn::tensor::{Bool, Int, Tensor, activation};

use super::layers::perceptron;
use crate::parameters::Weights;

/// Which rows are joined.
#[derive(Clone, Debug)]
pub struct Edges {
    /// Row that receives, per edge.
    pub receiver: Tensor<1, Int>,
    /// Row that sends, per edge.
    pub sender: Tensor<1, Int>,
    /// Edge of every slot, `[rows × slots]`; the number of edges where the slot is empty.
    pub slots: Tensor<1, Int>,
    /// Whether a slot is empty, `[rows, slots]`.
    pub empty: Tensor<2, Bool>,
}

/// One round of topological attention.
#[derive(Clone, Debug)]
pub struct Round {
    /// Weights `[rows, slots, heads]`; zero in empty slots.
    pub alpha: Tensor<3>,
    /// New node attributes `[rows, 64]`.
    pub node: Tensor<2>,
    /// New edge attributes `[edges, 16]`; `None` after the last round.
    pub edge: Option<Tensor<2>>,
}

/// What the attention layers take from the model's configuration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AttentionShape {
    pub(crate) heads: usize,
    pub(crate) leaky_slope: f64,
    pub(crate) edge_in_message: bool,
    pub(crate) distance_scale: bool,
}

/// Score of an empty slot: its softmax weight is exactly zero.
const NO_EDGE: f32 = -1e30;

/// One round of [paper, Eq. topological] with heads of their own λ and μ, and the edge update where `last` is false.
pub(crate) fn topological(
    weights: &Weights,
    shape: AttentionShape,
    round: usize,
    (node, edge): (Tensor<2>, Tensor<2>),
    edges: &Edges,
    last: bool,
) -> Round {
    let name = format!("gdat.topological.{round}");
    let [rows_len, width] = node.dims();
    let [_, slots_len] = edges.empty.dims();
    let [_, edge_width] = edge.dims();
    let per_dimension = |len: usize| if shape.distance_scale { 1.0 / len as f64 } else { 1.0 };

    let difference =
        node.clone().select(0, edges.receiver.clone()) - node.clone().select(0, edges.sender.clone());
    let distance = difference.square().sum_dim(1) * per_dimension(width);
    let length = edge.clone().square().sum_dim(1) * per_dimension(edge_width);
    let coefficient =
        |raw: &str| activation::softplus(weights.get::<1>(&format!("{name}.{raw}")), 1.0).unsqueeze();
    let score: Tensor<2> = -(distance * coefficient("lambda_raw") + length * coefficient("mu_raw"));
    let score = by_slot(score, edges).reshape([rows_len, slots_len, shape.heads]);
    let empty = edges.empty.clone().unsqueeze_dim::<3>(2).expand([rows_len, slots_len, shape.heads]);
    let alpha = activation::softmax(score.mask_fill(empty, NO_EDGE), 1);

    // Since α ≥ 0, f(α W v) = α f(W v): every message is activated once, whoever receives it.
    let values = node.matmul(weights.get::<2>(&format!("{name}.w_n.weight")).transpose());
    let mut message = values.select(0, edges.sender.clone());
    if shape.edge_in_message {
        message = message + edge.clone().matmul(weights.get::<2>(&format!("{name}.u_e.weight")).transpose());
    }
    let message = by_slot(activation::leaky_relu(message, shape.leaky_slope), edges);
    let message = message.reshape([rows_len, slots_len, shape.heads, width / shape.heads]);
    let node = (message * alpha.clone().unsqueeze_dim::<4>(3)).sum_dim(1).reshape([rows_len, width]);
    let edge = (!last).then(|| update_edge(weights, &name, &node, &edge, edges));
    Round { alpha, node, edge }
}

/// `MLP([v̄_i ‖ v̄_j ‖ e_ij])` for every edge; the node parts of the first matrix are multiplied once per node.
fn update_edge(
    weights: &Weights,
    name: &str,
    node: &Tensor<2>,
    edge: &Tensor<2>,
    edges: &Edges,
) -> Tensor<2> {
    let width = node.dims()[1];
    let first = weights.get::<2>(&format!("{name}.edge.0.weight")).transpose();
    let bias = weights.get::<1>(&format!("{name}.edge.0.bias")).unsqueeze();
    let part = |start: usize, len: usize| first.clone().narrow(0, start, len);
    let receiver = node.clone().matmul(part(0, width)).select(0, edges.receiver.clone());
    let sender = node.clone().matmul(part(width, width)).select(0, edges.sender.clone());
    let own = edge.clone().matmul(part(2 * width, edge.dims()[1]));
    let hidden = activation::relu(receiver + sender + own + bias);
    super::layers::dense(weights, &format!("{name}.edge.1"), hidden)
}

/// Values of the edges laid out by slot `[rows × slots, width]`, zeros in empty slots.
fn by_slot(values: Tensor<2>, edges: &Edges) -> Tensor<2> {
    with_zero_row(values).select(0, edges.slots.clone())
}

/// Appends a row of zeros, which index `rows` then selects.
pub(crate) fn with_zero_row(values: Tensor<2>) -> Tensor<2> {
    let zeros = Tensor::zeros([1, values.dims()[1]], &values.device());
    Tensor::cat(vec![values, zeros], 0)
}

/// Temporal attention of [paper, Eq. temporal].
#[derive(Clone, Debug)]
pub struct Summary {
    /// Weights `[agents, steps, heads]`; zero where the agent is absent.
    pub beta: Tensor<3>,
    /// ṽ `[agents, 64]`; zeros for an agent without a present step.
    pub encoding: Tensor<2>,
}

/// Sums `node` `[agents, steps, 64]` over the steps that are not `absent` `[agents, steps]`.
pub(crate) fn temporal(
    weights: &Weights,
    leaky_slope: f64,
    node: Tensor<3>,
    absent: Tensor<2, Bool>,
) -> Summary {
    let [agents_len, steps_len, width] = node.dims();
    let flat = node.reshape([agents_len * steps_len, width]);
    let score_weight = weights.get::<2>("gdat.temporal.score.weight");
    let heads = score_weight.dims()[0];
    let score = flat.clone().matmul(score_weight.transpose());
    let literal = heads == width;
    let value = if literal {
        score.clone()
    } else {
        flat.matmul(weights.get::<2>("gdat.temporal.value.weight").transpose())
    };
    let absent = absent.unsqueeze_dim::<3>(2).expand([agents_len, steps_len, heads]);
    let score = activation::leaky_relu(score, leaky_slope).reshape([agents_len, steps_len, heads]);
    let beta = activation::softmax(score.mask_fill(absent.clone(), NO_EDGE), 1).mask_fill(absent, 0.0);
    let value =
        activation::leaky_relu(value, leaky_slope).reshape([agents_len, steps_len, heads, width / heads]);
    let encoding = (value * beta.clone().unsqueeze_dim::<4>(3)).sum_dim(1).reshape([agents_len, width]);
    Summary { beta, encoding }
}

/// Mean of the posterior latent of [ṽ_h ‖ ṽ_f], `[agents, 32]`.
pub(crate) fn posterior(weights: &Weights, history: Tensor<2>, future: Tensor<2>) -> Tensor<2> {
    perceptron(weights, "encoder", 3, Tensor::cat(vec![history, future], 1))
}
