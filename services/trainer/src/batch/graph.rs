//! The graph of a batch: rows, edges and map patches.

use std::collections::BTreeMap;
use std::ops::Range;

use burn::tensor::{Device, Tensor};
use nn::ModelConfig;
use scene::{EdgeRule, State, Vertex, relation_features, state_features};

use super::{BatchOptions, SceneView, View, booleans, floats, integers, scales};
use crate::model::{Context, Edges, Graph, Normalisation};

/// Which steps a graph is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Steps {
    History,
    Future,
}

impl Steps {
    fn of<'a>(self, view: &'a View<'_>) -> &'a [Option<State>] {
        match self {
            Self::History => &view.history,
            Self::Future => &view.future,
        }
    }

    fn len(self, config: &ModelConfig) -> usize {
        match self {
            Self::History => config.history_len,
            Self::Future => config.horizon_len,
        }
    }

    /// Place of the first step among the agent's patches.
    fn first_patch(self, config: &ModelConfig) -> usize {
        match self {
            Self::History => 0,
            Self::Future => config.history_len,
        }
    }
}

/// The agents of some scenes in the order of a batch.
pub(super) struct Placed<'a> {
    pub(super) scenes: &'a [SceneView<'a>],
    pub(super) origin: &'a [(usize, usize)],
    pub(super) agents: &'a [&'a View<'a>],
    pub(super) type_agents: &'a [Range<usize>; 3],
}

impl Placed<'_> {
    pub(super) fn graph(&self, steps: Steps, options: BatchOptions<'_>) -> Graph {
        let BatchOptions { config, device, .. } = options;
        let rows = Rows::new(self.agents, steps, config, self.type_agents);
        let (relation, edges) = self.edges(steps, &rows, options);
        let absent = rows.of_step.iter().map(|&row| row == rows.len()).collect();
        Graph {
            state: floats(rows.state.clone(), [rows.len(), 6], device),
            type_rows: rows.type_rows.clone(),
            relation,
            edges,
            steps: integers(&rows.of_step, device),
            absent: booleans(absent, [self.agents.len(), rows.steps_len], device),
            context: self.context(steps, &rows, options),
        }
    }

    /// Relation features and edges of all scenes and steps.
    fn edges(&self, steps: Steps, rows: &Rows, options: BatchOptions<'_>) -> (Tensor<2>, Edges) {
        let BatchOptions { config, device, neighbours_max, .. } = options;
        let rule = EdgeRule {
            radius_m: config.edge_radius_m,
            pedestrian_radius_m: config.pedestrian_edge_radius_m.unwrap_or(config.edge_radius_m),
            neighbours_max,
        };
        let position_of: BTreeMap<(usize, usize), usize> =
            self.origin.iter().enumerate().map(|(i, &at)| (at, i)).collect();
        let mut list = EdgeList { received: vec![Vec::new(); rows.len()], ..EdgeList::default() };
        let mut edges = Vec::new();
        for (scene, view) in self.scenes.iter().enumerate() {
            for step in 0..rows.steps_len {
                let state = |agent: usize| steps.of(&view.agents[agent])[step];
                let vertex = |agent: usize| {
                    let agent_type = view.agents[agent].agent.agent_type;
                    Some(Vertex { position_m: state(agent)?.position_m, agent_type })
                };
                let vertices: Vec<Option<Vertex>> = (0..view.agents.len()).map(vertex).collect();
                edges.clear();
                rule.append(step as u16, &vertices, &mut edges);
                for edge in &edges {
                    let ends = [edge.receiver, edge.sender].map(usize::from);
                    let [Some(receiver), Some(sender)] = ends.map(state) else { continue };
                    let ends = ends.map(|agent| rows.at(position_of[&(scene, agent)], step));
                    list.push(ends, relation_features(&receiver, &sender, scales(config)));
                }
            }
        }
        list.tensors(rows.len(), device)
    }

    /// Patches of all rows, each (agent, frame) once; the first is the empty one.
    fn context(&self, steps: Steps, rows: &Rows, options: BatchOptions<'_>) -> Context {
        let BatchOptions { config, device, normalisation, .. } = options;
        let side = config.patch_size;
        let mut values = vec![0.0; 3 * side * side];
        let mut known: BTreeMap<(usize, usize, bool), usize> = BTreeMap::new();
        let mut of_row = vec![0; rows.len()];
        for (position, &(scene, agent)) in self.origin.iter().enumerate() {
            let view = &self.scenes[scene];
            let Some(patches) = view.patches else { continue };
            let of_agent = &view.agents[agent].agent.patches[steps.first_patch(config)..];
            for (step, patch) in of_agent.iter().take(rows.steps_len).enumerate() {
                let row = rows.at(position, step);
                let (Some(patch), true) = (*patch, row < rows.len()) else { continue };
                let next = known.len() + 1;
                of_row[row] = *known.entry((patches.recording, patch, view.mirrored)).or_insert_with(|| {
                    let start = values.len();
                    patches.extend(patch, &mut values);
                    if view.mirrored {
                        mirror_patch(&mut values[start..], side);
                    }
                    next
                });
            }
        }
        let patches_len = known.len() + 1;
        Context {
            patches: floats(values, [patches_len, 3, side, side], device),
            of_row: integers(&of_row, device),
            // Statistics of the one empty patch would say nothing.
            normalisation: if patches_len == 1 { Normalisation::Running } else { normalisation },
        }
    }
}

/// Where the rows of a batch stand.
struct Rows {
    /// State features, row by row.
    state: Vec<f32>,
    /// Row of every agent and step; the number of rows where absent.
    of_step: Vec<usize>,
    type_rows: [Range<usize>; 3],
    steps_len: usize,
}

impl Rows {
    fn new(
        agents: &[&View<'_>],
        steps: Steps,
        config: &ModelConfig,
        type_agents: &[Range<usize>; 3],
    ) -> Self {
        let scales = scales(config);
        let mut state = Vec::new();
        let mut of_step = Vec::with_capacity(agents.len() * steps.len(config));
        let mut first_row = vec![0];
        for view in agents {
            for step in steps.of(view) {
                of_step.push(if step.is_some() { state.len() / 6 } else { usize::MAX });
                if let Some(step) = step {
                    state.extend(state_features(&view.frame, step, scales));
                }
            }
            first_row.push(state.len() / 6);
        }
        let len = state.len() / 6;
        of_step.iter_mut().filter(|row| **row == usize::MAX).for_each(|row| *row = len);
        let type_rows = type_agents.clone().map(|agents| first_row[agents.start]..first_row[agents.end]);
        Self { state, of_step, type_rows, steps_len: steps.len(config) }
    }

    fn len(&self) -> usize {
        self.state.len() / 6
    }

    fn at(&self, agent: usize, step: usize) -> usize {
        self.of_step[agent * self.steps_len + step]
    }
}

/// Edges as they are collected.
#[derive(Default)]
struct EdgeList {
    receivers: Vec<usize>,
    senders: Vec<usize>,
    relation: Vec<f32>,
    /// Edges that every row receives.
    received: Vec<Vec<usize>>,
}

impl EdgeList {
    fn push(&mut self, [receiver, sender]: [usize; 2], relation: [f32; 6]) {
        self.received[receiver].push(self.receivers.len());
        self.receivers.push(receiver);
        self.senders.push(sender);
        self.relation.extend(relation);
    }

    fn tensors(self, rows_len: usize, device: &Device) -> (Tensor<2>, Edges) {
        let edges_len = self.receivers.len();
        let slots_len = self.received.iter().map(Vec::len).max().unwrap_or(0);
        let slots: Vec<usize> = self
            .received
            .iter()
            .flat_map(|edges| edges.iter().copied().chain(std::iter::repeat(edges_len)).take(slots_len))
            .collect();
        let empty = slots.iter().map(|&edge| edge == edges_len).collect();
        let edges = Edges {
            receiver: integers(&self.receivers, device),
            sender: integers(&self.senders, device),
            slots: integers(&slots, device),
            empty: booleans(empty, [rows_len, slots_len], device),
        };
        (floats(self.relation, [edges_len, 6], device), edges)
    }
}

/// Swaps left and right of a patch `[3, side, side]`: columns, and the sign of the velocity to the left.
fn mirror_patch(values: &mut [f32], side: usize) {
    values.chunks_exact_mut(side).for_each(<[f32]>::reverse);
    values[2 * side * side..].iter_mut().for_each(|value| *value = -*value);
}
