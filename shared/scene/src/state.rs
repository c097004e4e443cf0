/// The kinematic state of an agent at one time, in the world frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Position (x, y).
    pub position_m: [f32; 2],
    /// Velocity (vx, vy).
    pub velocity_mps: [f32; 2],
    /// Heading, counter-clockwise from +x; defined also at rest.
    pub heading_rad: f32,
}
