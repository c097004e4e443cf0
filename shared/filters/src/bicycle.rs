use kinematics::Integrator;
use nalgebra::{Matrix5, Vector2, Vector5};

use crate::{Control, ControlStep, Gaussian, Innovation, Observation, Process, STEP_MAX_S, Steered, wrapped};

/// Rows of the state.
const HEADING: usize = 2;
const SPEED: usize = 3;
const SLIP: usize = 4;

/// \[x, y, ψ, v, β\]: position, heading, speed along the heading, slip angle.
///
/// The process is [`kinematics::Bicycle`] under white acceleration and slip rate; the Jacobian is taken at the mean
/// before the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bicycle {
    /// From the reference point to the rear axle, l_r.
    pub rear_axle_m: f64,
    /// Where in a step the motion is taken. Euler's steps are the paper's; under an acceleration they fall behind.
    pub integrator: Integrator,
    /// Standard deviation of the acceleration over a step of 80 ms; shorter steps keep its spectral density.
    pub acceleration_mps2: f64,
    /// Standard deviation of the slip rate over a step of 80 ms.
    pub slip_rate_radps: f64,
    /// Variances of \[x, y, ψ, v, β\] added in 80 ms: without them a position gets no noise in one step.
    pub floor: [f64; 5],
    /// Largest magnitude of the mean slip; also bounds the spread that the slip gathers at rest, where nothing observes it.
    pub slip_max_rad: f64,
}

impl Bicycle {
    /// Variances that a step adds, and the covariance of speed and slip that it adds.
    pub(crate) fn noise(&self, state: &Gaussian<5>, control: &Control, dt_s: f64) -> (Vector5<f64>, f64) {
        let [of_speed, cross, of_slip] = control.density;
        let mut noise = Vector5::from(self.floor) * (dt_s / STEP_MAX_S);
        noise[SPEED] += self.acceleration_mps2.powi(2) * dt_s * STEP_MAX_S + of_speed * dt_s;
        if state.covariance[(SLIP, SLIP)] >= self.slip_max_rad.powi(2) {
            return (noise, 0.0);
        }
        noise[SLIP] += self.slip_rate_radps.powi(2) * dt_s * STEP_MAX_S + of_slip * dt_s;
        (noise, cross * dt_s)
    }
}

impl Process<5> for Bicycle {
    const ANGLES: &'static [usize] = &[HEADING];

    fn step(&self, state: &Gaussian<5>, dt_s: f64) -> Gaussian<5> {
        self.steer(state, &Control::default(), dt_s)
    }

    fn innovation(&self, mean: &Vector5<f64>, seen: &Observation) -> Innovation<5> {
        seen.against_polar(mean)
    }

    fn settle(&self, mean: &mut Vector5<f64>) {
        mean[HEADING] = wrapped(mean[HEADING]);
        mean[SLIP] = wrapped(mean[SLIP]).clamp(-self.slip_max_rad, self.slip_max_rad);
    }
}

impl Steered<5> for Bicycle {
    fn steer(&self, state: &Gaussian<5>, control: &Control, dt_s: f64) -> Gaussian<5> {
        let bicycle = kinematics::Bicycle {
            rear_axle_m: self.rear_axle_m,
            slip_limit_rad: None,
            integrator: self.integrator,
        };
        let moved = bicycle.linearise(&state.mean, &Vector2::from(control.rate), dt_s);
        let mut mean = moved.next;
        mean[HEADING] = wrapped(mean[HEADING]);

        let (noise, cross) = self.noise(state, control, dt_s);
        let mut covariance = state.propagated(&moved.by_state, &noise);
        covariance[(SPEED, SLIP)] += cross;
        covariance[(SLIP, SPEED)] += cross;
        Gaussian { mean, covariance }
    }

    /// A control holds over its step. Its covariance is that of one draw per step; spread over shorter steps it keeps
    /// its spectral density.
    fn control(steps: &[ControlStep], number: usize, step_s: f64, _: f64) -> Control {
        let step = steps.get(number).or(steps.last()).copied().unwrap_or_default();
        Control::new(step.mean, &(step.covariance() * step_s))
    }

    fn first_ns(step_ns: u64) -> u64 {
        step_ns
    }
}

/// The same motion of a bicycle, told from the other end: front and back exchanged.
///
/// (ψ, v, β) becomes (ψ + π + 2β, −v, −β): course, velocity and yaw rate stay as they are, and the covariance
/// turns with the Jacobian of that change.
#[must_use]
pub fn turned_round(state: &Gaussian<5>) -> Gaussian<5> {
    let mut mean = state.mean;
    mean[HEADING] = wrapped(mean[HEADING] + std::f64::consts::PI + 2.0 * mean[SLIP]);
    mean[SPEED] = -mean[SPEED];
    mean[SLIP] = -mean[SLIP];
    let mut jacobian = Matrix5::identity();
    jacobian[(HEADING, SLIP)] = 2.0;
    jacobian[(SPEED, SPEED)] = -1.0;
    jacobian[(SLIP, SLIP)] = -1.0;
    state.transformed(mean, &jacobian)
}
