use nalgebra::{Matrix5, Vector5};

use crate::constant_acceleration::chain_noise;
use crate::{Gaussian, Innovation, Observation, Process, wrapped};

/// Rows of the state.
const HEADING: usize = 2;
const SPEED: usize = 3;
const TURN_RATE: usize = 4;
/// Half turn below which the series of sin h / h is exact to the last digit.
const HALF_TURN_SMALL: f64 = 1e-3;

/// \[x, y, ψ, v, ω\]: constant turn rate and velocity, under white acceleration and yaw acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantTurnRate {
    /// Spectral density of the acceleration along the heading, m²/s³.
    pub acceleration_density: f64,
    /// Spectral density of the yaw acceleration, rad²/s³.
    pub yaw_density: f64,
}

impl ConstantTurnRate {
    /// The state after `dt_s` without noise, and its derivative with respect to the previous state.
    ///
    /// The agent moves along an arc. With the half turn h = ω Δt / 2, the chord of the arc has the length v
    /// Δt sin h / h and the direction ψ + h. The same formula holds for a straight course:
    ///
    /// ```text
    /// x' = x + v Δt sinc h cos(ψ + h)      ψ' = ψ + ω Δt
    /// y' = y + v Δt sinc h sin(ψ + h)      v' = v      ω' = ω
    /// ```
    #[must_use]
    pub fn arc(state: &Vector5<f64>, dt_s: f64) -> (Vector5<f64>, Matrix5<f64>) {
        let (speed, turn_rate) = (state[SPEED], state[TURN_RATE]);
        let half_turn = turn_rate * dt_s / 2.0;
        let (sinc, slope) = sinc(half_turn);
        let (sin, cos) = (state[HEADING] + half_turn).sin_cos();
        let chord = speed * dt_s * sinc;

        let mut next = *state;
        next[0] += chord * cos;
        next[1] += chord * sin;
        next[HEADING] += turn_rate * dt_s;

        let mut jacobian = Matrix5::identity();
        jacobian[(0, HEADING)] = -chord * sin;
        jacobian[(1, HEADING)] = chord * cos;
        jacobian[(0, SPEED)] = dt_s * sinc * cos;
        jacobian[(1, SPEED)] = dt_s * sinc * sin;
        let (longer, half_dt_s) = (speed * dt_s * slope, dt_s / 2.0);
        jacobian[(0, TURN_RATE)] = (longer * cos - chord * sin) * half_dt_s;
        jacobian[(1, TURN_RATE)] = (longer * sin + chord * cos) * half_dt_s;
        jacobian[(HEADING, TURN_RATE)] = dt_s;
        (next, jacobian)
    }

    /// The covariance that a step's noise adds, to first order about a straight course along (cos, sin). The
    /// acceleration integrates to speed and distance. The yaw acceleration integrates to turn rate and
    /// heading, and, multiplied by the speed, to lateral distance.
    fn noise(&self, speed: f64, (sin, cos): (f64, f64), dt_s: f64) -> Matrix5<f64> {
        let density = self.acceleration_density;
        let mut body = Matrix5::zeros();
        body[(0, 0)] = density * dt_s.powi(3) / 3.0;
        body[(0, SPEED)] = density * dt_s.powi(2) / 2.0;
        body[(SPEED, 0)] = body[(0, SPEED)];
        body[(SPEED, SPEED)] = density * dt_s;
        let scale = [speed, 1.0, 1.0];
        let across = [1, HEADING, TURN_RATE];
        for (i, of_row) in chain_noise(self.yaw_density, dt_s).into_iter().enumerate() {
            for (j, value) in of_row.into_iter().enumerate() {
                body[(across[i], across[j])] = scale[i] * scale[j] * value;
            }
        }
        let mut world_from_body = Matrix5::identity();
        world_from_body[(0, 0)] = cos;
        world_from_body[(0, 1)] = -sin;
        world_from_body[(1, 0)] = sin;
        world_from_body[(1, 1)] = cos;
        world_from_body * body * world_from_body.transpose()
    }
}

impl Process<5> for ConstantTurnRate {
    const ANGLES: &'static [usize] = &[HEADING];

    fn step(&self, state: &Gaussian<5>, dt_s: f64) -> Gaussian<5> {
        let (mut mean, jacobian) = Self::arc(&state.mean, dt_s);
        let course = (state.mean[HEADING] + state.mean[TURN_RATE] * dt_s / 2.0).sin_cos();
        let mut moved = state.transformed(mean, &jacobian);
        let noise = self.noise(state.mean[SPEED], course, dt_s);
        moved.covariance += (noise + noise.transpose()) * 0.5;
        mean[HEADING] = wrapped(mean[HEADING]);
        Gaussian { mean, ..moved }
    }

    fn innovation(&self, mean: &Vector5<f64>, observation: &Observation) -> Innovation<5> {
        observation.against_polar(mean)
    }

    fn constrain(&self, mean: &mut Vector5<f64>) {
        mean[HEADING] = wrapped(mean[HEADING]);
    }
}

/// sin h / h and its derivative.
fn sinc(h: f64) -> (f64, f64) {
    if h.abs() < HALF_TURN_SMALL {
        let square = h * h;
        return (1.0 - square / 6.0 + square * square / 120.0, h * (square / 30.0 - 1.0 / 3.0));
    }
    let (sin, cos) = h.sin_cos();
    let value = sin / h;
    (value, (cos - value) / h)
}
