use nalgebra::{SMatrix, SVector, Vector2};

use crate::{Bicycle, Control, ControlStep, Gaussian, Innovation, Observation, Process, Steered, wrapped};

/// Rows of the state.
const HEADING: usize = 2;
const SLIP: usize = 4;
const ACCELERATION: usize = 5;
const SLIP_RATE: usize = 6;

/// \[x, y, ψ, v, β, a, β̇\]: a [`Bicycle`] that knows its acceleration and its slip rate, which die away towards those that
/// are meant.
///
/// ```text
/// ȧ = −(a − u₁) / τ + w₁      β̈ = −(β̇ − u₂) / τ + w₂
/// ```
///
/// u is a control, 0 without one; w keeps the deviations of a − u₁ and β̇ − u₂ at their σ, and where the control itself is
/// unsure at what its covariance adds to that. Without a control it is Singer's
/// model of a manoeuvring target \[R. Singer: *Estimating optimal tracking filter performance for manned maneuvering
/// targets*, 1970\], along the path and across it: neither the wheels nor the steering jump. A new forecast finds both as they
/// were estimated, however often it comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingerBicycle {
    /// Geometry and noise besides; its white acceleration and slip rate come on top.
    pub bicycle: Bicycle,
    /// Deviation σ of the acceleration from what is meant.
    pub acceleration_mps2: f64,
    /// Deviation σ of the slip rate from what is meant.
    pub slip_rate_radps: f64,
    /// Times τ in which these two die away to 1/e.
    pub decay_s: [f64; 2],
}

impl SingerBicycle {
    /// A bicycle's state with an acceleration and a slip rate about 0.
    #[must_use]
    pub fn of(&self, state: &Gaussian<5>) -> Gaussian<7> {
        let mut mean = SVector::<f64, 7>::zeros();
        mean.fixed_rows_mut::<5>(0).copy_from(&state.mean);
        let mut covariance = SMatrix::<f64, 7, 7>::zeros();
        covariance.fixed_view_mut::<5, 5>(0, 0).copy_from(&state.covariance);
        covariance[(ACCELERATION, ACCELERATION)] = self.acceleration_mps2.powi(2);
        covariance[(SLIP_RATE, SLIP_RATE)] = self.slip_rate_radps.powi(2);
        Gaussian { mean, covariance }
    }

    /// The bicycle's state.
    #[must_use]
    pub fn bicycle_of(state: &Gaussian<7>) -> Gaussian<5> {
        Gaussian {
            mean: state.mean.fixed_rows::<5>(0).into_owned(),
            covariance: state.covariance.fixed_view::<5, 5>(0, 0).into_owned(),
        }
    }

    /// The mean after `dt_s` under a control, and its derivative by the mean before.
    fn moved(
        &self,
        mean: &SVector<f64, 7>,
        meant: [f64; 2],
        dt_s: f64,
    ) -> (SVector<f64, 7>, SMatrix<f64, 7, 7>) {
        let meant = Vector2::from(meant);
        let deviation = mean.fixed_rows::<2>(ACCELERATION) - meant;
        let kept = self.decay_s.map(|decay_s| (-dt_s / decay_s).exp());
        // Share of a deviation in its mean over the step.
        let share = [0, 1].map(|of| (1.0 - kept[of]) * self.decay_s[of] / dt_s);
        let acting = meant + deviation.component_mul(&Vector2::from(share));
        let planar: SVector<f64, 5> = mean.fixed_rows::<5>(0).into_owned();
        let moved = self.bicycle.moved(&planar, acting.into(), &self.bicycle.over(dt_s));
        let mut next = SVector::<f64, 7>::zeros();
        next.fixed_rows_mut::<5>(0).copy_from(&moved.next);
        next.fixed_rows_mut::<2>(ACCELERATION)
            .copy_from(&(meant + deviation.component_mul(&Vector2::from(kept))));
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
        self.steer(state, &Control::default(), dt_s)
    }

    fn innovation(&self, mean: &SVector<f64, 7>, seen: &Observation) -> Innovation<7> {
        seen.against_polar(mean)
    }

    fn settle(&self, mean: &mut SVector<f64, 7>) {
        mean[HEADING] = wrapped(mean[HEADING]);
        let slip_max_rad = self.bicycle.slip_max_rad;
        mean[SLIP] = wrapped(mean[SLIP]).clamp(-slip_max_rad, slip_max_rad);
    }
}

impl Steered<7> for SingerBicycle {
    fn steer(&self, state: &Gaussian<7>, control: &Control, dt_s: f64) -> Gaussian<7> {
        let (mean, mut by_state) = self.moved(&state.mean, control.rate, dt_s);
        let planar = Self::bicycle_of(state);
        if planar.covariance[(SLIP, SLIP)] >= self.bicycle.slip_max_rad.powi(2) {
            by_state[(SLIP, SLIP_RATE)] = 0.0;
        }
        let (of_bicycle, _) = self.bicycle.noise(&planar, &Control::default(), &self.bicycle.over(dt_s));
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

    /// Between the two in the rates at which deviations die away and in the densities σ² / τ of what drives them: where
    /// nothing acts it is `unsteered` itself.
    fn beside(&self, unsteered: &Self, acting_share: [f64; 2]) -> Self {
        let sigma = |process: &Self| [process.acceleration_mps2, process.slip_rate_radps];
        let [of_acceleration, of_slip_rate] = [0, 1].map(|of| {
            let mix = |ours: f64, theirs: f64| theirs + acting_share[of] * (ours - theirs);
            let decay_s = 1.0 / mix(1.0 / self.decay_s[of], 1.0 / unsteered.decay_s[of]);
            let density = |process: &Self| sigma(process)[of].powi(2) / process.decay_s[of];
            ((mix(density(self), density(unsteered)) * decay_s).max(0.0).sqrt(), decay_s)
        });
        Self {
            acceleration_mps2: of_acceleration.0,
            slip_rate_radps: of_slip_rate.0,
            decay_s: [of_acceleration.1, of_slip_rate.1],
            ..*self
        }
    }

    /// The density is here the covariance of the control itself: it widens what the deviations from it are held at.
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
    use kinematics::Integrator;
    use nalgebra::Matrix2;

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
    fn jacobian_agrees_with_differences() {
        let mean = SVector::from([3.0, -2.0, 0.4, 8.0, 0.05, 1.5, -0.03]);
        let (_, jacobian) = SINGER.moved(&mean, [-0.5, 0.1], 0.08);
        for column in 0..7 {
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
        let speed_mps = 10.0 - elapsed_s + 4.0 * SINGER.decay_s[0] * (1.0 - kept);
        assert!((state.mean[SPEED] - speed_mps).abs() < 1e-9);
        assert!((state.covariance[(ACCELERATION, ACCELERATION)] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn slip_rate_dies_away_towards_what_is_meant() {
        let mut state = SINGER.of(&Gaussian::new([0.0, 0.0, 0.0, 0.0, 0.0], [1e-4; 5]));
        state.mean[SLIP_RATE] = 0.05;
        let control = Control { rate: [0.0, -0.02], density: [0.0; 3] };
        for _ in 0..100 {
            state = SINGER.steer(&state, &control, 0.08);
        }
        let kept = (-4.0_f64).exp();
        assert!((state.mean[SLIP_RATE] - (-0.02 + 0.07 * kept)).abs() < 1e-9);
        // β = −0.02 t + 0.07 τ (1 − e^(−t/τ))
        assert!((state.mean[SLIP] - (-0.16 + 0.07 * SINGER.decay_s[1] * (1.0 - kept))).abs() < 1e-9);
        assert!((state.covariance[(SLIP_RATE, SLIP_RATE)] - 0.01).abs() < 1e-9);
    }

    /// Between two processes rates and densities are mixed component by component; at both ends it is one of the two.
    #[test]
    fn a_share_of_the_controls_leaves_the_rest_to_the_process_beside() {
        let calm =
            SingerBicycle { acceleration_mps2: 0.5, slip_rate_radps: 0.2, decay_s: [0.5, 4.0], ..SINGER };
        let near = |found: &SingerBicycle, meant: &SingerBicycle| {
            let numbers = |of: &SingerBicycle| {
                SVector::from([of.acceleration_mps2, of.slip_rate_radps, of.decay_s[0], of.decay_s[1]])
            };
            (numbers(found) - numbers(meant)).amax() < 1e-12
        };
        assert!(near(&calm.beside(&SINGER, [0.0; 2]), &SINGER));
        assert!(near(&calm.beside(&SINGER, [1.0; 2]), &calm));
        // Rates 0.5 and 2 meet at 0.875 per s; densities 1 / 2 and 0.25 / 0.5 are the same.
        let quarter = SingerBicycle {
            acceleration_mps2: (0.5_f64 / 0.875).sqrt(),
            decay_s: [1.0 / 0.875, 2.0],
            ..SINGER
        };
        assert!(near(&calm.beside(&SINGER, [0.25, 0.0]), &quarter));
    }

    /// Where a control is unsure, what is driven by it deviates the more.
    #[test]
    fn covariance_of_a_control_widens_the_deviations() {
        let step = ControlStep { mean: [0.0; 2], cholesky: [2.0, 0.06, 0.08] };
        let control = SingerBicycle::control(&[step], 0, 0.4, 0.0);
        let mut state = SINGER.of(&Gaussian::new([0.0, 0.0, 0.0, 10.0, 0.0], [1e-4; 5]));
        for _ in 0..1_000 {
            state = SINGER.steer(&state, &control, 0.02);
        }
        let deviations = state.covariance.fixed_view::<2, 2>(ACCELERATION, ACCELERATION).into_owned();
        let meant = Matrix2::new(1.0 + 4.0, 0.12, 0.12, 0.01 + 0.0036 + 0.0064);
        assert!((deviations - meant).amax() < 1e-6, "{deviations}");
    }

    /// At rest nothing observes the slip.
    #[test]
    fn slip_of_a_vehicle_at_rest_stays_bounded() {
        let mut state = SINGER.of(&Gaussian::new([0.0; 5], [1e-4; 5]));
        let seen =
            Observation { position_m: [0.0; 2], position_variance: 1e-4, heading_rad: None, speed_mps: None };
        for _ in 0..5_000 {
            state.predict(100_000_000, &SINGER).unwrap();
            state.update(&seen, &SINGER).unwrap();
        }
        let sigma_rad = state.covariance[(SLIP, SLIP)].sqrt();
        assert!((0.4..0.6).contains(&sigma_rad) && state.is_finite(), "{sigma_rad}");
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
