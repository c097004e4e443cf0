//! Distributes the steps of a frame's graph among the workers. Attention joins only agents of the same step,
//! so steps are independent.

use std::ops::Range;
use std::sync::Arc;

use nn::{AgentSet, Gdat, GdatMemory, Graph, Job, StartError, Weights, Workers};
use wire::{AGENTS_MAX, EDGE_ATTRIBUTES, Edge, Features, NODE_ATTRIBUTES};

/// A frame's graph, step by step.
#[derive(Default)]
pub(crate) struct Steps {
    agents_len: usize,
    /// The agents whose nodes are wanted; `None` for all agents.
    wanted: Option<AgentSet>,
    /// \[step, agent\].
    present: Vec<bool>,
    nodes: Vec<[f32; NODE_ATTRIBUTES]>,
    /// All edges, with step 0 in each.
    edges: Vec<Edge>,
    attributes: Vec<[f32; EDGE_ATTRIBUTES]>,
    /// Each step with the range of its edges. Steps with the most edges come first.
    blocks: Vec<(usize, Range<usize>)>,
}

/// A worker: its scratch memory and the nodes of the steps that it computed.
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

    /// Copies a frame whose edges are sorted by step.
    pub(crate) fn take(&mut self, features: &Features<'_>, history_len: usize, wanted: Option<AgentSet>) {
        let agents = features.agents;
        self.wanted = wanted;
        self.agents_len = agents.len();
        self.present.clear();
        self.nodes.clear();
        self.blocks.clear();
        for step in 0..history_len {
            self.present.extend(agents.iter().map(|agent| agent.is_present(step)));
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

    pub(crate) const fn block_count(&self) -> usize {
        self.blocks.len()
    }

    /// Whether an agent has a state at a step, \[step, agent\].
    pub(crate) fn present(&self) -> &[bool] {
        &self.present
    }

    /// The number of edges of the step with the most edges.
    fn edges_most(&self) -> usize {
        self.blocks.first().map_or(0, |(_, edges)| edges.len())
    }
}

impl Attender {
    /// One attender for each worker.
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

    /// Discards the steps of the last frame. Any worker may get the largest step, so each reserves memory for
    /// it.
    pub(crate) fn begin(&mut self, frame: &Steps) {
        self.steps.clear();
        self.nodes.clear();
        self.gdat.make_room(frame.agents_len, frame.edges_most(), &mut self.memory);
    }

    /// The steps that this worker computed, with their nodes after all rounds.
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
