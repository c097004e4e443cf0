use kinematics::{Integrator, Linearised};
use nalgebra::{Matrix5, Vector2, Vector5};

use crate::{
    Control, ControlStep, Controlled, Gaussian, Innovation, Observation, Process, STEP_MAX_S, wrapped,
};

/// Rows of the state.
const HEADING: usize = 2;
const SPEED: usize = 3;
const SLIP: usize = 4;

/// \[x, y, ψ, v, β\]: position, heading, speed along the heading, slip angle.
///
/// The process is [`kinematics::Bicycle`] under white acceleration and slip rate. The slip angle decays, so a
/// turn ends.
///
/// ```text
/// β̇ = −λ β + u + w      β' = β + s (u − λ β) Δt,  s = (1 − e^(−λ Δt)) / (λ Δt)
/// ```
///
/// u is the slip rate of a control (0 without a control), and w is the noise. The step from β to β' is exact.
/// Position and heading use the constant slip rate that leads from β to β', so [`Integrator::Midpoint`] takes
/// the mean of both slips. The Jacobian is evaluated at the mean before the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bicycle {
    /// From the reference point to the rear axle, l_r.
    pub rear_axle_m: f64,
    /// The point within a step at which the motion is evaluated. The paper uses Euler steps, which lag behind
    /// during acceleration.
    pub integrator: Integrator,
    /// Standard deviation of the acceleration over a step of 80 ms. Shorter steps keep its spectral density.
    pub acceleration_mps2: f64,
    /// Standard deviation of the slip rate over a step of 80 ms.
    pub slip_rate_radps: f64,
    /// Rate λ at which the slip angle decays; 0 for a constant slip.
    pub slip_decay_per_s: f64,
    /// Variances of \[x, y, ψ, v, β\] added in 80 ms. Without them a position gets no noise in one step.
    pub floor: [f64; 5],
    /// Largest magnitude of the mean slip. It also bounds the spread that the slip gains at rest, when it is
    /// unobservable.
    pub slip_max_rad: f64,
}

/// The length of a step of a [`Bicycle`] and the values derived from it.
#[derive(Clone, Copy, Debug)]
pub struct BicycleStep {
    dt_s: f64,
    /// s = (1 − e^(−λ Δt)) / (λ Δt), the mean over the step of a quantity that decays like the slip.
    slip_share: f64,
}

impl Bicycle {
    /// The same process without noise and decay.
    pub const fn noiseless(&self) -> Self {
        Self {
            integrator: Integrator::Midpoint,
            acceleration_mps2: 0.0,
            slip_rate_radps: 0.0,
            slip_decay_per_s: 0.0,
            floor: [0.0; 5],
            ..*self
        }
    }

    /// A step of this length.
    #[must_use]
    #[inline]
    pub fn step_of(&self, dt_s: f64) -> BicycleStep {
        BicycleStep { dt_s, slip_share: mean_decayed(self.slip_decay_per_s * dt_s) }
    }

    /// Variances that a step adds, and the covariance of speed and slip that it adds.
    #[must_use]
    #[inline]
    pub fn noise(&self, state: &Gaussian<5>, control: &Control, step: &BicycleStep) -> (Vector5<f64>, f64) {
        let &BicycleStep { dt_s, slip_share } = step;
        let [of_speed, cross, of_slip] = control.density;
        let mut noise = Vector5::from(self.floor) * (dt_s / STEP_MAX_S);
        noise[SPEED] += self.acceleration_mps2.powi(2) * dt_s * STEP_MAX_S + of_speed * dt_s;
        if state.covariance[(SLIP, SLIP)] >= self.slip_max_rad.powi(2) {
            return (noise, 0.0);
        }
        // Noise from early in the step has partly decayed at the end, and its variance decays twice as fast:
        // s at 2 λ is s (1 − s λ Δt / 2).
        let acting_s = dt_s * slip_share * (1.0 - slip_share * self.slip_decay_per_s * dt_s / 2.0);
        noise[SLIP] += self.slip_rate_radps.powi(2) * acting_s * STEP_MAX_S + of_slip * acting_s;
        (noise, cross * (dt_s * slip_share))
    }

    /// The mean after a step under a control, and its derivatives with respect to the previous mean and the
    /// control.
    #[must_use]
    #[inline]
    pub fn linearised(&self, mean: &Vector5<f64>, rate: [f64; 2], step: &BicycleStep) -> Linearised<f64, 5> {
        let [acceleration, slip_rate] = rate;
        let bicycle = kinematics::Bicycle {
            rear_axle_m: self.rear_axle_m,
            slip_limit_rad: None,
            integrator: self.integrator,
        };
        let acting = step.slip_share * (slip_rate - self.slip_decay_per_s * mean[SLIP]);
        let mut moved = bicycle.linearise(mean, &Vector2::new(acceleration, acting), step.dt_s);
        let by_rate = moved.by_control.column(1) * step.slip_share;
        moved.by_control.set_column(1, &by_rate);
        let by_slip = moved.by_state.column(SLIP) - by_rate * self.slip_decay_per_s;
        moved.by_state.set_column(SLIP, &by_slip);
        moved.next[HEADING] = wrapped(moved.next[HEADING]);
        moved
    }
}

impl Process<5> for Bicycle {
    const ANGLES: &'static [usize] = &[HEADING];

    fn step(&self, state: &Gaussian<5>, dt_s: f64) -> Gaussian<5> {
        self.step_controlled(state, &Control::default(), dt_s)
    }

    fn innovation(&self, mean: &Vector5<f64>, observation: &Observation) -> Innovation<5> {
        observation.against_polar(mean)
    }

    fn constrain(&self, mean: &mut Vector5<f64>) {
        mean[HEADING] = wrapped(mean[HEADING]);
        mean[SLIP] = wrapped(mean[SLIP]).clamp(-self.slip_max_rad, self.slip_max_rad);
    }
}

impl Controlled<5> for Bicycle {
    #[inline]
    fn step_controlled(&self, state: &Gaussian<5>, control: &Control, dt_s: f64) -> Gaussian<5> {
        let step = self.step_of(dt_s);
        let moved = self.linearised(&state.mean, control.rate, &step);
        let (noise, cross) = self.noise(state, control, &step);
        let mut covariance = state.propagated(&moved.by_state, &noise);
        covariance[(SPEED, SLIP)] += cross;
        covariance[(SLIP, SPEED)] += cross;
        Gaussian { mean: moved.next, covariance }
    }

    /// A control holds over its step. Its covariance refers to one draw per step; divided into shorter steps
    /// it keeps its spectral density.
    fn control(steps: &[ControlStep], number: usize, step_s: f64, _: f64) -> Control {
        let step = steps.get(number).or(steps.last()).copied().unwrap_or_default();
        Control::new(step.mean, &(step.covariance() * step_s))
    }

    fn first_ns(step_ns: u64) -> u64 {
        step_ns
    }
}

/// (1 − e^(−x)) / x, the mean over a time in which a quantity decays by the exponent x.
fn mean_decayed(exponent: f64) -> f64 {
    // Little decays in a tick. For small exponents these terms of the series, 1 / (n + 1)!, are exact to the
    // last digit.
    const TERMS: [f64; 7] = [1.0, 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0, 1.0 / 5040.0];
    if exponent.abs() < 0.02 {
        TERMS.iter().rfold(0.0, |sum, term| term - exponent * sum)
    } else {
        -(-exponent).exp_m1() / exponent
    }
}

/// The same motion of a bicycle with front and rear exchanged.
///
/// (ψ, v, β) becomes (ψ + π + 2β, −v, −β). Course, velocity and yaw rate remain unchanged. The covariance is
/// transformed by the Jacobian of the exchange.
#[must_use]
pub fn reversed(state: &Gaussian<5>) -> Gaussian<5> {
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

#[cfg(test)]
mod tests {
    use nalgebra::Matrix5x2;

    use super::*;

    const DECAYING: Bicycle = Bicycle {
        rear_axle_m: 1.2,
        integrator: Integrator::Midpoint,
        acceleration_mps2: 2.0,
        slip_rate_radps: 0.1,
        slip_decay_per_s: 0.8,
        floor: [0.0; 5],
        slip_max_rad: 0.5,
    };

    #[test]
    fn jacobians_equal_finite_differences() {
        let mean = Vector5::new(3.0, -2.0, 0.4, 8.0, 0.05);
        let rate = [-0.5, 0.1];
        for integrator in [Integrator::Euler, Integrator::Midpoint] {
            let bicycle = Bicycle { integrator, ..DECAYING };
            let step = bicycle.step_of(0.08);
            let moved = bicycle.linearised(&mean, rate, &step);
            let difference =
                |at: &dyn Fn(f64) -> Vector5<f64>| -> Vector5<f64> { (at(1e-5) - at(-1e-5)) / 2e-5 };
            let by_state = Matrix5::from_columns(&[0, 1, 2, 3, 4].map(|row| {
                difference(&|off| bicycle.linearised(&(mean + Vector5::ith(row, off)), rate, &step).next)
            }));
            let by_control = Matrix5x2::from_columns(&[[1.0, 0.0], [0.0, 1.0]].map(|[first, second]| {
                difference(&|off| {
                    bicycle.linearised(&mean, [rate[0] + first * off, rate[1] + second * off], &step).next
                })
            }));
            assert!((by_state - moved.by_state).amax() < 1e-8, "{integrator:?}: {by_state}");
            assert!((by_control - moved.by_control).amax() < 1e-8, "{integrator:?}: {by_control}");
        }
    }

    /// β = u/λ + (β_0 − u/λ) e^(−λt), and the variance moves from its initial to its stationary value.
    #[test]
    fn slip_decay_is_exact_in_steps_of_any_length() {
        let start = Gaussian::new([0.0, 0.0, 0.0, 0.0, 0.2], [0.0, 0.0, 0.0, 0.0, 1e-4]);
        let control = Control { rate: [0.0, 0.04], density: [0.0, 0.0, 1e-4] };
        let (elapsed_s, decay_per_s) = (2.4, DECAYING.slip_decay_per_s);
        let (stationary, left) = (0.04 / decay_per_s, (-decay_per_s * elapsed_s).exp());
        let settled = (0.1_f64.powi(2) * STEP_MAX_S + 1e-4) / (2.0 * decay_per_s);
        for step_count in [30, 48, 240] {
            let mut state = start;
            for _ in 0..step_count {
                state = DECAYING.step_controlled(&state, &control, elapsed_s / f64::from(step_count));
            }
            assert!(
                (state.mean[SLIP] - (stationary + (0.2 - stationary) * left)).abs() < 1e-12,
                "{step_count} steps"
            );
            let variance = settled + (1e-4 - settled) * left * left;
            assert!((state.covariance[(SLIP, SLIP)] - variance).abs() < 1e-12, "{step_count} steps");
        }
    }

    /// Steps of 80 ms turn the heading by the integral of the decaying slip.
    #[test]
    fn decaying_slip_ends_a_turn_at_the_integrated_heading() {
        let mut state = Gaussian::new([0.0, 0.0, 0.0, 9.0, 0.1], [1e-4; 5]);
        for _ in 0..500 {
            state = DECAYING.step(&state, STEP_MAX_S);
        }
        // ψ = v / l_r ∫ sin β dt, which is v / (l_r λ) Si(β_0).
        let sine_integral = 0.1 - 0.1_f64.powi(3) / 18.0;
        let heading_rad = 9.0 / (DECAYING.rear_axle_m * DECAYING.slip_decay_per_s) * sine_integral;
        assert!((state.mean[HEADING] - heading_rad).abs() < 1e-3, "{}", state.mean[HEADING]);
        assert!(state.mean[SLIP].abs() < 1e-9);
    }

    #[test]
    fn without_slip_decay_a_step_is_the_bicycle_to_the_bit() {
        let staying = Bicycle { slip_decay_per_s: 0.0, ..DECAYING };
        let mean = Vector5::new(3.0, -2.0, 0.4, 8.0, 0.05);
        let bicycle =
            kinematics::Bicycle { rear_axle_m: 1.2, slip_limit_rad: None, integrator: Integrator::Midpoint };
        let expected = bicycle.linearise(&mean, &Vector2::new(-0.5, 0.1), 0.08);
        let found = staying.linearised(&mean, [-0.5, 0.1], &staying.step_of(0.08));
        assert_eq!((found.next, found.by_state), (expected.next, expected.by_state));
        assert_eq!(found.by_control, expected.by_control);
    }
}
