use nalgebra::{Matrix4, Vector4};

use crate::{Gaussian, Innovation, Observation, Process};

/// \[x, y, vx, vy\] under white acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantVelocity {
    /// Spectral density q of the acceleration per axis, m²/s³.
    pub density: f64,
}

impl Process<4> for ConstantVelocity {
    const ANGLES: &'static [usize] = &[];

    /// ```text
    /// p' = p + v Δt      v' = v      Q = q [Δt³/3  Δt²/2; Δt²/2  Δt] per axis
    /// ```
    fn step(&self, state: &Gaussian<4>, dt_s: f64) -> Gaussian<4> {
        let density = self.density;
        let mut transition = Matrix4::identity();
        transition[(0, 2)] = dt_s;
        transition[(1, 3)] = dt_s;
        let (position, cross, velocity) =
            (density * dt_s.powi(3) / 3.0, density * dt_s.powi(2) / 2.0, density * dt_s);
        let diagonal = Vector4::new(position, position, velocity, velocity);
        let mut covariance = state.propagated(&transition, &diagonal);
        for (p, v) in [(0, 2), (1, 3)] {
            covariance[(p, v)] += cross;
            covariance[(v, p)] += cross;
        }
        Gaussian { mean: transition * state.mean, covariance }
    }

    fn innovation(&self, mean: &Vector4<f64>, seen: &Observation) -> Innovation<4> {
        seen.against_cartesian(mean)
    }

    fn settle(&self, _: &mut Vector4<f64>) {}
}
