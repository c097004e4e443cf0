use wire::{EDGE_ATTRIBUTES, Edge, NODE_ATTRIBUTES};

/// A scene graph over several steps.
#[derive(Clone, Copy, Debug)]
pub struct Graph<'a> {
    /// Agents, the same at all steps.
    pub agents_len: usize,
    /// Whether an agent has a state at a step, \[step, agent\].
    pub present: &'a [bool],
    /// Node attributes v, \[step, agent\]; rows of absent agents are ignored.
    pub nodes: &'a [[f32; NODE_ATTRIBUTES]],
    /// Edges between present agents, including each one's self edge, sorted by (step, receiver, sender).
    pub edges: &'a [Edge],
    /// Edge attributes e, in the order of `edges`.
    pub attributes: &'a [[f32; EDGE_ATTRIBUTES]],
}

impl Graph<'_> {
    pub(super) fn assert_fits(&self) {
        assert_eq!(self.present.len(), self.nodes.len(), "presence of each node");
        assert_eq!(self.edges.len(), self.attributes.len(), "attributes of each edge");
        assert!(self.agents_len > 0 || self.nodes.is_empty(), "agents of the nodes");
        assert!(self.agents_len == 0 || self.nodes.len().is_multiple_of(self.agents_len), "whole steps");
        let known = |agent: u16| usize::from(agent) < self.agents_len;
        let fits = |e: &Edge| {
            known(e.receiver) && known(e.sender) && self.row(e.step, e.receiver) < self.nodes.len()
        };
        assert!(self.edges.iter().all(fits), "ends of each edge");
    }

    /// A node's row.
    pub(super) fn row(&self, step: u16, agent: u16) -> usize {
        usize::from(step) * self.agents_len + usize::from(agent)
    }

    /// The rows of an edge's receiver and sender.
    pub(super) fn ends(&self, edge: &Edge) -> [usize; 2] {
        [self.row(edge.step, edge.receiver), self.row(edge.step, edge.sender)]
    }
}

/// f_act: LeakyReLU.
#[inline]
pub(super) fn leaky(slope: f32, x: f32) -> f32 {
    if x > 0.0 { x } else { slope * x }
}
