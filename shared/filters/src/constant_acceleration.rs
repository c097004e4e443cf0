use nalgebra::{Matrix6, Vector6};

use crate::{Gaussian, Innovation, Observation, Process};

/// \[x, y, vx, vy, ax, ay\] under white jerk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantAcceleration {
    /// Spectral density q of the jerk per axis, m²/s⁵.
    pub density: f64,
}

impl ConstantAcceleration {
    /// A state \[x, y, vx, vy\], extended by an acceleration of mean 0 and this standard deviation per axis.
    pub fn of(state: &Gaussian<4>, sigma_mps2: f64) -> Gaussian<6> {
        let mut extended = Gaussian::new([0.0; 6], [sigma_mps2.powi(2); 6]);
        extended.mean.fixed_rows_mut::<4>(0).copy_from(&state.mean);
        extended.covariance.fixed_view_mut::<4, 4>(0, 0).copy_from(&state.covariance);
        extended
    }

    /// The components \[x, y, vx, vy\] of a state.
    pub fn cartesian(state: &Gaussian<6>) -> Gaussian<4> {
        Gaussian {
            mean: state.mean.fixed_rows::<4>(0).into_owned(),
            covariance: state.covariance.fixed_view::<4, 4>(0, 0).into_owned(),
        }
    }
}

impl Process<6> for ConstantAcceleration {
    const ANGLES: &'static [usize] = &[];

    /// ```text
    /// p' = p + v Δt + a Δt²/2      v' = v + a Δt      a' = a
    /// Q = q [Δt⁵/20  Δt⁴/8  Δt³/6; Δt⁴/8  Δt³/3  Δt²/2; Δt³/6  Δt²/2  Δt] per axis
    /// ```
    fn step(&self, state: &Gaussian<6>, dt_s: f64) -> Gaussian<6> {
        let mut transition = Matrix6::identity();
        let mut noise = Matrix6::zeros();
        let of_chain = chain_noise(self.density, dt_s);
        for axis in 0..2 {
            let chain = [axis, 2 + axis, 4 + axis];
            transition[(chain[0], chain[1])] = dt_s;
            transition[(chain[1], chain[2])] = dt_s;
            transition[(chain[0], chain[2])] = dt_s.powi(2) / 2.0;
            for (row, of_row) in chain.into_iter().zip(of_chain) {
                for (column, value) in chain.into_iter().zip(of_row) {
                    noise[(row, column)] = value;
                }
            }
        }
        let covariance = state.propagated(&transition, &Vector6::zeros()) + noise;
        Gaussian { mean: transition * state.mean, covariance }
    }

    fn innovation(&self, mean: &Vector6<f64>, observation: &Observation) -> Innovation<6> {
        observation.against_cartesian(mean)
    }

    fn constrain(&self, _: &mut Vector6<f64>) {}
}

/// The covariance that white jerk of spectral density q causes in `dt_s`, for position, velocity and
/// acceleration along one axis. It holds for any chain of three integrators with white noise at the input.
#[must_use]
pub fn chain_noise(density: f64, dt_s: f64) -> [[f64; 3]; 3] {
    let of = |power: i32, divisor: f64| density * dt_s.powi(power) / divisor;
    [
        [of(5, 20.0), of(4, 8.0), of(3, 6.0)],
        [of(4, 8.0), of(3, 3.0), of(2, 2.0)],
        [of(3, 6.0), of(2, 2.0), of(1, 1.0)],
    ]
}
