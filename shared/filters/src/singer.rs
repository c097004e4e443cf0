use nalgebra::{Matrix6, Vector5, Vector6};

use crate::{Bicycle, Control, ControlStep, Gaussian, Innovation, Observation, Process, Steered, wrapped};

/// Rows of the state.
const HEADING: usize = 2;
const SPEED: usize = 3;
const SLIP: usize = 4;
const ACCELERATION: usize = 5;

/// \[x, y, ψ, v, β, a\]: a [`Bicycle`] that knows its acceleration, which dies away towards the one that is meant.
///
/// ```text
/// ȧ = −(a − u) / τ + w
/// ```
///
/// u is the acceleration of a control, 0 without one; w keeps the deviation of a − u at σ. Without a control it is Singer's
/// model of a manoeuvring target \[R. Singer: *Estimating optimal tracking filter performance for manned maneuvering
/// targets*, 1970\]. A new forecast finds the acceleration as it was estimated, however often it comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingerBicycle {
    /// Geometry and noise besides; its white acceleration comes on top.
    pub bicycle: Bicycle,
    /// Deviation σ of the acceleration from what is meant.
    pub acceleration_mps2: f64,
    /// Time τ in which that dies away to 1/e.
    pub decay_s: f64,
}

impl SingerBicycle {
    /// A bicycle's state with an acceleration about 0.
    #[must_use]
    pub fn of(&self, state: &Gaussian<5>) -> Gaussian<6> {
        let mut mean = Vector6::zeros();
        mean.fixed_rows_mut::<5>(0).copy_from(&state.mean);
        let mut covariance = Matrix6::zeros();
        covariance.fixed_view_mut::<5, 5>(0, 0).copy_from(&state.covariance);
        covariance[(ACCELERATION, ACCELERATION)] = self.acceleration_mps2.powi(2);
        Gaussian { mean, covariance }
    }

    /// The bicycle's state.
    #[must_use]
    pub fn bicycle_of(state: &Gaussian<6>) -> Gaussian<5> {
        Gaussian {
            mean: state.mean.fixed_rows::<5>(0).into_owned(),
            covariance: state.covariance.fixed_view::<5, 5>(0, 0).into_owned(),
        }
    }

    /// The mean after `dt_s` under a control, and its derivative by the mean before.
    fn moved(&self, mean: &Vector6<f64>, rate: [f64; 2], dt_s: f64) -> (Vector6<f64>, Matrix6<f64>) {
        let [meant, slip_rate] = rate;
        let kept = (-dt_s / self.decay_s).exp();
        // Share of the acceleration's deviation in its mean over the step.
        let share = (1.0 - kept) * self.decay_s / dt_s;
        let acting = meant + share * (mean[ACCELERATION] - meant);
        let planar: Vector5<f64> = mean.fixed_rows::<5>(0).into_owned();
        let moved = self.bicycle.moved(&planar, [acting, slip_rate], &self.bicycle.over(dt_s));
        let mut next = Vector6::zeros();
        next.fixed_rows_mut::<5>(0).copy_from(&moved.next);
        next[ACCELERATION] = meant + kept * (mean[ACCELERATION] - meant);
        let mut by_state = Matrix6::zeros();
        by_state.fixed_view_mut::<5, 5>(0, 0).copy_from(&moved.by_state);
        by_state.fixed_view_mut::<5, 1>(0, ACCELERATION).copy_from(&(moved.by_control.column(0) * share));
        by_state[(ACCELERATION, ACCELERATION)] = kept;
        (next, by_state)
    }
}

impl Process<6> for SingerBicycle {
    const ANGLES: &'static [usize] = &[HEADING];

    fn step(&self, state: &Gaussian<6>, dt_s: f64) -> Gaussian<6> {
        self.steer(state, &Control::default(), dt_s)
    }

    fn innovation(&self, mean: &Vector6<f64>, seen: &Observation) -> Innovation<6> {
        seen.against_polar(mean)
    }

    fn settle(&self, mean: &mut Vector6<f64>) {
        mean[HEADING] = wrapped(mean[HEADING]);
        let slip_max_rad = self.bicycle.slip_max_rad;
        mean[SLIP] = wrapped(mean[SLIP]).clamp(-slip_max_rad, slip_max_rad);
    }
}

impl Steered<6> for SingerBicycle {
    fn steer(&self, state: &Gaussian<6>, control: &Control, dt_s: f64) -> Gaussian<6> {
        let (mean, by_state) = self.moved(&state.mean, control.rate, dt_s);
        let (of_bicycle, cross) =
            self.bicycle.noise(&Self::bicycle_of(state), control, &self.bicycle.over(dt_s));
        let mut noise = Vector6::zeros();
        noise.fixed_rows_mut::<5>(0).copy_from(&of_bicycle);
        noise[ACCELERATION] = self.acceleration_mps2.powi(2) * (1.0 - (-2.0 * dt_s / self.decay_s).exp());
        let mut covariance = state.propagated(&by_state, &noise);
        covariance[(SPEED, SLIP)] += cross;
        covariance[(SLIP, SPEED)] += cross;
        Gaussian { mean, covariance }
    }

    fn control(steps: &[ControlStep], number: usize, step_s: f64, heading_rad: f64) -> Control {
        Bicycle::control(steps, number, step_s, heading_rad)
    }

    fn first_ns(step_ns: u64) -> u64 {
        Bicycle::first_ns(step_ns)
    }
}

#[cfg(test)]
mod tests {
    use kinematics::Integrator;

    use super::*;

    const SINGER: SingerBicycle = SingerBicycle {
        bicycle: Bicycle {
            rear_axle_m: 1.2,
            integrator: Integrator::Midpoint,
            acceleration_mps2: 0.0,
            slip_rate_radps: 0.1,
            slip_decay_per_s: 0.0,
            floor: [0.0; 5],
            slip_max_rad: 0.5,
        },
        acceleration_mps2: 1.0,
        decay_s: 2.0,
    };

    #[test]
    fn jacobian_agrees_with_differences() {
        let mean = Vector6::new(3.0, -2.0, 0.4, 8.0, 0.05, 1.5);
        let (_, jacobian) = SINGER.moved(&mean, [-0.5, 0.1], 0.08);
        for column in 0..6 {
            let at = |step: f64| {
                let mut mean = mean;
                mean[column] += step;
                SINGER.moved(&mean, [-0.5, 0.1], 0.08).0
            };
            let by_difference = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!((by_difference - jacobian.column(column)).amax() < 1e-8, "column {column}");
        }
    }

    #[test]
    fn acceleration_dies_away_towards_what_is_meant() {
        let mut state = SINGER.of(&Gaussian::new([0.0, 0.0, 0.0, 10.0, 0.0], [1e-4; 5]));
        state.mean[ACCELERATION] = 3.0;
        let control = Control { rate: [-1.0, 0.0], density: [0.0; 3] };
        for _ in 0..100 {
            state = SINGER.steer(&state, &control, 0.08);
        }
        let (elapsed_s, kept) = (8.0_f64, (-4.0_f64).exp());
        assert!((state.mean[ACCELERATION] - (-1.0 + 4.0 * kept)).abs() < 1e-9);
        // v = 10 − t + 4 τ (1 − e^(−t/τ))
        let speed_mps = 10.0 - elapsed_s + 4.0 * SINGER.decay_s * (1.0 - kept);
        assert!((state.mean[SPEED] - speed_mps).abs() < 1e-9);
        assert!((state.covariance[(ACCELERATION, ACCELERATION)] - 1.0).abs() < 1e-9);
    }

    /// A vehicle that brakes steadily, measured ten times a second: its acceleration is found.
    #[test]
    fn steady_braking_is_found_from_positions() {
        let mut state = SINGER.of(&Gaussian::new([0.0, 0.0, 0.0, 12.0, 0.0], [1e-2, 1e-2, 1e-2, 1.0, 1e-3]));
        for tick in 1..=30 {
            let t_s = 0.1 * f64::from(tick);
            state.predict(100_000_000, &SINGER).unwrap();
            let seen = Observation {
                position_m: [12.0 * t_s - t_s * t_s, 0.0],
                position_variance: 1e-4,
                heading_rad: None,
                speed_mps: None,
            };
            state.update(&seen, &SINGER).unwrap();
        }
        assert!((state.mean[ACCELERATION] + 2.0).abs() < 0.3, "{}", state.mean[ACCELERATION]);
        assert!((state.mean[SPEED] - 6.0).abs() < 0.1, "{}", state.mean[SPEED]);
    }
}
