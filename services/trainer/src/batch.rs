//! Training scenes to tensors.

use std::collections::BTreeMap;
use std::ops::Range;

use burn::tensor::{Bool, Device, Int, Shape, Tensor, TensorData};
use nn::ModelConfig;
use scene::{AgentFrame, EdgeRule, FeatureScales, State, Vertex, relation_features, state_features};

use crate::base::BaseControl;
use crate::model::{Context, Edges, Graph, Normalisation};
use crate::motion::VehicleStart;
use crate::samples::{Agent, Patches};

/// One agent as one step of training shows it to the network: perhaps with a shortened history.
#[derive(Clone, Debug)]
pub(crate) struct View<'a> {
    pub(crate) agent: &'a Agent,
    pub(crate) history: Vec<Option<State>>,
    pub(crate) future: Vec<Option<State>>,
    pub(crate) frame: AgentFrame,
}

impl View<'_> {
    /// Recorded positions of the forecast steps in the agent frame.
    pub(crate) fn truth(&self) -> impl Iterator<Item = Option<[f32; 2]>> + '_ {
        self.future.iter().map(|state| state.map(|state| in_frame(&self.frame, state.position_m)))
    }
}

/// A world position in an agent frame.
pub(crate) fn in_frame(frame: &AgentFrame, position_m: [f32; 2]) -> [f32; 2] {
    frame.rotate_into([0, 1].map(|axis| position_m[axis] - frame.origin_m[axis]))
}

/// Agents of one time and place.
#[derive(Clone, Debug)]
pub(crate) struct SceneView<'a> {
    pub(crate) agents: Vec<View<'a>>,
    /// Map patches of the recording; `None` where the scene is shown without a map.
    pub(crate) patches: Option<&'a Patches>,
    /// Whether left and right are swapped.
    pub(crate) mirrored: bool,
}

/// Which steps a graph is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Steps {
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

/// What the network gets and what it is held to.
#[derive(Clone, Debug)]
pub(crate) struct Batch {
    pub(crate) graph: Graph,
    /// The graph of the forecast steps, where training needs it.
    pub(crate) future: Option<Graph>,
    /// Agents of each type.
    pub(crate) type_agents: [Range<usize>; 3],
    /// State features `[agents, history, 6]`, zeros where absent.
    pub(crate) state: Tensor<3>,
    /// 1 where the agent is present, `[agents, history]`.
    pub(crate) present: Tensor<2>,
    /// Velocity at the last observed step in the agent frame `[agents, 2]`.
    pub(crate) velocity_mps: Tensor<2>,
    /// How the vehicles stand, the first agents of the batch.
    pub(crate) start: VehicleStart,
    /// Ridge control `[agents, horizon, 2]`.
    pub(crate) ridge: Tensor<3>,
    /// Anchors `[agents, modes + 1, horizon × 2]`; the last are zero, for the single best forecast.
    pub(crate) anchors: Tensor<3>,
    /// True positions in the agent frame `[agents, horizon, 2]`, zeros where unknown.
    pub(crate) truth: Tensor<3>,
    /// 1 where the truth is known and counts, `[agents, horizon]`.
    pub(crate) counts: Tensor<2>,
    /// Scene and agent within it of every agent of the batch.
    pub(crate) origin: Vec<(usize, usize)>,
}

/// What [`Batch::new`] needs besides the scenes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BatchOptions<'a> {
    pub(crate) config: &'a ModelConfig,
    pub(crate) base: &'a BaseControl,
    /// Most neighbours of an agent, itself included.
    pub(crate) neighbours_max: usize,
    pub(crate) normalisation: Normalisation,
    /// Whether the graph of the forecast steps is made too.
    pub(crate) with_future: bool,
    pub(crate) device: &'a Device,
}

impl Batch {
    pub(crate) fn new(scenes: &[SceneView<'_>], options: BatchOptions<'_>) -> Self {
        let mut origin: Vec<(usize, usize)> = scenes
            .iter()
            .enumerate()
            .flat_map(|(scene, view)| (0..view.agents.len()).map(move |agent| (scene, agent)))
            .collect();
        let type_of = |&(scene, agent): &(usize, usize)| scenes[scene].agents[agent].agent.agent_type as usize;
        origin.sort_by_key(type_of);
        let first_of = |agent_type: usize| origin.partition_point(|at| type_of(at) < agent_type);
        let type_agents = [0, 1, 2].map(|agent_type| first_of(agent_type)..first_of(agent_type + 1));
        let agents: Vec<&View<'_>> = origin.iter().map(|&(scene, agent)| &scenes[scene].agents[agent]).collect();

        let place = Placed { scenes, origin: &origin, agents: &agents, type_agents: &type_agents };
        let history = place.graph(Steps::History, options);
        let future = options.with_future.then(|| place.graph(Steps::Future, options));
        Self { future, ..Self::of_agents(&agents, history, type_agents.clone(), origin.clone(), options) }
    }

    fn of_agents(
        agents: &[&View<'_>],
        graph: Graph,
        type_agents: [Range<usize>; 3],
        origin: Vec<(usize, usize)>,
        options: BatchOptions<'_>,
    ) -> Self {
        let BatchOptions { config, base, device, .. } = options;
        let (agents_len, history_len, horizon_len) = (agents.len(), config.history_len, config.horizon_len);
        let scales = scales(config);
        let (mut state, mut present, mut velocity) = (Vec::new(), Vec::new(), Vec::new());
        let (mut truth, mut counts) = (Vec::new(), Vec::new());
        let (mut ridge, mut anchors) = (Vec::new(), Vec::new());
        for view in agents {
            for step in &view.history {
                state.extend(step.map_or([0.0; 6], |step| state_features(&view.frame, &step, scales)));
                present.push(f32::from(u8::from(step.is_some())));
            }
            let newest = view.history.last().copied().flatten().unwrap_or_default();
            velocity.extend(view.frame.rotate_into(newest.velocity_mps));
            for position in view.truth() {
                truth.extend(position.unwrap_or_default());
                counts.push(f32::from(u8::from(position.is_some() && view.agent.counts)));
            }
            let control = base.of(view.agent.agent_type, &view.history, &view.frame);
            ridge.extend_from_slice(&control.ridge);
            anchors.extend_from_slice(control.anchors);
        }
        Self {
            state: floats(state, [agents_len, history_len, 6], device),
            present: floats(present, [agents_len, history_len], device),
            velocity_mps: floats(velocity, [agents_len, 2], device),
            start: vehicle_start(&agents[type_agents[0].clone()], config, device),
            ridge: floats(ridge, [agents_len, horizon_len, 2], device),
            anchors: floats(anchors, [agents_len, config.modes + 1, horizon_len * 2], device),
            truth: floats(truth, [agents_len, horizon_len, 2], device),
            counts: floats(counts, [agents_len, horizon_len], device),
            graph,
            future: None,
            type_agents,
            origin,
        }
    }
}

/// The agents of some scenes in the order of a batch.
struct Placed<'a> {
    scenes: &'a [SceneView<'a>],
    origin: &'a [(usize, usize)],
    agents: &'a [&'a View<'a>],
    type_agents: &'a [Range<usize>; 3],
}

impl Placed<'_> {
    fn graph(&self, steps: Steps, options: BatchOptions<'_>) -> Graph {
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
    fn new(agents: &[&View<'_>], steps: Steps, config: &ModelConfig, type_agents: &[Range<usize>; 3]) -> Self {
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

fn vehicle_start(agents: &[&View<'_>], config: &ModelConfig, device: &Device) -> VehicleStart {
    let starts: Vec<Start> = agents.iter().map(|view| Start::of(view.agent, &view.history, &view.frame, config)).collect();
    let column = |value: fn(&Start) -> f32| floats(starts.iter().map(value).collect(), [starts.len(), 1], device);
    VehicleStart {
        position_m: Tensor::zeros([starts.len(), 2], device),
        heading_rad: column(|start| start.heading_rad),
        speed_mps: column(|start| start.speed_mps),
        slip_rad: column(|start| start.slip_rad),
        rear_axle_m: column(|start| start.rear_axle_m),
    }
}

/// How a vehicle stands at the end of its history, in its agent frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Start {
    pub(crate) heading_rad: f32,
    pub(crate) speed_mps: f32,
    pub(crate) slip_rad: f32,
    pub(crate) rear_axle_m: f32,
}

impl Start {
    pub(crate) fn of(agent: &Agent, history: &[Option<State>], frame: &AgentFrame, config: &ModelConfig) -> Self {
        let rear_axle_m = config.rear_axle_ratio * agent.length_m.unwrap_or(config.default_length_m);
        let newest = history.last().copied().flatten().unwrap_or_default();
        let along = AgentFrame::new(newest.position_m, newest.heading_rad);
        let [speed_mps, _] = along.rotate_into(newest.velocity_mps);
        let slip_rad = if config.initial_slip {
            kinematics::initial_slip(rear_axle_m, speed_mps, turn_rates(history, config.dt_s as f32))
        } else {
            0.0
        };
        let heading_rad = kinematics::wrap_angle(newest.heading_rad - frame.heading_rad);
        Self { heading_rad, speed_mps, slip_rad, rear_axle_m }
    }
}

/// Turn rates of the newest two history intervals, newest first; 0 where a state is absent.
fn turn_rates(history: &[Option<State>], dt_s: f32) -> [f32; 2] {
    let len = history.len();
    [1, 2].map(|back| match (len.checked_sub(back + 1).and_then(|i| history[i]), history.get(len - back).copied().flatten()) {
        (Some(before), Some(after)) => kinematics::wrap_angle(after.heading_rad - before.heading_rad) / dt_s,
        _ => 0.0,
    })
}

fn scales(config: &ModelConfig) -> FeatureScales {
    FeatureScales { position: config.position_scale, velocity: config.velocity_scale }
}

pub(crate) fn floats<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, Shape::from(shape)), device)
}

pub(crate) fn integers(values: &[usize], device: &Device) -> Tensor<1, Int> {
    let values: Vec<i64> = values.iter().map(|&value| value as i64).collect();
    let len = values.len();
    Tensor::from_data(TensorData::new(values, [len]), device)
}

pub(crate) fn booleans<const D: usize>(values: Vec<bool>, shape: [usize; D], device: &Device) -> Tensor<D, Bool> {
    Tensor::from_data(TensorData::new(values, Shape::from(shape)), device)
}
