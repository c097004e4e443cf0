//! The controls that lead through a recorded future: the targets of the base control's fit. \[model §4\]
//!
//! For cyclists and pedestrians they are the displacements themselves, m. For vehicles they are the controls
//! before saturation that lead the bicycle through the recorded positions. Levenberg-Marquardt finds them
//! from zero control. A weak penalty on the controls prevents noise of the positions from becoming steering.

use kinematics::{BicycleState, Motion, Vehicle};
use nalgebra::{DMatrix, DVector, SMatrix, Vector2};
use nn::ModelConfig;

use crate::net::motion::Start;

/// Controls of a forecast, (first, second) of every step.
pub(crate) type Controls = Vec<[f32; 2]>;

const ITERATIONS: usize = 30;
/// Ratio of the squared deviations of positions and controls: 0.03 m to 0.5 m/s² and to 0.15 rad/s.
const PULL: [f32; 2] = [0.0036, 0.04];

/// Displacements of every step relative to constant velocity that lead through `positions` (agent frame).
pub(crate) fn displacements(velocity_mps: [f32; 2], positions: &[[f32; 2]], dt_s: f32) -> Controls {
    let before = std::iter::once(&[0.0; 2]).chain(positions);
    let pairs = positions.iter().zip(before);
    pairs.map(|(p, b)| [0, 1].map(|axis| p[axis] - b[axis] - velocity_mps[axis] * dt_s)).collect()
}

/// Positions (agent frame) after these displacements relative to constant velocity.
pub(crate) fn displaced(velocity_mps: [f32; 2], controls: &[[f32; 2]], dt_s: f32) -> Vec<[f32; 2]> {
    let steps = controls.iter().scan([0.0; 2], |position: &mut [f32; 2], control| {
        *position = [0, 1].map(|axis| position[axis] + velocity_mps[axis] * dt_s + control[axis]);
        Some(*position)
    });
    steps.collect()
}

/// A vehicle with its initial state.
pub(crate) struct Driver {
    vehicle: Vehicle,
    start: BicycleState<f32>,
}

impl Driver {
    pub(crate) fn new(start: &Start, config: &ModelConfig) -> Self {
        let (vehicle, start) = start.bicycle(config);
        Self { vehicle, start }
    }

    /// Positions (agent frame) under controls before saturation.
    pub(crate) fn positions(&self, controls: &[[f32; 2]]) -> Vec<[f32; 2]> {
        let steps = controls.iter().scan(self.start, |state, control| {
            let (acting, _) = self.vehicle.saturate(&Vector2::from(*control));
            *state = self.vehicle.step(state, &acting);
            Some([state[0], state[1]])
        });
        steps.collect()
    }

    /// The controls before saturation whose positions are nearest to `truth` (agent frame).
    pub(crate) fn controls(&self, truth: &[[f32; 2]]) -> Controls {
        let mut controls = vec![[0.0; 2]; truth.len()];
        let mut cost = self.cost(&controls, truth);
        let mut damping = 1e-3;
        for _ in 0..ITERATIONS {
            let Some(step) = self.step(&controls, truth, damping) else { break };
            let tried: Controls = controls
                .iter()
                .enumerate()
                .map(|(k, c)| [c[0] + step[2 * k], c[1] + step[2 * k + 1]])
                .collect();
            let tried_cost = self.cost(&tried, truth);
            if tried_cost < cost {
                let converged = cost - tried_cost < 1e-5 * cost;
                (controls, cost) = (tried, tried_cost);
                damping *= 0.2;
                if converged {
                    break;
                }
            } else {
                damping *= 10.0;
            }
        }
        controls
    }

    fn cost(&self, controls: &[[f32; 2]], truth: &[[f32; 2]]) -> f32 {
        let missed: f32 = self.positions(controls).iter().zip(truth).map(|(a, b)| squared(*a, *b)).sum();
        missed + controls.iter().map(|c| PULL[0] * c[0] * c[0] + PULL[1] * c[1] * c[1]).sum::<f32>()
    }

    /// The damped Gauss-Newton step.
    fn step(&self, controls: &[[f32; 2]], truth: &[[f32; 2]], damping: f32) -> Option<DVector<f32>> {
        let unknowns = 2 * controls.len();
        let mut jacobian = DMatrix::<f32>::zeros(unknowns, unknowns);
        let mut missed = DVector::<f32>::zeros(unknowns);
        // Derivative of the state by every earlier control.
        let mut sensitivity: Vec<SMatrix<f32, 5, 2>> = Vec::with_capacity(controls.len());
        let mut state = self.start;
        for (k, control) in controls.iter().enumerate() {
            let (acting, slope) = self.vehicle.saturate(&Vector2::from(*control));
            let linear = self.vehicle.linearise(&state, &acting);
            sensitivity.iter_mut().for_each(|by_control| *by_control = linear.by_state * *by_control);
            sensitivity.push(linear.by_control * SMatrix::<f32, 2, 2>::from_diagonal(&slope));
            state = linear.next;
            for axis in 0..2 {
                missed[2 * k + axis] = truth[k][axis] - state[axis];
                for (earlier, by_control) in sensitivity.iter().enumerate() {
                    jacobian[(2 * k + axis, 2 * earlier)] = by_control[(axis, 0)];
                    jacobian[(2 * k + axis, 2 * earlier + 1)] = by_control[(axis, 1)];
                }
            }
        }
        let mut normal = jacobian.tr_mul(&jacobian);
        let mut gradient = jacobian.tr_mul(&missed);
        for (unknown, value) in controls.iter().flatten().enumerate() {
            normal[(unknown, unknown)] += PULL[unknown % 2] + damping;
            gradient[unknown] -= PULL[unknown % 2] * value;
        }
        Some(normal.cholesky()?.solve(&gradient))
    }
}

fn squared(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> ModelConfig {
        crate::options::onboard_config()
    }

    #[test]
    fn controls_of_a_bicycle_track_are_recovered() {
        let start =
            Start { heading_rad: 0.1, speed_mps: 8.0, slip_rad: 0.05, rear_axle_m: 1.2, ..Start::default() };
        let driver = Driver::new(&start, &config());
        let driven: Controls = (0..12).map(|k| [1.0 - 0.2 * k as f32, 0.03 - 0.006 * k as f32]).collect();
        let truth = driver.positions(&driven);
        let found = driver.positions(&driver.controls(&truth));
        let worst = found.iter().zip(&truth).map(|(a, b)| squared(*a, *b).sqrt()).fold(0.0, f32::max);
        assert!(worst < 0.05, "the controls found miss the track by {worst} m");
    }

    #[test]
    fn displacements_lead_through_the_positions() {
        let positions = [[1.0, 0.5], [2.5, 0.25], [3.0, 0.0]];
        let controls = displacements([2.0, 0.1], &positions, 0.4);
        for (a, b) in displaced([2.0, 0.1], &controls, 0.4).iter().zip(&positions) {
            assert!(squared(*a, *b) < 1e-10);
        }
    }
}
