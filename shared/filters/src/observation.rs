use nalgebra::SVector;

use crate::{Innovation, wrapped};

/// Largest number of observations in one joint update. At most one of them is an observation of the agent.
pub const OBSERVATIONS_MAX: usize = 5;

/// The measurement of an agent's motion by a detection. Each optional value comes with its variance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Position (x, y) in the world frame.
    pub position_m: [f64; 2],
    /// Variance of the position per axis, the mean over all directions.
    pub position_variance: f64,
    /// What the errors have more along x than on average, and their covariance (xy); zeros if they are equal in
    /// all directions.
    pub elongation: [f64; 2],
    /// Heading.
    pub heading_rad: Option<(f64, f64)>,
    /// Speed along the heading.
    pub speed_mps: Option<(f64, f64)>,
}

impl Observation {
    /// A position alone, with equal errors in all directions.
    pub const fn of_position(position_m: [f64; 2], position_variance: f64) -> Self {
        Self { position_m, position_variance, elongation: [0.0; 2], heading_rad: None, speed_mps: None }
    }

    /// The velocity in the world frame and its variance per axis, if both heading and speed were observed.
    pub fn velocity_mps(&self) -> Option<([f64; 2], f64)> {
        let ((heading, _), (speed, variance)) = self.heading_rad.zip(self.speed_mps)?;
        let (sin, cos) = heading.sin_cos();
        Some(([speed * cos, speed * sin], variance))
    }

    /// The innovation relative to a state that begins with x, y, vx, vy.
    ///
    /// Heading and speed together measure the velocity. A single one of them is ignored: a pedestrian may
    /// face away from its direction of motion, and at rest neither has a derivative.
    #[must_use]
    pub fn against_cartesian<const N: usize>(&self, mean: &SVector<f64, N>) -> Innovation<N> {
        let mut innovation = self.position_against(mean);
        if let Some(([vx, vy], variance)) = self.velocity_mps() {
            innovation.set(2, vx - mean[2], variance);
            innovation.set(3, vy - mean[3], variance);
        }
        innovation
    }

    /// The innovation relative to a state that begins with x, y, ψ, v.
    #[must_use]
    pub fn against_polar<const N: usize>(&self, mean: &SVector<f64, N>) -> Innovation<N> {
        let mut innovation = self.position_against(mean);
        if let Some((heading, variance)) = self.heading_rad {
            innovation.set(2, wrapped(heading - mean[2]), variance);
        }
        if let Some((speed, variance)) = self.speed_mps {
            innovation.set(3, speed - mean[3], variance);
        }
        innovation
    }

    fn position_against<const N: usize>(&self, mean: &SVector<f64, N>) -> Innovation<N> {
        let [x, y] = self.position_m;
        let residual = [x - mean[0], y - mean[1]];
        match self.elongation {
            [0.0, 0.0] => Innovation::of_position(residual, self.position_variance),
            _ => Innovation::of_elongated(residual, self.position_covariance()),
        }
    }

    /// Covariance of the position as (xx, xy, yy).
    #[must_use]
    pub fn position_covariance(&self) -> [f64; 3] {
        let (mean, [along, across]) = (self.position_variance, self.elongation);
        [mean + along, across, mean - along]
    }
}

/// An agent's motion, regardless of the kind of its filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Position (x, y) in the world frame.
    pub position_m: [f64; 2],
    /// Velocity (vx, vy) in the world frame.
    pub velocity_mps: [f64; 2],
    /// Heading, if the state has one.
    pub heading_rad: Option<f64>,
    /// Speed along the heading, or along the course if the state has no heading.
    pub speed_mps: f64,
    /// Slip angle; 0 if the state has none.
    pub slip_rad: f64,
}
