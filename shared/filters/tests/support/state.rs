//! Shared code for tests of states and their updates.

use filters::{ConstantVelocity, Gaussian, Observation};
use nalgebra::SMatrix;

/// The constant velocity of a pedestrian.
pub const PEDESTRIAN: ConstantVelocity = ConstantVelocity { density: 0.5 };

/// An observation of a position alone.
pub fn at(x: f64, y: f64, sigma_m: f64) -> Observation {
    Observation::of_position([x, y], sigma_m.powi(2))
}

/// Whether a covariance is exactly symmetric, and positive definite once its components are normalised.
pub fn is_sound<const N: usize>(state: &Gaussian<N>) -> bool {
    let p = state.covariance;
    let scaled = SMatrix::<f64, N, N>::from_fn(|i, j| p[(i, j)] / (p[(i, i)] * p[(j, j)]).sqrt());
    let eased = scaled + SMatrix::<f64, N, N>::identity() * 1e-9;
    p == p.transpose() && state.is_finite() && eased.cholesky().is_some()
}
