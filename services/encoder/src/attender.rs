//! The steps of a frame's graph, shared among the workers: attention in a round does not leave its step.

use std::ops::Range;
use std::sync::Arc;

use nn::{AgentSet, Gdat, GdatMemory, Graph, Job, StartError, Weights, Workers};
use wire::{AGENTS_MAX, EDGE_ATTRIBUTES, Edge, Features, NODE_ATTRIBUTES};

/// A frame's graph, step by step.
#[derive(Default)]
pub(crate) struct Steps {
    agents_len: usize,
    /// The agents whose nodes are wanted; none where all are.
    wanted: Option<AgentSet>,
    /// \[step, agent\].
    present: Vec<bool>,
    nodes: Vec<[f32; NODE_ATTRIBUTES]>,
    /// All edges, as if each were of the first step.
    edges: Vec<Edge>,
    attributes: Vec<[f32; EDGE_ATTRIBUTES]>,
    /// The steps with the places of their edges, those with the most edges first.
    blocks: Vec<(usize, Range<usize>)>,
}

/// A worker: its scratch memory, and the nodes of the steps that it did.
pub(crate) struct Attender {
    gdat: Arc<Gdat>,
    memory: GdatMemory,
    steps: Vec<usize>,
    /// \[step of `steps`, agent\].
    nodes: Vec<[f32; NODE_ATTRIBUTES]>,
}

impl Steps {
    pub(crate) fn with_room(history_len: usize) -> Self {
        let nodes = AGENTS_MAX * history_len;
        Self {
            present: Vec::with_capacity(nodes),
            nodes: Vec::with_capacity(nodes),
            blocks: Vec::with_capacity(history_len),
            ..Self::default()
        }
    }

    /// Takes over a frame whose edges are sorted by step.
    pub(crate) fn take(&mut self, features: &Features<'_>, history_len: usize, wanted: Option<AgentSet>) {
        let agents = features.agents;
        self.wanted = wanted;
        self.agents_len = agents.len();
        self.present.clear();
        self.nodes.clear();
        self.blocks.clear();
        for step in 0..history_len {
            self.present.extend(agents.iter().map(|agent| crate::is_present(agent, step)));
            self.nodes.extend(agents.iter().map(|agent| agent.node[step]));
            let place = |step: usize| features.edges.partition_point(|edge| usize::from(edge.step) < step);
            self.blocks.push((step, place(step)..place(step + 1)));
        }
        self.edges.clear();
        self.edges.extend(features.edges.iter().map(|edge| Edge { step: 0, ..*edge }));
        self.attributes.clear();
        self.attributes.extend_from_slice(features.attributes);
        self.blocks.sort_unstable_by_key(|(step, edges)| (std::cmp::Reverse(edges.len()), *step));
    }

    pub(crate) const fn blocks_len(&self) -> usize {
        self.blocks.len()
    }

    /// Whether an agent has a state at a step, \[step, agent\].
    pub(crate) fn present(&self) -> &[bool] {
        &self.present
    }

    /// Edges of the step that has the most.
    fn edges_most(&self) -> usize {
        self.blocks.first().map_or(0, |(_, edges)| edges.len())
    }
}

impl Attender {
    /// As many as there are workers.
    pub(crate) fn pool(
        weights: &Weights,
        gdat: &Arc<Gdat>,
        workers: usize,
    ) -> Result<Workers<Self>, StartError> {
        let history_len = weights.config().history_len;
        let attender = |_| Self {
            gdat: Arc::clone(gdat),
            memory: GdatMemory::default(),
            steps: Vec::with_capacity(history_len),
            nodes: Vec::with_capacity(AGENTS_MAX * history_len),
        };
        Ok(Workers::new(Steps::with_room(history_len), (0..workers.max(1)).map(attender))?)
    }

    /// Forgets the steps of the last frame. Which worker meets the largest step is chance: each gets room
    /// for it.
    pub(crate) fn begin(&mut self, frame: &Steps) {
        self.steps.clear();
        self.nodes.clear();
        self.gdat.make_room(frame.agents_len, frame.edges_most(), &mut self.memory);
    }

    /// The steps that it did, with their nodes after all rounds.
    pub(crate) fn attended(&self) -> impl Iterator<Item = (usize, &[[f32; NODE_ATTRIBUTES]])> {
        let agents_len = self.nodes.len() / self.steps.len().max(1);
        self.steps.iter().copied().zip(self.nodes.chunks_exact(agents_len.max(1)))
    }
}

impl Job for Attender {
    type Input = Steps;

    fn run(&mut self, frame: &Steps, block: usize) {
        let (step, edges) = frame.blocks[block].clone();
        let nodes = step * frame.agents_len..(step + 1) * frame.agents_len;
        let graph = Graph {
            agents_len: frame.agents_len,
            present: &frame.present[nodes.clone()],
            nodes: &frame.nodes[nodes],
            edges: &frame.edges[edges.clone()],
            attributes: &frame.attributes[edges],
        };
        self.nodes.extend_from_slice(match &frame.wanted {
            None => self.gdat.attend(&graph, &mut self.memory),
            Some(wanted) => self.gdat.attend_wanted(&graph, wanted, &mut self.memory),
        });
        self.steps.push(step);
    }
}
