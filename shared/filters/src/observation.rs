/// What a detection tells of an agent's motion. Each optional value comes with its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Position (x, y) in the world frame.
    pub position_m: [f64; 2],
    /// Variance of the position per axis.
    pub position_variance: f64,
    /// Heading.
    pub heading_rad: Option<(f64, f64)>,
    /// Speed along the heading.
    pub speed_mps: Option<(f64, f64)>,
}

impl Observation {
    /// The velocity in the world frame and its variance per axis, where heading and speed were observed both.
    #[must_use]
    pub fn velocity_mps(&self) -> Option<([f64; 2], f64)> {
        let ((heading, _), (speed, variance)) = self.heading_rad.zip(self.speed_mps)?;
        let (sin, cos) = heading.sin_cos();
        Some(([speed * cos, speed * sin], variance))
    }
}

/// An agent's motion as the rest of the pipeline wants it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Position (x, y) in the world frame.
    pub position_m: [f64; 2],
    /// Velocity (vx, vy) in the world frame.
    pub velocity_mps: [f64; 2],
    /// Heading, where the state has one.
    pub heading_rad: Option<f64>,
    /// Speed along the heading, or along the course where the state has no heading.
    pub speed_mps: f64,
    /// Slip angle, 0 where the state has none.
    pub slip_rad: f64,
}
