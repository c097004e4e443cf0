//! The agents of a window, in memory and in the spool.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use data::{Reported, WindowAgent};
use nn::ModelConfig;
use scene::{AgentType, State};

use crate::TrainError;
use crate::spool::{Spool, Spooling};

/// An agent of a window.
#[derive(Clone, Debug)]
pub(crate) struct Agent {
    /// Identity in the recording.
    pub(crate) id: u64,
    pub(crate) agent_type: AgentType,
    /// Length; `None` if unknown.
    pub(crate) length_m: Option<f32>,
    /// States at the history steps, oldest first.
    pub(crate) history: Vec<Option<State>>,
    /// States at the forecast steps, velocities and headings by backward differences.
    pub(crate) future: Vec<Option<State>>,
    /// Index of the map patch of every history and forecast step.
    pub(crate) patches: Vec<Option<u32>>,
    /// Whether the agent has a target: its two newest states exist, and its future is known to the end.
    pub(crate) counts: bool,
}

impl Agent {
    /// Uses recorded motion if the recording reports it at every time so far and `from_positions` is false.
    /// Otherwise velocities and headings are differences over the model's step. Differences over the frames
    /// of a fast recording would be mostly noise, which trackers filter out.
    pub(super) fn new(
        agent: &WindowAgent,
        patches: Vec<Option<u32>>,
        from_positions: bool,
        config: &ModelConfig,
    ) -> Self {
        let history_len = agent.history.len();
        let positions: Vec<Option<[f32; 2]>> = agent
            .history
            .iter()
            .map(|state| state.map(|state| state.position_m))
            .chain(agent.future.iter().copied())
            .collect();
        let mut states = vec![None; positions.len()];
        scene::states_from_positions(&positions, history_len, config.dt_s as f32, &mut states);
        let future = states.split_off(history_len);
        let Reported { agent_type, length_m, has_speed, has_heading, .. } = agent.reported;
        let [keeps_velocity, keeps_heading] = [has_speed, has_heading].map(|has| has && !from_positions);
        let choose = |recorded: State, differenced: State| State {
            position_m: recorded.position_m,
            velocity_mps: if keeps_velocity { recorded.velocity_mps } else { differenced.velocity_mps },
            heading_rad: if keeps_heading { recorded.heading_rad } else { differenced.heading_rad },
        };
        let history: Vec<Option<State>> = agent
            .history
            .iter()
            .zip(states)
            .map(|(recorded, differenced)| Some(choose((*recorded)?, differenced?)))
            .collect();
        let newest_two = history_len >= 2 && history.iter().rev().take(2).all(Option::is_some);
        Self {
            id: agent.id,
            agent_type,
            length_m: (length_m > 0.0).then_some(length_m),
            history,
            future,
            patches,
            counts: newest_two && agent.future.iter().all(Option::is_some),
        }
    }

    /// The history with all but the newest `len` steps absent.
    pub(crate) fn history_of(&self, len: usize) -> Vec<Option<State>> {
        let hidden = self.history.len().saturating_sub(len);
        self.history.iter().enumerate().map(|(step, state)| state.filter(|_| step >= hidden)).collect()
    }

    /// Recorded positions of the forecast steps.
    pub(crate) fn future_m(&self) -> Vec<Option<[f32; 2]>> {
        self.future.iter().map(|state| state.map(|state| state.position_m)).collect()
    }
}

/// The agents of a window, shared by reference.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    pub(crate) agents: Vec<Arc<Agent>>,
}

/// Offset of a window in the spool, and the values that are needed before it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    offset: u64,
    agents_len: u32,
    pub(crate) recording: u32,
    /// Agents of each type that have a target.
    pub(crate) counted: [u32; 3],
}

impl Window {
    /// Agents that have a target.
    pub(crate) fn counted_count(&self) -> usize {
        self.counted.iter().map(|&len| len as usize).sum()
    }
}

/// An agent in the spool.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct StoredAgent {
    id: u64,
    length_m: f32,
    agent_type: u16,
    knows_length: u8,
    counts: u8,
}

/// A state in the spool: position (m), velocity (m/s) and heading (rad).
pub(super) type StoredState = [f32; 5];

/// One step of an agent in the spool. The steps of all agents follow the agents of a scene.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct StoredStep {
    state: StoredState,
    is_present: u32,
    /// [`u32::MAX`] if there is none.
    patch: u32,
}

pub(super) fn stored(state: &State) -> StoredState {
    let State { position_m: [x, y], velocity_mps: [vx, vy], heading_rad } = *state;
    [x, y, vx, vy, heading_rad]
}

pub(super) fn restored([x, y, vx, vy, heading_rad]: StoredState) -> State {
    State { position_m: [x, y], velocity_mps: [vx, vy], heading_rad }
}

impl Scene {
    /// Agents of each type that have a target.
    fn counted(&self) -> [u32; 3] {
        let mut counted = [0; 3];
        for agent in self.agents.iter().filter(|agent| agent.counts) {
            counted[agent.agent_type.index()] += 1;
        }
        counted
    }

    /// Writes the scene as a scene of the recording with this index.
    pub(super) fn append_to(&self, spooling: &mut Spooling, recording: u32) -> Result<Window, TrainError> {
        let agents: Vec<StoredAgent> = self.agents.iter().map(|agent| stored_agent(agent)).collect();
        let steps: Vec<StoredStep> = self.agents.iter().flat_map(|agent| stored_steps(agent)).collect();
        let offset = spooling.append(&agents)?;
        spooling.append(&steps)?;
        let agents_len = agents.len() as u32;
        Ok(Window { offset, agents_len, recording, counted: self.counted() })
    }

    /// Reads a scene whose agents have `history_len` and `horizon_len` steps.
    pub(super) fn read(
        spool: &Spool,
        window: &Window,
        [history_len, horizon_len]: [usize; 2],
    ) -> Result<Self, TrainError> {
        let agents_len = window.agents_len as usize;
        let step_count = history_len + horizon_len;
        let agents: Vec<StoredAgent> = spool.read(window.offset, agents_len)?;
        let steps_offset = window.offset + size_of_val(agents.as_slice()) as u64;
        let steps: Vec<StoredStep> = spool.read(steps_offset, agents_len * step_count)?;
        let restore = |(agent, steps): (&StoredAgent, &[StoredStep])| {
            let states = |steps: &[StoredStep]| {
                steps.iter().map(|step| (step.is_present != 0).then(|| restored(step.state))).collect()
            };
            let (history, future) = steps.split_at(history_len);
            let agent_type = AgentType::try_from(u32::from(agent.agent_type));
            Ok(Arc::new(Agent {
                id: agent.id,
                agent_type: agent_type.map_err(|error| spool.damaged(error))?,
                length_m: (agent.knows_length != 0).then_some(agent.length_m),
                history: states(history),
                future: states(future),
                patches: steps.iter().map(|step| (step.patch != u32::MAX).then_some(step.patch)).collect(),
                counts: agent.counts != 0,
            }))
        };
        let agents = agents.iter().zip(steps.chunks_exact(step_count)).map(restore);
        Ok(Self { agents: agents.collect::<Result<_, TrainError>>()? })
    }
}

fn stored_agent(agent: &Agent) -> StoredAgent {
    StoredAgent {
        id: agent.id,
        length_m: agent.length_m.unwrap_or_default(),
        agent_type: agent.agent_type as u16,
        knows_length: agent.length_m.is_some().into(),
        counts: agent.counts.into(),
    }
}

fn stored_steps(agent: &Agent) -> impl Iterator<Item = StoredStep> + '_ {
    let states = agent.history.iter().chain(&agent.future);
    states.zip(&agent.patches).map(|(state, patch)| StoredStep {
        state: state.as_ref().map_or([0.0; 5], stored),
        is_present: state.is_some().into(),
        patch: patch.unwrap_or(u32::MAX),
    })
}
