//! The graph of a batch: rows, edges and map patches.

use std::collections::HashMap;
use std::ops::Range;

use nn::ModelConfig;
use scene::{EdgeRule, FeatureScales, PatchOptions, State, Vertex, relation_features, state_features};

use crate::TrainError;
use crate::agent_view::{AgentView, SceneView};
use crate::base::BaseControl;
use crate::net::matrix::Matrix;
use crate::net::topological::Edges;

/// The inputs of [`Batch::new`] besides the scenes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BatchOptions<'a> {
    pub(crate) config: &'a ModelConfig,
    pub(crate) base: &'a BaseControl,
    /// Maximum number of an agent's neighbours, itself included.
    pub(crate) neighbours_max: usize,
    /// Whether the batch includes the graph of the forecast steps.
    pub(crate) with_future: bool,
}

impl<'a> BatchOptions<'a> {
    /// Batches as in a run: the same limit of neighbours, and nothing from the future.
    pub(crate) const fn of_run(config: &'a ModelConfig, base: &'a BaseControl) -> Self {
        Self { config, base, neighbours_max: scene::NEIGHBOURS_MAX, with_future: false }
    }
}

pub(crate) fn scales(config: &ModelConfig) -> FeatureScales {
    FeatureScales { position: config.position_scale, velocity: config.velocity_scale }
}

/// The graph of a batch as the network reads it.
#[derive(Debug)]
pub(crate) struct Graph {
    /// State features `[rows, 6]`.
    pub(crate) state: Matrix,
    pub(crate) type_rows: [Range<usize>; 3],
    /// Relation features `[relations, 6]`, without duplicates.
    pub(crate) relation: Matrix,
    /// Relation of every edge.
    pub(crate) relation_of_edge: Vec<u32>,
    pub(crate) edges: Edges,
    /// Row of every agent and step `[agents × steps]`; [`u32::MAX`] where the agent is absent.
    pub(crate) steps: Vec<u32>,
    /// Steps per agent.
    pub(crate) step_count: usize,
    /// Map patches `[patches, 3 × P × P]`, without duplicates; the first one is empty.
    pub(crate) patches: Matrix,
    /// Patch of every row.
    pub(crate) patch_of_row: Vec<u32>,
}

/// The steps of a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Steps {
    History,
    Future,
}

impl Steps {
    fn of(self, view: &AgentView) -> &[Option<State>] {
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

    /// Index of the first step among the agent's patches.
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
    pub(super) agents: &'a [&'a AgentView],
    pub(super) type_agents: &'a [Range<usize>; 3],
}

impl Placed<'_> {
    pub(super) fn graph(&self, steps: Steps, options: BatchOptions<'_>) -> Result<Graph, TrainError> {
        let rows = Rows::new(self.agents, steps, options.config, self.type_agents);
        let relations = self.relations(steps, &rows, options);
        let (patches, patch_of_row) = self.patches(steps, &rows, options.config)?;
        let (edges, relation_of_edge) = relations.by_receiver(rows.len());
        Ok(Graph {
            relation: Matrix::new(relations.features.len() / 6, 6, relations.features),
            relation_of_edge,
            edges,
            state: Matrix::new(rows.len(), 6, rows.state),
            type_rows: rows.type_rows,
            steps: rows.of_step,
            step_count: rows.step_count,
            patches,
            patch_of_row,
        })
    }

    /// The edges of all scenes and steps, scene by scene.
    fn relations(&self, steps: Steps, rows: &Rows, options: BatchOptions<'_>) -> Relations {
        let BatchOptions { config, neighbours_max, .. } = options;
        let rule = EdgeRule {
            radius_m: config.edge_radius_m,
            pedestrian_radius_m: config.pedestrian_edge_radius_m.unwrap_or(config.edge_radius_m),
            neighbours_max,
        };
        let mut position_of: Vec<Vec<usize>> =
            self.scenes.iter().map(|scene| vec![0; scene.agents.len()]).collect();
        for (position, &(scene, agent)) in self.origin.iter().enumerate() {
            position_of[scene][agent] = position;
        }
        let mut relations = Relations::default();
        let (mut edges, mut vertices) = (Vec::new(), Vec::new());
        for (view, position_of) in self.scenes.iter().zip(&position_of) {
            for step in 0..rows.step_count {
                let state = |agent: usize| steps.of(&view.agents[agent])[step];
                vertices.clear();
                vertices.extend(view.agents.iter().enumerate().map(|(agent, of)| {
                    let agent_type = of.agent.agent_type;
                    state(agent).map(|state| Vertex { position_m: state.position_m, agent_type })
                }));
                edges.clear();
                rule.append(step as u16, &vertices, &mut edges);
                for edge in &edges {
                    let ends = [edge.receiver, edge.sender].map(usize::from);
                    let [Some(receiver), Some(sender)] = ends.map(state) else { continue };
                    let ends = ends.map(|agent| rows.at(position_of[agent], step));
                    relations.push(ends, relation_features(&receiver, &sender, scales(config)));
                }
            }
        }
        relations
    }

    /// The patches of all rows, once per (agent, frame), and the patch of every row.
    fn patches(
        &self,
        steps: Steps,
        rows: &Rows,
        config: &ModelConfig,
    ) -> Result<(Matrix, Vec<u32>), TrainError> {
        if !config.context {
            return Ok((Matrix::default(), Vec::new()));
        }
        let options = PatchOptions {
            side: config.patch_size,
            cell_m: config.patch_cell_m,
            ahead_m: config.patch_ahead_m,
        };
        let mut values = vec![0.0; options.len()];
        let mut known: HashMap<(u32, u32, bool), u32> = HashMap::new();
        let mut of_row = vec![0; rows.len()];
        for (position, &(scene, agent)) in self.origin.iter().enumerate() {
            let view = &self.scenes[scene];
            let Some(map) = view.map else { continue };
            let of_agent = &view.agents[agent].agent.patches[steps.first_patch(config)..];
            for (step, patch) in of_agent.iter().take(rows.step_count).enumerate() {
                let (Some(patch), Some(row)) = (*patch, rows.present(position, step)) else { continue };
                let next = known.len() as u32 + 1;
                let number = *known.entry((map.recording, patch, view.mirrored)).or_insert(next);
                if number == next {
                    let start = values.len();
                    map.extend(patch, options, &mut values)?;
                    if view.mirrored {
                        mirror_patch(&mut values[start..], options.side);
                    }
                }
                of_row[row] = number;
            }
        }
        Ok((Matrix::new(known.len() + 1, options.len(), values), of_row))
    }
}

/// The rows of a batch.
struct Rows {
    /// State features, row by row.
    state: Vec<f32>,
    /// Row of every agent and step; [`u32::MAX`] where absent.
    of_step: Vec<u32>,
    type_rows: [Range<usize>; 3],
    step_count: usize,
}

impl Rows {
    fn new(
        agents: &[&AgentView],
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
                of_step.push(if step.is_some() { (state.len() / 6) as u32 } else { u32::MAX });
                if let Some(step) = step {
                    state.extend(state_features(&view.frame, step, scales));
                }
            }
            first_row.push(state.len() / 6);
        }
        let type_rows = type_agents.clone().map(|agents| first_row[agents.start]..first_row[agents.end]);
        Self { state, of_step, type_rows, step_count: steps.len(config) }
    }

    fn len(&self) -> usize {
        self.state.len() / 6
    }

    fn at(&self, agent: usize, step: usize) -> u32 {
        self.of_step[agent * self.step_count + step]
    }

    fn present(&self, agent: usize, step: usize) -> Option<usize> {
        let row = self.at(agent, step);
        (row != u32::MAX).then_some(row as usize)
    }
}

/// Edges in the order of collection.
#[derive(Default)]
struct Relations {
    receiver: Vec<u32>,
    sender: Vec<u32>,
    /// Features of every distinct relation.
    features: Vec<f32>,
    /// Relation of every edge.
    of_edge: Vec<u32>,
    /// Index of the relation with these features, by their bits.
    known: HashMap<[u32; 6], u32>,
}

impl Relations {
    fn push(&mut self, [receiver, sender]: [u32; 2], features: [f32; 6]) {
        self.receiver.push(receiver);
        self.sender.push(sender);
        let next = self.known.len() as u32;
        let number = *self.known.entry(features.map(f32::to_bits)).or_insert(next);
        if number == next {
            self.features.extend(features);
        }
        self.of_edge.push(number);
    }

    /// The edges sorted by receiver, and the relation of each of them.
    fn by_receiver(&self, row_count: usize) -> (Edges, Vec<u32>) {
        let mut first = vec![0; row_count + 1];
        self.receiver.iter().for_each(|&row| first[row as usize + 1] += 1);
        (0..row_count).for_each(|row| first[row + 1] += first[row]);
        let mut order = vec![0; self.receiver.len()];
        let mut next = first.clone();
        for (edge, &row) in self.receiver.iter().enumerate() {
            order[next[row as usize] as usize] = edge;
            next[row as usize] += 1;
        }
        let sorted = |values: &[u32]| order.iter().map(|&edge| values[edge]).collect();
        let edges = Edges { receiver: sorted(&self.receiver), sender: sorted(&self.sender), first };
        (edges, sorted(&self.of_edge))
    }
}

/// Swaps left and right of a patch `[3, side, side]`: the columns, and the sign of the lateral velocity.
fn mirror_patch(values: &mut [f32], side: usize) {
    values.chunks_exact_mut(side).for_each(<[f32]>::reverse);
    values[2 * side * side..].iter_mut().for_each(|value| *value = -*value);
}
