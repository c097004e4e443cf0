//! The network, differentiable: the same tensors as the onboard one, under the same names.
//!
//! A batch is ragged. Agents of many scenes stand in one list, sorted by type; a *row* is an agent at one step where it
//! is present, rows are sorted by (agent, step), so that the rows of each type are contiguous. Edges join rows of the
//! same scene and step.

mod attention;
mod decoder;
mod layers;
mod layout;
#[cfg(test)]
mod parity;

use std::ops::Range;

use burn::tensor::{Bool, Int, Tensor};
use nn::{ModelConfig, Stem};

pub use attention::{Edges, Round, Summary};
pub use decoder::Controls;
pub(crate) use decoder::{Decoder, repeat};
pub use layers::Normalisation;
pub(crate) use layers::Statistics;
pub use layout::{Entry, TYPE_NAMES, initial, layout};
pub(crate) use layout::{LATENT, units};

use crate::parameters::Weights;
use attention::{AttentionShape, with_zero_row};
use layers::{ContextNetwork, PERCEPTRON_LAYERS, perceptron};

/// What the graph network sees of a batch.
#[derive(Clone, Debug)]
pub struct Graph {
    /// State features `[rows, 6]`.
    pub state: Tensor<2>,
    /// Rows of each type.
    pub type_rows: [Range<usize>; 3],
    /// Relation features `[edges, 6]`.
    pub relation: Tensor<2>,
    /// Which rows are joined.
    pub edges: Edges,
    /// Row of every agent and step `[agents × steps]`; the number of rows where the agent is absent.
    pub steps: Tensor<1, Int>,
    /// Whether the agent is absent, `[agents, steps]`.
    pub absent: Tensor<2, Bool>,
    /// What the rows see of the map.
    pub context: Context,
}

/// Map patches of a batch.
#[derive(Clone, Debug)]
pub struct Context {
    /// Each patch once, `[patches, 3, P, P]`.
    pub patches: Tensor<4>,
    /// Patch of every row, `[rows]`.
    pub of_row: Tensor<1, Int>,
    /// Where the batch norms take their statistics from.
    pub normalisation: Normalisation,
}

/// Everything that the graph network computed, for the decoder and for comparison with other implementations.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// Node attributes before the first round `[rows, 64]`.
    pub node: Tensor<2>,
    /// Edge attributes before the first round `[edges, 16]`.
    pub edge: Tensor<2>,
    /// The rounds of topological attention.
    pub rounds: Vec<Round>,
    /// Temporal attention: ṽ of every agent.
    pub summary: Summary,
}

/// Encodes the graph of a batch. New running values of the batch norms are appended to `statistics`.
pub(crate) fn encode(
    weights: &Weights,
    config: &ModelConfig,
    graph: &Graph,
    statistics: &mut Statistics,
) -> Encoded {
    let node = nodes(weights, config, graph, statistics);
    attend(weights, config, graph, node)
}

/// Node attributes before the first round `[rows, 64]`: state and context embedding.
fn nodes(weights: &Weights, config: &ModelConfig, graph: &Graph, statistics: &mut Statistics) -> Tensor<2> {
    let types = TYPE_NAMES.iter().zip(&graph.type_rows).filter(|(_, rows)| !rows.is_empty());
    let states = types.map(|(name, rows)| {
        let state = graph.state.clone().slice([rows.clone()]);
        perceptron(weights, &format!("fe.state.{name}"), PERCEPTRON_LAYERS, state)
    });
    let state = Tensor::cat(states.collect(), 0);
    if !config.context {
        return state;
    }
    let mut network = ContextNetwork {
        weights,
        imagenet_stem: config.stem == Stem::Imagenet,
        normalisation: graph.context.normalisation,
        statistics: Statistics::new(),
    };
    let patches = network.forward(graph.context.patches.clone());
    statistics.append(&mut network.statistics);
    Tensor::cat(vec![state, patches.select(0, graph.context.of_row.clone())], 1)
}

/// Edge attributes, topological and temporal attention.
fn attend(weights: &Weights, config: &ModelConfig, graph: &Graph, node: Tensor<2>) -> Encoded {
    let edge = perceptron(weights, "fe.relation", PERCEPTRON_LAYERS, graph.relation.clone());
    let shape = AttentionShape {
        heads: config.topological_heads,
        leaky_slope: f64::from(config.leaky_slope),
        edge_in_message: config.edge_in_message,
        distance_scale: config.distance_scale,
    };
    let mut rounds: Vec<Round> = Vec::with_capacity(config.rounds);
    let (mut last_node, mut last_edge) = (node.clone(), edge.clone());
    for round in 0..config.rounds {
        let last = round + 1 == config.rounds;
        let done =
            attention::topological(weights, shape, round, (last_node, last_edge.clone()), &graph.edges, last);
        last_node = done.node.clone();
        last_edge = done.edge.clone().unwrap_or(last_edge);
        rounds.push(done);
    }
    let [agents_len, steps_len] = graph.absent.dims();
    let width = last_node.dims()[1];
    let by_step =
        with_zero_row(last_node).select(0, graph.steps.clone()).reshape([agents_len, steps_len, width]);
    let summary = attention::temporal(weights, shape.leaky_slope, by_step, graph.absent.clone());
    Encoded { node, edge, rounds, summary }
}

/// Mean of the posterior latent `[agents, 32]` of the encodings of history and future.
pub(crate) fn posterior(weights: &Weights, history: &Encoded, future: &Encoded) -> Tensor<2> {
    attention::posterior(weights, history.summary.encoding.clone(), future.summary.encoding.clone())
}
