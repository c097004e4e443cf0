//! State features s and relation features φ: the network's inputs for one agent and for a pair of agents.
//!
//! Both are relative. s is relative to the *agent frame* (the agent's own pose at its last observed step),
//! and φ to the receiver's pose at the same step. Moving or turning the whole scene changes neither.

use wire::{RELATION_FEATURES, STATE_FEATURES};

use crate::State;

/// Speed in m/s below which an agent counts as at rest and its direction of motion as undefined.
pub const MOVING_MPS: f32 = 0.1;

/// Factors that bring features to similar magnitudes. A factor of 1 leaves them in metres and metres per
/// second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureScales {
    /// Factor of positions.
    pub position: f32,
    /// Factor of velocities.
    pub velocity: f32,
}

impl Default for FeatureScales {
    fn default() -> Self {
        Self { position: 1.0, velocity: 1.0 }
    }
}

/// A frame of reference in the plane: an origin and the direction of the x-axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AgentFrame {
    /// Origin in the world frame.
    pub origin_m: [f32; 2],
    /// Direction of the x-axis in the world frame.
    pub heading_rad: f32,
    cos: f32,
    sin: f32,
}

impl AgentFrame {
    /// The frame at `origin_m` whose x-axis points along `heading_rad`.
    #[must_use]
    pub fn new(origin_m: [f32; 2], heading_rad: f32) -> Self {
        let (sin, cos) = heading_rad.sin_cos();
        Self { origin_m, heading_rad, cos, sin }
    }

    /// Rotates a vector from world axes to agent axes.
    #[must_use]
    pub fn rotate_into(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [self.cos * x + self.sin * y, self.cos * y - self.sin * x]
    }

    /// Rotates a vector from agent axes to world axes.
    #[must_use]
    pub fn rotate_out(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        [self.cos * x - self.sin * y, self.sin * x + self.cos * y]
    }
}

/// The frame of an agent's last observed step. Returns `None` if the agent has no state.
///
/// The x-axis points along the heading of this step. If the agent is at rest (below [`MOVING_MPS`]), its
/// heading is old or arbitrary. The x-axis then follows the mean velocity of the history, if that is fast
/// enough.
#[must_use]
pub fn agent_frame(history: &[Option<State>]) -> Option<AgentFrame> {
    let last = history.iter().rev().flatten().next()?;
    if last.speed_mps() >= MOVING_MPS {
        return Some(AgentFrame::new(last.position_m, last.heading_rad));
    }
    let (mut sum, mut len) = ([0.0_f32; 2], 0.0_f32);
    for state in history.iter().flatten() {
        sum = [sum[0] + state.velocity_mps[0], sum[1] + state.velocity_mps[1]];
        len += 1.0;
    }
    let moved = sum[0].hypot(sum[1]) > MOVING_MPS * len;
    let heading_rad = if moved { sum[1].atan2(sum[0]) } else { last.heading_rad };
    Some(AgentFrame::new(last.position_m, heading_rad))
}

/// State features \[x', y', vx', vy', cos Δψ, sin Δψ\] of an agent at one step, in its agent frame.
/// \[model §2\]
#[must_use]
pub fn state_features(frame: &AgentFrame, state: &State, scales: FeatureScales) -> [f32; STATE_FEATURES] {
    relative(frame, state.position_m, state.velocity_mps, state.heading_rad, scales)
}

/// Relation features \[Δx', Δy', Δvx', Δvy', cos Δψ, sin Δψ\] of an edge, in the receiver's pose. Δ is sender
/// minus receiver. The self edge has \[0, 0, 0, 0, 1, 0\]. \[model §2\]
#[must_use]
pub fn relation_features(
    receiver: &State,
    sender: &State,
    scales: FeatureScales,
) -> [f32; RELATION_FEATURES] {
    let frame = AgentFrame::new(receiver.position_m, receiver.heading_rad);
    let velocity_mps = [0, 1].map(|axis| sender.velocity_mps[axis] - receiver.velocity_mps[axis]);
    relative(&frame, sender.position_m, velocity_mps, sender.heading_rad, scales)
}

fn relative(
    frame: &AgentFrame,
    position_m: [f32; 2],
    velocity_mps: [f32; 2],
    heading_rad: f32,
    scales: FeatureScales,
) -> [f32; 6] {
    let offset_m = [0, 1].map(|axis| position_m[axis] - frame.origin_m[axis]);
    let [x, y] = frame.rotate_into(offset_m);
    let [vx, vy] = frame.rotate_into(velocity_mps);
    let (sin, cos) = (heading_rad - frame.heading_rad).sin_cos();
    [x * scales.position, y * scales.position, vx * scales.velocity, vy * scales.velocity, cos, sin]
}
