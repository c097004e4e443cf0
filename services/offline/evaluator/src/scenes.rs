//! Scenes: what a forecaster sees at a time of a recording, and the true future.

use data::{Recording, Reported, Window, WindowAgent, WindowOptions};
use metrics::Point;
use nn::ModelConfig;
use scene::{AgentType, State};

/// Speed at the last observed step from which an agent counts as moving.
pub const MOVING_MPS: f32 = 0.5;

/// An agent of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Agent {
    /// Identity in the recording.
    pub id: u64,
    /// Type as known at the scene's time.
    pub agent_type: AgentType,
    /// Length; `None` if unknown.
    pub length_m: Option<f32>,
    /// States at the history steps, oldest first.
    pub history: Vec<Option<State>>,
    /// Positions at the forecast steps.
    pub future: Vec<Option<Point>>,
}

/// A recording at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Time of the newest history step.
    pub stamp_ns: i64,
    /// All agents that are present at this time.
    pub agents: Vec<Agent>,
}

/// How scenes are cut from a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Steps of the history, T_h.
    pub history_len: usize,
    /// Steps of the forecast, T_f.
    pub horizon_len: usize,
    /// Spacing of the steps, Δt.
    pub dt_s: f64,
    /// Whether velocities and headings come from positions even if the recording has its own.
    pub from_positions: bool,
}

impl Agent {
    /// Whether the agent is present at every step of history and forecast.
    pub fn is_complete(&self) -> bool {
        self.history.iter().all(Option::is_some) && self.future.iter().all(Option::is_some)
    }

    /// The newest state.
    pub fn newest(&self) -> Option<State> {
        *self.history.last()?
    }
}

impl Scene {
    /// Places of the agents that can count: those present from the first history step to the last forecast
    /// step.
    pub fn complete(&self) -> Vec<usize> {
        (0..self.agents.len()).filter(|&agent| self.agents[agent].is_complete()).collect()
    }
}

impl Cut {
    /// The steps of a model, with recorded motion.
    #[must_use]
    pub fn of(config: &ModelConfig) -> Self {
        Self {
            history_len: config.history_len,
            horizon_len: config.horizon_len,
            dt_s: config.dt_s,
            from_positions: false,
        }
    }

    /// The spacing of the steps in nanoseconds.
    pub fn step_ns(&self) -> i64 {
        (self.dt_s * 1e9).round() as i64
    }

    /// The scenes of a recording, one step apart and in time order.
    ///
    /// If the recording has velocity and heading of an agent at every time up to the scene, the scene uses
    /// them. Otherwise they are backward differences between the scene's own steps, and the first step copies
    /// the second. So a scene never depends on data before its history.
    #[must_use]
    pub fn scenes(&self, recording: &Recording) -> Vec<Scene> {
        let options = WindowOptions {
            from_positions: self.from_positions,
            ..WindowOptions::new(self.history_len, self.horizon_len, self.step_ns())
        };
        let scene = |window: &Window| Scene {
            stamp_ns: window.stamp_ns,
            agents: window.agents.iter().map(|agent| self.agent(agent)).collect(),
        };
        data::windows(recording, &options).iter().map(scene).collect()
    }

    fn agent(&self, agent: &WindowAgent) -> Agent {
        let Reported { agent_type, length_m, has_speed, has_heading, .. } = agent.reported;
        let history = if has_speed && has_heading && !self.from_positions {
            agent.history.clone()
        } else {
            let positions: Vec<_> =
                agent.history.iter().map(|state| state.map(|state| state.position_m)).collect();
            let mut states = vec![None; positions.len()];
            scene::states_from_positions(&positions, positions.len(), self.dt_s as f32, &mut states);
            states
        };
        Agent {
            id: agent.id,
            agent_type,
            length_m: (length_m > 0.0).then_some(length_m),
            history,
            future: agent.future.clone(),
        }
    }
}
