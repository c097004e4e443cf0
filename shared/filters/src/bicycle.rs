use kinematics::Integrator;
use nalgebra::{Matrix5, Vector2, Vector5};

use crate::{FilterFault, Gaussian, Innovation, Observation, STEP_MAX_S, steps, wrapped};

/// Rows of the state.
const X: usize = 0;
const Y: usize = 1;
const HEADING: usize = 2;
const SPEED: usize = 3;
const SLIP: usize = 4;

/// Noise and geometry of the bicycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BicycleModel {
    /// From the reference point to the rear axle, l_r.
    pub rear_axle_m: f64,
    /// Standard deviation of the acceleration over a step of 80 ms; shorter steps keep its spectral density.
    pub acceleration_mps2: f64,
    /// Standard deviation of the slip rate over a step of 80 ms.
    pub slip_rate_radps: f64,
    /// Variances of \[x, y, ψ, v, β\] added in 80 ms: without them a position gets no noise in one step.
    pub floor: [f64; 5],
    /// Largest magnitude of the mean slip; also bounds the spread that the slip gathers at rest, where nothing observes it.
    pub slip_max_rad: f64,
}

/// Extended Kalman filter over \[x, y, ψ, v, β\]: position, heading, speed along the heading, slip angle.
///
/// The process is [`kinematics::Bicycle`] under white acceleration and slip rate, in Euler steps \[paper, Eq.
/// discretesystem\]; the Jacobian is taken at the mean before the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bicycle {
    /// Mean and covariance.
    pub state: Gaussian<5>,
}

impl Bicycle {
    /// Independent components with the given means and variances.
    #[must_use]
    pub fn new(mean: [f64; 5], variance: [f64; 5]) -> Self {
        let state =
            Gaussian { mean: mean.into(), covariance: Matrix5::from_diagonal(&Vector5::from(variance)) };
        Self { state }
    }

    /// Moves the state on by `dt_ns`, in steps of at most 80 ms.
    ///
    /// # Errors
    /// [`FilterFault::NotFinite`]; the state is then as before.
    pub fn predict(&mut self, dt_ns: u64, model: &BicycleModel) -> Result<(), FilterFault> {
        let (steps_len, dt_s) = steps(dt_ns);
        let mut state = self.state;
        for _ in 0..steps_len {
            state = step(&state, dt_s, model);
        }
        if !state.is_finite() {
            return Err(FilterFault::NotFinite);
        }
        self.state = state;
        Ok(())
    }

    /// Corrects the state by a position and what else was observed; returns the normalised innovation squared.
    ///
    /// # Errors
    /// [`FilterFault`]; the state is then as before.
    pub fn update(&mut self, seen: &Observation, slip_max_rad: f64) -> Result<f64, FilterFault> {
        let mean = &self.state.mean;
        let (dx, dy) = (seen.position_m[0] - mean[X], seen.position_m[1] - mean[Y]);
        let var = seen.position_variance;
        let turn = seen.heading_rad.map(|(value, variance)| (wrapped(value - mean[HEADING]), variance));
        let speed = seen.speed_mps.map(|(value, variance)| (value - mean[SPEED], variance));
        let (mut posterior, nis) = match (turn, speed) {
            (None, None) => {
                self.state.corrected(&Innovation { rows: [X, Y], residual: [dx, dy], variance: [var, var] })
            }
            (Some((dh, var_h)), None) => self.state.corrected(&Innovation {
                rows: [X, Y, HEADING],
                residual: [dx, dy, dh],
                variance: [var, var, var_h],
            }),
            (None, Some((dv, var_v))) => self.state.corrected(&Innovation {
                rows: [X, Y, SPEED],
                residual: [dx, dy, dv],
                variance: [var, var, var_v],
            }),
            (Some((dh, var_h)), Some((dv, var_v))) => self.state.corrected(&Innovation {
                rows: [X, Y, HEADING, SPEED],
                residual: [dx, dy, dh, dv],
                variance: [var, var, var_h, var_v],
            }),
        }?;
        posterior.mean[HEADING] = wrapped(posterior.mean[HEADING]);
        posterior.mean[SLIP] = wrapped(posterior.mean[SLIP]).clamp(-slip_max_rad, slip_max_rad);
        self.state = posterior;
        Ok(nis)
    }

    /// Exchanges front and back: the same motion, told from the other end.
    ///
    /// (ψ, v, β) becomes (ψ + π + 2β, −v, −β): course, velocity and yaw rate stay as they are, and the covariance
    /// turns with the Jacobian of that change.
    pub fn turn_round(&mut self) {
        let mut mean = self.state.mean;
        mean[HEADING] = wrapped(mean[HEADING] + std::f64::consts::PI + 2.0 * mean[SLIP]);
        mean[SPEED] = -mean[SPEED];
        mean[SLIP] = -mean[SLIP];
        let mut jacobian = Matrix5::identity();
        jacobian[(HEADING, SLIP)] = 2.0;
        jacobian[(SPEED, SPEED)] = -1.0;
        jacobian[(SLIP, SLIP)] = -1.0;
        self.state = self.state.transformed(mean, &jacobian);
    }
}

fn step(state: &Gaussian<5>, dt_s: f64, model: &BicycleModel) -> Gaussian<5> {
    let bicycle = kinematics::Bicycle {
        rear_axle_m: model.rear_axle_m,
        slip_limit_rad: None,
        integrator: Integrator::Euler,
    };
    let moved = bicycle.linearise(&state.mean, &Vector2::zeros(), dt_s);
    let mut mean = moved.next;
    mean[HEADING] = wrapped(mean[HEADING]);

    let mut noise = Vector5::from(model.floor) * (dt_s / STEP_MAX_S);
    noise[SPEED] += model.acceleration_mps2.powi(2) * dt_s * STEP_MAX_S;
    if state.covariance[(SLIP, SLIP)] < model.slip_max_rad.powi(2) {
        noise[SLIP] += model.slip_rate_radps.powi(2) * dt_s * STEP_MAX_S;
    }
    Gaussian { mean, covariance: state.propagated(&moved.by_state, &noise) }
}
