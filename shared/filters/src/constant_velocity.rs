use nalgebra::{Matrix4, Vector4};

use crate::{FilterFault, Gaussian, Innovation, Observation, steps};

/// Kalman filter over \[x, y, vx, vy\] with white acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantVelocity {
    /// Mean and covariance.
    pub state: Gaussian<4>,
}

impl ConstantVelocity {
    /// Independent components with the given means and variances.
    #[must_use]
    pub fn new(mean: [f64; 4], variance: [f64; 4]) -> Self {
        let state =
            Gaussian { mean: mean.into(), covariance: Matrix4::from_diagonal(&Vector4::from(variance)) };
        Self { state }
    }

    /// Moves the state on by `dt_ns`, in steps of at most 80 ms.
    ///
    /// `density` is the spectral density q of the acceleration per axis, m²/s³.
    ///
    /// # Errors
    /// [`FilterFault::NotFinite`]; the state is then as before.
    pub fn predict(&mut self, dt_ns: u64, density: f64) -> Result<(), FilterFault> {
        let (steps_len, dt_s) = steps(dt_ns);
        let mut state = self.state;
        for _ in 0..steps_len {
            state = step(&state, dt_s, density);
        }
        if !state.is_finite() {
            return Err(FilterFault::NotFinite);
        }
        self.state = state;
        Ok(())
    }

    /// Corrects the state by a position and, where heading and speed were observed both, by the velocity; returns
    /// the normalised innovation squared.
    ///
    /// # Errors
    /// [`FilterFault`]; the state is then as before.
    pub fn update(&mut self, seen: &Observation) -> Result<f64, FilterFault> {
        let mean = &self.state.mean;
        let (dx, dy) = (seen.position_m[0] - mean[0], seen.position_m[1] - mean[1]);
        let var = seen.position_variance;
        let (posterior, nis) = match seen.velocity_mps() {
            None => {
                self.state.corrected(&Innovation { rows: [0, 1], residual: [dx, dy], variance: [var, var] })
            }
            Some(([vx, vy], var_v)) => self.state.corrected(&Innovation {
                rows: [0, 1, 2, 3],
                residual: [dx, dy, vx - mean[2], vy - mean[3]],
                variance: [var, var, var_v, var_v],
            }),
        }?;
        self.state = posterior;
        Ok(nis)
    }
}

fn step(state: &Gaussian<4>, dt_s: f64, density: f64) -> Gaussian<4> {
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
