//! Agents and scenes as the network sees them in a training step.

use std::sync::Arc;

use nn::ModelConfig;
use scene::{AgentFrame, State};

use crate::net::motion::Start;
use crate::samples::{Agent, MapView};

/// One agent as the network sees it in a training step, possibly with a shortened history.
#[derive(Clone, Debug)]
pub(crate) struct AgentView {
    pub(crate) agent: Arc<Agent>,
    pub(crate) history: Vec<Option<State>>,
    pub(crate) future: Vec<Option<State>>,
    pub(crate) frame: AgentFrame,
    /// Whether the loss counts the agent.
    pub(crate) counts: bool,
}

impl AgentView {
    /// Recorded positions of the forecast steps in the agent frame.
    pub(crate) fn truth(&self) -> impl Iterator<Item = Option<[f32; 2]>> + '_ {
        self.future.iter().map(|state| state.map(|state| in_frame(&self.frame, state.position_m)))
    }
}

/// A world position in an agent frame.
fn in_frame(frame: &AgentFrame, position_m: [f32; 2]) -> [f32; 2] {
    frame.rotate_into([0, 1].map(|axis| position_m[axis] - frame.origin_m[axis]))
}

/// Agents of one scene at one time.
#[derive(Clone, Debug)]
pub(crate) struct SceneView<'a> {
    pub(crate) agents: Vec<AgentView>,
    /// The map patches; `None` if the scene is shown without a map.
    pub(crate) map: Option<MapView<'a>>,
    /// Whether left and right are swapped.
    pub(crate) mirrored: bool,
}

/// State at the end of the history, in the agent frame.
pub(crate) fn start(
    agent: &Agent,
    history: &[Option<State>],
    frame: &AgentFrame,
    config: &ModelConfig,
) -> Start {
    let motion = nn::motion_options(config);
    let rear_axle_m = motion.rear_axle_m(agent.length_m);
    let newest = history.last().copied().flatten().unwrap_or_default();
    let along = AgentFrame::new(newest.position_m, newest.heading_rad);
    let [speed_mps, _] = along.rotate_into(newest.velocity_mps);
    let turn_rates_radps = scene::turn_rates(history, config.dt_s as f32);
    let slip_rad = motion.start_slip_rad(rear_axle_m, speed_mps, turn_rates_radps);
    Start {
        velocity_mps: frame.rotate_into(newest.velocity_mps),
        heading_rad: kinematics::wrap_angle(newest.heading_rad - frame.heading_rad),
        speed_mps,
        slip_rad,
        rear_axle_m,
    }
}
