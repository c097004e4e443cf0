//! The Singer bicycle, the process of the learned prior and of its strongest rival.

use filters::{
    Bicycle, Control, ControlStep, Controlled, Gaussian, Innovation, Observation, Process, wrapped,
};
use nalgebra::{SMatrix, SVector, Vector2};

/// Rows of the state.
const HEADING: usize = 2;
const SLIP: usize = 4;
const ACCELERATION: usize = 5;
const SLIP_RATE: usize = 6;

/// \[x, y, ψ, v, β, a, β̇\]: a [`Bicycle`] whose acceleration and slip rate are states that decay towards the
/// control input.
///
/// ```text
/// ȧ = −(a − u₁) / τ + w₁      β̈ = −(β̇ − u₂) / τ + w₂
/// ```
///
/// u is the control (0 without a control). The noise w keeps the deviations a − u₁ and β̇ − u₂ at their
/// stationary σ. A control's own covariance adds to their variance.
///
/// Without a control this is Singer's model of a manoeuvring target \[R. Singer: *Estimating optimal tracking
/// filter performance for manned maneuvering targets*, 1970\], along and across the path: acceleration and
/// steering do not jump. A new forecast changes the control but not the estimated acceleration and slip rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SingerBicycle {
    /// Geometry and other noise. Its white acceleration and slip rate add to the ones here.
    pub bicycle: Bicycle,
    /// Stationary standard deviation σ of the difference between acceleration and control.
    pub acceleration_mps2: f64,
    /// Stationary standard deviation σ of the difference between slip rate and control.
    pub slip_rate_radps: f64,
    /// Times τ in which these two deviations decay to 1/e.
    pub decay_s: [f64; 2],
}

impl SingerBicycle {
    /// A bicycle's state, extended by an acceleration and a slip rate with mean 0.
    pub(crate) fn of(&self, state: &Gaussian<5>) -> Gaussian<7> {
        let mut mean = SVector::<f64, 7>::zeros();
        mean.fixed_rows_mut::<5>(0).copy_from(&state.mean);
        let mut covariance = SMatrix::<f64, 7, 7>::zeros();
        covariance.fixed_view_mut::<5, 5>(0, 0).copy_from(&state.covariance);
        covariance[(ACCELERATION, ACCELERATION)] = self.acceleration_mps2.powi(2);
        covariance[(SLIP_RATE, SLIP_RATE)] = self.slip_rate_radps.powi(2);
        Gaussian { mean, covariance }
    }

    /// The bicycle's state.
    pub(crate) fn bicycle_of(state: &Gaussian<7>) -> Gaussian<5> {
        Gaussian {
            mean: state.mean.fixed_rows::<5>(0).into_owned(),
            covariance: state.covariance.fixed_view::<5, 5>(0, 0).into_owned(),
        }
    }

    /// The mean after `dt_s` under a control, and its derivative with respect to the previous mean.
    fn linearised(
        &self,
        mean: &SVector<f64, 7>,
        control: [f64; 2],
        dt_s: f64,
    ) -> (SVector<f64, 7>, SMatrix<f64, 7, 7>) {
        let control = Vector2::from(control);
        let deviation = mean.fixed_rows::<2>(ACCELERATION) - control;
        let kept = self.decay_s.map(|decay_s| (-dt_s / decay_s).exp());
        // Mean of a deviation over the step, as a share of the deviation.
        let share = [0, 1].map(|of| (1.0 - kept[of]) * self.decay_s[of] / dt_s);
        let mean_rate = control + deviation.component_mul(&Vector2::from(share));
        let planar: SVector<f64, 5> = mean.fixed_rows::<5>(0).into_owned();
        let moved = self.bicycle.linearised(&planar, mean_rate.into(), &self.bicycle.step_of(dt_s));
        let mut next = SVector::<f64, 7>::zeros();
        next.fixed_rows_mut::<5>(0).copy_from(&moved.next);
        next.fixed_rows_mut::<2>(ACCELERATION)
            .copy_from(&(control + deviation.component_mul(&Vector2::from(kept))));
        let mut by_state = SMatrix::<f64, 7, 7>::zeros();
        by_state.fixed_view_mut::<5, 5>(0, 0).copy_from(&moved.by_state);
        by_state.fixed_view_mut::<5, 2>(0, ACCELERATION).copy_from(&moved.by_control);
        for (of, row) in [ACCELERATION, SLIP_RATE].into_iter().enumerate() {
            by_state.column_mut(row).scale_mut(share[of]);
            by_state[(row, row)] = kept[of];
        }
        (next, by_state)
    }
}

impl Process<7> for SingerBicycle {
    const ANGLES: &'static [usize] = &[HEADING];

    fn step(&self, state: &Gaussian<7>, dt_s: f64) -> Gaussian<7> {
        self.step_controlled(state, &Control::default(), dt_s)
    }

    fn innovation(&self, mean: &SVector<f64, 7>, observation: &Observation) -> Innovation<7> {
        observation.against_polar(mean)
    }

    fn constrain(&self, mean: &mut SVector<f64, 7>) {
        mean[HEADING] = wrapped(mean[HEADING]);
        let slip_max_rad = self.bicycle.slip_max_rad;
        mean[SLIP] = wrapped(mean[SLIP]).clamp(-slip_max_rad, slip_max_rad);
    }
}

impl Controlled<7> for SingerBicycle {
    fn step_controlled(&self, state: &Gaussian<7>, control: &Control, dt_s: f64) -> Gaussian<7> {
        let (mean, mut by_state) = self.linearised(&state.mean, control.rate, dt_s);
        let planar = Self::bicycle_of(state);
        if planar.covariance[(SLIP, SLIP)] >= self.bicycle.slip_max_rad.powi(2) {
            by_state[(SLIP, SLIP_RATE)] = 0.0;
        }
        let (of_bicycle, _) = self.bicycle.noise(&planar, &Control::default(), &self.bicycle.step_of(dt_s));
        let mut noise = SVector::<f64, 7>::zeros();
        noise.fixed_rows_mut::<5>(0).copy_from(&of_bicycle);
        let [of_acceleration, cross, of_slip_rate] = control.density;
        let lost = |rate_per_s: f64| -(-rate_per_s * dt_s).exp_m1();
        let [of_first, of_second] = self.decay_s.map(|decay_s| 1.0 / decay_s);
        noise[ACCELERATION] = (self.acceleration_mps2.powi(2) + of_acceleration) * lost(2.0 * of_first);
        noise[SLIP_RATE] = (self.slip_rate_radps.powi(2) + of_slip_rate) * lost(2.0 * of_second);
        let mut covariance = state.propagated(&by_state, &noise);
        let cross = cross * lost(of_first + of_second);
        covariance[(ACCELERATION, SLIP_RATE)] += cross;
        covariance[(SLIP_RATE, ACCELERATION)] += cross;
        Gaussian { mean, covariance }
    }

    /// Interpolates the decay rates 1 / τ and the spectral densities σ² / τ of the driving noise. At gain 0
    /// the result is `uncontrolled`.
    fn blended(&self, uncontrolled: &Self, control_gain: [f64; 2]) -> Self {
        let sigma = |process: &Self| [process.acceleration_mps2, process.slip_rate_radps];
        let [of_acceleration, of_slip_rate] = [0, 1].map(|of| {
            let mix = |ours: f64, theirs: f64| theirs + control_gain[of] * (ours - theirs);
            let decay_s = 1.0 / mix(1.0 / self.decay_s[of], 1.0 / uncontrolled.decay_s[of]);
            let density = |process: &Self| sigma(process)[of].powi(2) / process.decay_s[of];
            ((mix(density(self), density(uncontrolled)) * decay_s).max(0.0).sqrt(), decay_s)
        });
        Self {
            acceleration_mps2: of_acceleration.0,
            slip_rate_radps: of_slip_rate.0,
            decay_s: [of_acceleration.1, of_slip_rate.1],
            ..*self
        }
    }

    /// The density is the covariance of the control itself. It adds to the stationary variance of the
    /// deviations.
    fn control(steps: &[ControlStep], number: usize, _: f64, _: f64) -> Control {
        let step = steps.get(number).or(steps.last()).copied().unwrap_or_default();
        Control::new(step.mean, &step.covariance())
    }

    fn first_ns(step_ns: u64) -> u64 {
        Bicycle::first_ns(step_ns)
    }
}

#[cfg(test)]
mod tests {
    use filters::{Integrator, difference};
    use metrics::tracking::{Consistency, normalised_square};
    use nalgebra::Matrix2;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    const SPEED: usize = 3;

    const SINGER: SingerBicycle = SingerBicycle {
        bicycle: Bicycle {
            rear_axle_m: 1.2,
            integrator: Integrator::Midpoint,
            acceleration_mps2: 0.0,
            slip_rate_radps: 0.0,
            slip_decay_per_s: 0.0,
            floor: [0.0; 5],
            slip_max_rad: 0.5,
        },
        acceleration_mps2: 1.0,
        slip_rate_radps: 0.1,
        decay_s: [2.0; 2],
    };

    #[test]
    fn jacobian_equals_finite_differences() {
        let mean = SVector::from([3.0, -2.0, 0.4, 8.0, 0.05, 1.5, -0.03]);
        let (_, jacobian) = SINGER.linearised(&mean, [-0.5, 0.1], 0.08);
        for column in 0..7 {
            let at = |step: f64| {
                let mut mean = mean;
                mean[column] += step;
                SINGER.linearised(&mean, [-0.5, 0.1], 0.08).0
            };
            let by_difference = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!((by_difference - jacobian.column(column)).amax() < 1e-8, "column {column}");
        }
    }

    #[test]
    fn acceleration_decays_towards_the_control() {
        let mut state = SINGER.of(&Gaussian::new([0.0, 0.0, 0.0, 10.0, 0.0], [1e-4; 5]));
        state.mean[ACCELERATION] = 3.0;
        let control = Control { rate: [-1.0, 0.0], density: [0.0; 3] };
        for _ in 0..100 {
            state = SINGER.step_controlled(&state, &control, 0.08);
        }
        let (elapsed_s, kept) = (8.0_f64, (-4.0_f64).exp());
        assert!((state.mean[ACCELERATION] - (-1.0 + 4.0 * kept)).abs() < 1e-9);
        // v = 10 − t + 4 τ (1 − e^(−t/τ))
        let speed_mps = 10.0 - elapsed_s + 4.0 * SINGER.decay_s[0] * (1.0 - kept);
        assert!((state.mean[SPEED] - speed_mps).abs() < 1e-9);
        assert!((state.covariance[(ACCELERATION, ACCELERATION)] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn slip_rate_decays_towards_the_control() {
        let mut state = SINGER.of(&Gaussian::new([0.0, 0.0, 0.0, 0.0, 0.0], [1e-4; 5]));
        state.mean[SLIP_RATE] = 0.05;
        let control = Control { rate: [0.0, -0.02], density: [0.0; 3] };
        for _ in 0..100 {
            state = SINGER.step_controlled(&state, &control, 0.08);
        }
        let kept = (-4.0_f64).exp();
        assert!((state.mean[SLIP_RATE] - (-0.02 + 0.07 * kept)).abs() < 1e-9);
        // β = −0.02 t + 0.07 τ (1 − e^(−t/τ))
        assert!((state.mean[SLIP] - (-0.16 + 0.07 * SINGER.decay_s[1] * (1.0 - kept))).abs() < 1e-9);
        assert!((state.covariance[(SLIP_RATE, SLIP_RATE)] - 0.01).abs() < 1e-9);
    }

    /// Rates and densities are interpolated component by component. Gains 0 and 1 give the two processes
    /// themselves.
    #[test]
    fn blending_interpolates_decay_rates_and_noise_densities() {
        let calm =
            SingerBicycle { acceleration_mps2: 0.5, slip_rate_radps: 0.2, decay_s: [0.5, 4.0], ..SINGER };
        let near = |found: &SingerBicycle, expected: &SingerBicycle| {
            let numbers = |of: &SingerBicycle| {
                SVector::from([of.acceleration_mps2, of.slip_rate_radps, of.decay_s[0], of.decay_s[1]])
            };
            (numbers(found) - numbers(expected)).amax() < 1e-12
        };
        assert!(near(&calm.blended(&SINGER, [0.0; 2]), &SINGER));
        assert!(near(&calm.blended(&SINGER, [1.0; 2]), &calm));
        // Rates 0.5 and 2 give 0.875 per s. Densities 1 / 2 and 0.25 / 0.5 are equal.
        let quarter = SingerBicycle {
            acceleration_mps2: (0.5_f64 / 0.875).sqrt(),
            decay_s: [1.0 / 0.875, 2.0],
            ..SINGER
        };
        assert!(near(&calm.blended(&SINGER, [0.25, 0.0]), &quarter));
    }

    #[test]
    fn control_covariance_adds_to_the_stationary_variance() {
        let step = ControlStep { mean: [0.0; 2], cholesky: [2.0, 0.06, 0.08] };
        let control = SingerBicycle::control(&[step], 0, 0.4, 0.0);
        let mut state = SINGER.of(&Gaussian::new([0.0, 0.0, 0.0, 10.0, 0.0], [1e-4; 5]));
        for _ in 0..1_000 {
            state = SINGER.step_controlled(&state, &control, 0.02);
        }
        let deviations = state.covariance.fixed_view::<2, 2>(ACCELERATION, ACCELERATION).into_owned();
        let expected = Matrix2::new(1.0 + 4.0, 0.12, 0.12, 0.01 + 0.0036 + 0.0064);
        assert!((deviations - expected).amax() < 1e-6, "{deviations}");
    }

    /// At rest the slip is unobservable.
    #[test]
    fn slip_sigma_of_a_vehicle_at_rest_stays_bounded() {
        let mut state = SINGER.of(&Gaussian::new([0.0; 5], [1e-4; 5]));
        let seen = Observation::of_position([0.0; 2], 1e-4);
        for _ in 0..5_000 {
            state.predict(100_000_000, &SINGER).unwrap();
            state.update(&seen, &SINGER).unwrap();
        }
        let sigma_rad = state.covariance[(SLIP, SLIP)].sqrt();
        assert!((0.4..0.6).contains(&sigma_rad) && state.is_finite(), "{sigma_rad}");
    }

    /// Covariances are consistent: the normalised squares of vehicles that move by the process are as large as
    /// their covariances predict.
    #[test]
    fn covariances_are_nearly_consistent() {
        const POSITION_M: f64 = 0.2;
        let process = SingerBicycle {
            bicycle: Bicycle {
                acceleration_mps2: 0.2,
                slip_rate_radps: 0.1,
                floor: [1e-4, 1e-4, 1e-5, 0.0, 0.0],
                ..SINGER.bicycle
            },
            acceleration_mps2: 1.5,
            slip_rate_radps: 0.03,
            ..SINGER
        };
        let start = process.of(&Gaussian::new([3.0, -1.0, 3.0, 8.0, 0.0], [0.04, 0.04, 0.01, 0.25, 1e-3]));
        for sigmas in [None, Some([0.1, 0.5])] {
            let mut squares = Consistency::default();
            for seed in 0..1_000 {
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
                let (mut truth, mut found) = (start.sample(&mut normal), start);
                for tick in 0..100 {
                    let certain = Gaussian { mean: truth, covariance: SMatrix::zeros() };
                    truth = process.step(&certain, 0.08).sample(&mut normal);
                    process.constrain(&mut truth);
                    found.predict(80_000_000, &process).unwrap();
                    let seen = Observation {
                        position_m: [0, 1].map(|axis| truth[axis] + POSITION_M * normal()),
                        position_variance: POSITION_M.powi(2),
                        elongation: [0.0; 2],
                        heading_rad: sigmas
                            .map(|[sigma, _]: [f64; 2]| (truth[HEADING] + sigma * normal(), sigma.powi(2))),
                        speed_mps: sigmas.map(|[_, sigma]| (truth[SPEED] + sigma * normal(), sigma.powi(2))),
                    };
                    found.update(&seen, &process).unwrap();
                    let error = difference(&truth, &found.mean, SingerBicycle::ANGLES);
                    squares.add(tick, normalised_square(&error, &found.covariance).unwrap(), 7).unwrap();
                }
            }
            let states = squares.summary(0.95).unwrap().unwrap();
            assert!(states.inside >= 0.9 && (0.9..=1.1).contains(&states.per_degree), "{states:?}");
        }
    }

    /// A vehicle that brakes steadily, measured at 10 Hz.
    #[test]
    fn steady_braking_is_estimated_from_positions() {
        let mut state = SINGER.of(&Gaussian::new([0.0, 0.0, 0.0, 12.0, 0.0], [1e-2, 1e-2, 1e-2, 1.0, 1e-3]));
        for tick in 1..=30 {
            let t_s = 0.1 * f64::from(tick);
            state.predict(100_000_000, &SINGER).unwrap();
            let seen = Observation::of_position([12.0 * t_s - t_s * t_s, 0.0], 1e-4);
            state.update(&seen, &SINGER).unwrap();
        }
        assert!((state.mean[ACCELERATION] + 2.0).abs() < 0.3, "{}", state.mean[ACCELERATION]);
        assert!((state.mean[SPEED] - 6.0).abs() < 0.1, "{}", state.mean[SPEED]);
    }
}
