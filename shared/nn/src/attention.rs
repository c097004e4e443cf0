//! Graph dual attention: over an agent's neighbours at a step (topological), and then over its steps
//! (temporal).
//!
//! The graph is sparse. Its edges are sorted by (step, receiver, sender). The edges that an agent receives at
//! a step are therefore adjacent in memory, and softmax and sums run along the list. Nodes are rows \[step,
//! agent\].

mod graph;
mod reach;
mod temporal;
mod topological;

use wire::{AGENTS_MAX, EDGE_ATTRIBUTES, Edge, NODE_ATTRIBUTES, TEMPORAL};

use crate::buffer::Buffer;
use crate::weights::{Weights, WeightsError};
pub use graph::Graph;
pub use reach::{AgentSet, with_senders};
use temporal::{TemporalAttention, TemporalMemory};
use topological::{Round, RoundMemory};

/// Intermediate results of a round of topological attention.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RoundTrace {
    /// Attention α, \[edge, head\].
    pub alpha: Vec<f32>,
    /// Node attributes v̄, \[step, agent\]; zero rows for absent agents.
    pub nodes: Vec<[f32; NODE_ATTRIBUTES]>,
    /// Edge attributes after the round's update, in the order of the edges; empty after the last round.
    pub attributes: Vec<[f32; EDGE_ATTRIBUTES]>,
}

/// Every intermediate tensor of a graph's attention, for comparison with a reference.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GraphTrace {
    /// The rounds of topological attention.
    pub rounds: Vec<RoundTrace>,
    /// Temporal attention β, \[step, agent, head\]; zeros for absent agents.
    pub beta: Vec<f32>,
    /// Number of heads in `beta`.
    pub temporal_heads: usize,
}

/// The graph dual attention network.
pub struct Gdat {
    rounds: Vec<Round>,
    temporal: TemporalAttention,
}

/// Scratch memory of [`Gdat`].
#[derive(Default)]
pub struct GdatMemory {
    nodes: [Buffer; 2],
    attributes: Vec<[f32; EDGE_ATTRIBUTES]>,
    /// The edges in use, if not all are.
    edges: Vec<Edge>,
    round: RoundMemory,
    temporal: TemporalMemory,
}

/// Maximum number of rounds of a model before the last one.
const ROUNDS_MAX: usize = 3;

impl Gdat {
    /// The layers `gdat.*`.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn new(weights: &Weights) -> Result<Self, WeightsError> {
        let rounds = weights.config().rounds;
        let rounds =
            (0..rounds).map(|r| Round::read(weights, r, r + 1 == rounds)).collect::<Result<_, _>>()?;
        Ok(Self { rounds, temporal: TemporalAttention::read(weights)? })
    }

    /// Temporal summaries ṽ of all agents, one row per agent; zeros for agents that are present at no step.
    ///
    /// # Panics
    /// If the sizes of the graph's parts do not match, or `out` does not have one row per agent.
    pub fn summarise(&self, graph: &Graph<'_>, memory: &mut GdatMemory, out: &mut [[f32; TEMPORAL]]) {
        self.run(graph, memory, out, None);
    }

    /// As [`Gdat::summarise`], and writes every intermediate tensor to `trace`.
    ///
    /// # Panics
    /// As [`Gdat::summarise`].
    pub fn summarise_traced(
        &self,
        graph: &Graph<'_>,
        memory: &mut GdatMemory,
        out: &mut [[f32; TEMPORAL]],
        trace: &mut GraphTrace,
    ) {
        *trace = GraphTrace::default();
        self.run(graph, memory, out, Some(trace));
    }

    fn run(
        &self,
        graph: &Graph<'_>,
        memory: &mut GdatMemory,
        out: &mut [[f32; TEMPORAL]],
        mut trace: Option<&mut GraphTrace>,
    ) {
        assert_eq!(out.len(), graph.agents_len, "a row per agent");
        let len = graph.nodes.len() * NODE_ATTRIBUTES;
        self.attend_traced(graph, memory, trace.as_deref_mut());
        let GdatMemory { nodes: [nodes, _], temporal, .. } = memory;
        self.temporal.attend(graph.agents_len, graph.present, &nodes[..len], temporal, out);
        if let Some(trace) = trace {
            trace.temporal_heads = self.temporal.heads();
            trace.beta = temporal.beta().to_vec();
        }
    }

    /// Node attributes v̄ of a graph after all rounds of topological attention, \[step, agent\]; zero rows
    /// for absent agents.
    ///
    /// A round works within one step. The steps of a scene may therefore be processed one by one, in any
    /// order, and joined by [`Gdat::summarise_attended`].
    ///
    /// # Panics
    /// If the sizes of the graph's parts do not match.
    pub fn attend<'a>(&self, graph: &Graph<'_>, memory: &'a mut GdatMemory) -> &'a [[f32; NODE_ATTRIBUTES]] {
        self.attend_traced(graph, memory, None);
        memory.nodes[0][..graph.nodes.len() * NODE_ATTRIBUTES].as_chunks().0
    }

    /// As [`Gdat::attend`] for a graph of one step, for some agents' nodes only. Their values are identical
    /// to the bit, and all others are undefined. Values that no wanted node depends on are not computed.
    ///
    /// # Panics
    /// If the sizes of the graph's parts do not match, or if the graph has several steps or more than
    /// [`AGENTS_MAX`] agents.
    pub fn attend_wanted<'a>(
        &self,
        graph: &Graph<'_>,
        wanted: &AgentSet,
        memory: &'a mut GdatMemory,
    ) -> &'a [[f32; NODE_ATTRIBUTES]] {
        graph.assert_fits();
        assert!(graph.nodes.len() == graph.agents_len && graph.agents_len <= AGENTS_MAX, "one step");
        // Receivers needed in each round, the last round first.
        let mut receivers = [*wanted; ROUNDS_MAX];
        for round in 1..self.rounds.len() {
            receivers[round] = with_senders(&receivers[round - 1], graph.edges);
        }
        let mut edges = std::mem::take(&mut memory.edges);
        edges.clear();
        edges.extend_from_slice(graph.edges);
        let len = memory.load(graph);
        for (place, round) in self.rounds.iter().enumerate() {
            let GdatMemory { nodes: [from, to], attributes, round: scratch, .. } = memory;
            let left = self.rounds.len() - 1 - place;
            keep_received(&receivers[left], &mut edges, attributes);
            round.attend(
                &Graph { edges: &edges, ..*graph },
                &from[..len],
                attributes,
                scratch,
                &mut to[..len],
            );
            if left > 0 {
                keep_received(&receivers[left - 1], &mut edges, attributes);
                round.update_edges(&Graph { edges: &edges, ..*graph }, &to[..len], attributes, scratch);
            }
            std::mem::swap(from, to);
        }
        memory.edges = edges;
        memory.nodes[0][..len].as_chunks().0
    }

    /// Temporal summaries ṽ of all agents, from the node attributes of [`Gdat::attend`], \[step, agent\].
    ///
    /// # Panics
    /// If the lengths of `nodes` and `present` differ, or if `out` is empty but `nodes` is not.
    pub fn summarise_attended(
        &self,
        present: &[bool],
        nodes: &[[f32; NODE_ATTRIBUTES]],
        memory: &mut GdatMemory,
        out: &mut [[f32; TEMPORAL]],
    ) {
        assert_eq!(present.len(), nodes.len(), "presence of each node");
        self.temporal.attend(out.len(), present, nodes.as_flattened(), &mut memory.temporal, out);
    }

    /// Computes all rounds; v̄ is left in the first of the memory's node buffers.
    fn attend_traced(&self, graph: &Graph<'_>, memory: &mut GdatMemory, mut trace: Option<&mut GraphTrace>) {
        graph.assert_fits();
        let len = memory.load(graph);
        let GdatMemory { nodes: [from, to], attributes, round: scratch, .. } = memory;
        for round in &self.rounds {
            round.attend(graph, &from[..len], attributes, scratch, &mut to[..len]);
            round.update_edges(graph, &to[..len], attributes, scratch);
            if let Some(trace) = &mut trace {
                trace.rounds.push(RoundTrace {
                    alpha: scratch.alpha().to_vec(),
                    nodes: to[..len].as_chunks().0.to_vec(),
                    attributes: if round.is_last() { Vec::new() } else { attributes.clone() },
                });
            }
            std::mem::swap(from, to);
        }
    }

    /// Reserves memory for graphs of this many nodes and edges, so that [`Gdat::attend`] does not allocate.
    pub fn make_room(&self, node_count: usize, edges_len: usize, memory: &mut GdatMemory) {
        let GdatMemory { nodes, attributes, edges, round: scratch, .. } = memory;
        edges.reserve(edges_len.saturating_sub(edges.len()));
        nodes.iter_mut().for_each(|nodes| nodes.reserve(node_count * NODE_ATTRIBUTES));
        attributes.reserve(edges_len.saturating_sub(attributes.len()));
        self.rounds.iter().for_each(|round| round.make_room(node_count, edges_len, scratch));
    }
}

impl GdatMemory {
    /// Copies a graph's nodes and edge attributes; returns the number of nodes.
    fn load(&mut self, graph: &Graph<'_>) -> usize {
        let Self { nodes: [from, to], attributes, .. } = self;
        let len = graph.nodes.len() * NODE_ATTRIBUTES;
        from.reserve(len);
        to.reserve(len);
        from[..len].copy_from_slice(graph.nodes.as_flattened());
        attributes.clear();
        attributes.extend_from_slice(graph.attributes);
        len
    }
}

/// Drops the edges with another receiver than `receivers`, and their attributes.
fn keep_received(receivers: &AgentSet, edges: &mut Vec<Edge>, attributes: &mut Vec<[f32; EDGE_ATTRIBUTES]>) {
    let mut kept = 0;
    for i in 0..edges.len() {
        if receivers[usize::from(edges[i].receiver)] {
            (edges[kept], attributes[kept]) = (edges[i], attributes[i]);
            kept += 1;
        }
    }
    edges.truncate(kept);
    attributes.truncate(kept);
}
