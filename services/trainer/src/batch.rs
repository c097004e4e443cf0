//! Training scenes to tensors.

mod graph;

use std::ops::Range;

use burn::tensor::{Bool, Device, Int, Shape, Tensor, TensorData};
use graph::{Placed, Steps};
use nn::ModelConfig;
use scene::{AgentFrame, FeatureScales, State, state_features};

use crate::base::BaseControl;
use crate::model::{Graph, Normalisation};
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
fn in_frame(frame: &AgentFrame, position_m: [f32; 2]) -> [f32; 2] {
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
        let type_of =
            |&(scene, agent): &(usize, usize)| scenes[scene].agents[agent].agent.agent_type as usize;
        origin.sort_by_key(type_of);
        let first_of = |agent_type: usize| origin.partition_point(|at| type_of(at) < agent_type);
        let type_agents = [0, 1, 2].map(|agent_type| first_of(agent_type)..first_of(agent_type + 1));
        let agents: Vec<&View<'_>> =
            origin.iter().map(|&(scene, agent)| &scenes[scene].agents[agent]).collect();

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

fn vehicle_start(agents: &[&View<'_>], config: &ModelConfig, device: &Device) -> VehicleStart {
    let starts: Vec<Start> =
        agents.iter().map(|view| Start::of(view.agent, &view.history, &view.frame, config)).collect();
    let column =
        |value: fn(&Start) -> f32| floats(starts.iter().map(value).collect(), [starts.len(), 1], device);
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
    pub(crate) fn of(
        agent: &Agent,
        history: &[Option<State>],
        frame: &AgentFrame,
        config: &ModelConfig,
    ) -> Self {
        let rear_axle_m = config.rear_axle_ratio * agent.length_m.unwrap_or(config.default_length_m);
        let newest = history.last().copied().flatten().unwrap_or_default();
        let along = AgentFrame::new(newest.position_m, newest.heading_rad);
        let [speed_mps, _] = along.rotate_into(newest.velocity_mps);
        let slip_rad = if config.initial_slip {
            kinematics::initial_slip(rear_axle_m, speed_mps, scene::turn_rates(history, config.dt_s as f32))
        } else {
            0.0
        };
        let heading_rad = kinematics::wrap_angle(newest.heading_rad - frame.heading_rad);
        Self { heading_rad, speed_mps, slip_rad, rear_axle_m }
    }
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

pub(crate) fn booleans<const D: usize>(
    values: Vec<bool>,
    shape: [usize; D],
    device: &Device,
) -> Tensor<D, Bool> {
    Tensor::from_data(TensorData::new(values, Shape::from(shape)), device)
}
