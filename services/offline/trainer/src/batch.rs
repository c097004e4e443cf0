//! Training scenes as matrices. \[model §2\]
//!
//! **In:** [`SceneView`]s, with states in the world frame (m, m/s, rad). **Out:** a [`Batch`]: scaled
//! features and targets in agent frames; its fields document the shapes.
//!
//! A batch is ragged. The agents of many scenes form one list, sorted by type; within a type, agents with a
//! target come first. A *row* is an agent at one step at which it is present. Rows are sorted by (agent,
//! step), so the rows of each type are contiguous. Edges join rows of the same scene and step.
//!
//! Neighbouring windows of a recording share most of their steps. The features of a map patch, or of a pair
//! of agents at one step, are therefore computed once. All rows and edges with the same patch or pair share
//! the result.

mod arrays;
mod graph;
#[cfg(test)]
mod tests;

use std::ops::Range;

use scene::state_features;

use crate::TrainError;
use crate::agent_view::{AgentView, SceneView, start};
use crate::base::AgentBase;
use crate::net::matrix::Matrix;
use crate::net::motion::Start;

pub use arrays::{Array, Values};
pub(crate) use graph::scales;
pub(crate) use graph::{BatchOptions, Graph};
use graph::{Placed, Steps};

/// Inputs of the network and targets of the loss.
#[derive(Debug)]
pub(crate) struct Batch<'a> {
    pub(crate) graph: Graph,
    /// The graph of the forecast steps, if the objective needs it.
    pub(crate) future: Option<Graph>,
    /// Ranges of the forecast agents of each type.
    pub(crate) forecast: [Range<usize>; 3],
    /// State features `[agents, history × 6]`, zeros where absent.
    pub(crate) state: Matrix,
    /// 1 if the agent is present, `[agents, history]`.
    pub(crate) present: Matrix,
    /// The state of every agent at the last observed step.
    pub(crate) starts: Vec<Start>,
    /// The base control of every agent.
    pub(crate) base: Vec<AgentBase<'a>>,
    /// True positions in the agent frame `[agents, horizon × 2]`, zeros where unknown.
    pub(crate) truth: Matrix,
    /// 1 if the truth is known, `[agents, horizon]`.
    pub(crate) counts: Matrix,
    /// Scene and agent within it of every agent of the batch.
    pub(crate) origin: Vec<(usize, usize)>,
}

impl<'a> Batch<'a> {
    /// # Errors
    /// [`TrainError::Scratch`] if a map patch can't be read.
    pub(crate) fn new(scenes: &[SceneView<'_>], options: BatchOptions<'a>) -> Result<Self, TrainError> {
        let mut origin: Vec<(usize, usize)> = scenes
            .iter()
            .enumerate()
            .flat_map(|(scene, view)| (0..view.agents.len()).map(move |agent| (scene, agent)))
            .collect();
        let place = |&(scene, agent): &(usize, usize)| {
            let view = &scenes[scene].agents[agent];
            (view.agent.agent_type as usize, !view.counts)
        };
        origin.sort_by_key(place);
        let first = |at: (usize, bool)| origin.partition_point(|origin| place(origin) < at);
        let type_agents = [0, 1, 2].map(|of_type| first((of_type, false))..first((of_type + 1, false)));
        let forecast = [0, 1, 2].map(|of_type| first((of_type, false))..first((of_type, true)));
        let agents: Vec<&AgentView> =
            origin.iter().map(|&(scene, agent)| &scenes[scene].agents[agent]).collect();

        let placed = Placed { scenes, origin: &origin, agents: &agents, type_agents: &type_agents };
        let graph = placed.graph(Steps::History, options)?;
        let future = options.with_future.then(|| placed.graph(Steps::Future, options)).transpose()?;
        let targets = Targets::of(&agents, options);
        let Targets { state, present, starts, base, truth, counts } = targets;
        Ok(Self { graph, future, forecast, state, present, starts, base, truth, counts, origin })
    }
}

/// The parts of a batch that do not depend on other agents.
struct Targets<'a> {
    state: Matrix,
    present: Matrix,
    starts: Vec<Start>,
    base: Vec<AgentBase<'a>>,
    truth: Matrix,
    counts: Matrix,
}

impl<'a> Targets<'a> {
    fn of(agents: &[&AgentView], options: BatchOptions<'a>) -> Self {
        let BatchOptions { config, base, .. } = options;
        let (agents_len, history_len, horizon_len) = (agents.len(), config.history_len, config.horizon_len);
        let scales = scales(config);
        let (mut state, mut present) = (Vec::new(), Vec::new());
        let (mut truth, mut counts) = (Vec::new(), Vec::new());
        for view in agents {
            for step in &view.history {
                state.extend(step.map_or([0.0; 6], |step| state_features(&view.frame, &step, scales)));
                present.push(f32::from(u8::from(step.is_some())));
            }
            for position in view.truth() {
                truth.extend(position.unwrap_or_default());
                counts.push(f32::from(u8::from(position.is_some())));
            }
        }
        let of = |view: &&AgentView| base.of(view.agent.agent_type, &view.history, &view.frame);
        Self {
            state: Matrix::new(agents_len, history_len * 6, state),
            present: Matrix::new(agents_len, history_len, present),
            starts: agents
                .iter()
                .map(|view| start(&view.agent, &view.history, &view.frame, config))
                .collect(),
            base: agents.iter().map(of).collect(),
            truth: Matrix::new(agents_len, horizon_len * 2, truth),
            counts: Matrix::new(agents_len, horizon_len, counts),
        }
    }
}
