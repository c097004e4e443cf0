use nalgebra::{SVector, Vector2};

use crate::{Linearised, Motion};

/// \[x, y, vx, vy\] in the world frame. The velocity is taken from the last observed step and stays constant.
pub type DisplacementState = SVector<f32, 4>;

/// The reference of a displacement control.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DisplacementKind {
    /// The displacement of the step beyond constant velocity.
    #[default]
    Residual,
    /// The whole displacement of the step, as in the paper.
    Absolute,
}

/// The motion of cyclists and pedestrians: p' = p + v Δt + R u, or p' = p + R u for absolute displacements.
/// The control u is in the agent frame of the last observed step. \[model §4\]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    kind: DisplacementKind,
    dt_s: f32,
    cos: f32,
    sin: f32,
}

impl Displacement {
    /// Displacements in the axes of an agent frame with heading `heading_rad`, in steps of `dt_s`.
    #[must_use]
    pub fn new(kind: DisplacementKind, heading_rad: f32, dt_s: f32) -> Self {
        let (sin, cos) = heading_rad.sin_cos();
        Self { kind, dt_s, cos, sin }
    }

    /// Direction of the agent frame's axes.
    pub fn heading_rad(&self) -> f32 {
        self.sin.atan2(self.cos)
    }

    /// A control as the displacement beyond an agent's velocity, in the agent frame.
    #[must_use]
    pub fn residual(&self, control: &Vector2<f32>, [vx_mps, vy_mps]: [f32; 2]) -> Vector2<f32> {
        let beyond_s = self.dt_s - self.carried_s();
        control - self.in_agent_frame(Vector2::new(vx_mps, vy_mps)) * beyond_s
    }

    /// Rotates a vector from the world frame to the agent frame.
    pub(crate) fn in_agent_frame(&self, world: Vector2<f32>) -> Vector2<f32> {
        Vector2::new(self.cos * world.x + self.sin * world.y, self.cos * world.y - self.sin * world.x)
    }

    fn carried_s(&self) -> f32 {
        match self.kind {
            DisplacementKind::Residual => self.dt_s,
            DisplacementKind::Absolute => 0.0,
        }
    }
}

impl Motion<4> for Displacement {
    fn saturate(&self, control: &Vector2<f32>) -> (Vector2<f32>, Vector2<f32>) {
        (*control, Vector2::new(1.0, 1.0))
    }

    fn step(&self, state: &DisplacementState, control: &Vector2<f32>) -> DisplacementState {
        let carried_s = self.carried_s();
        DisplacementState::new(
            state[0] + state[2] * carried_s + self.cos * control.x - self.sin * control.y,
            state[1] + state[3] * carried_s + self.sin * control.x + self.cos * control.y,
            state[2],
            state[3],
        )
    }

    fn linearise(&self, state: &DisplacementState, control: &Vector2<f32>) -> Linearised<f32, 4> {
        let mut by_state = nalgebra::Matrix4::identity();
        by_state[(0, 2)] = self.carried_s();
        by_state[(1, 3)] = self.carried_s();
        let mut by_control = nalgebra::Matrix4x2::zeros();
        by_control[(0, 0)] = self.cos;
        by_control[(0, 1)] = -self.sin;
        by_control[(1, 0)] = self.sin;
        by_control[(1, 1)] = self.cos;
        Linearised { next: self.step(state, control), by_state, by_control }
    }
}
