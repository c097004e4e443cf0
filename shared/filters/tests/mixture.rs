//! The mixture against the plain filter, against the forecast motion, and under stress.

use filters::{
    Bicycle, ConstantVelocity, ControlStep, Controlled, FilterFault, Forecast, ForecastFault, Gaussian,
    Integrator, Mixture, Observation, Priors, wrapped,
};
use nalgebra::{Vector2, Vector5};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::support::bicycle::BICYCLE;
use crate::support::state::{PEDESTRIAN, at, is_sound};

const TICK_NS: u64 = 80_000_000;
const STEP_NS: u64 = 400_000_000;
const STEPS: usize = 12;

/// Like [`BICYCLE`] without process noise.
const NOISELESS: Bicycle =
    Bicycle { acceleration_mps2: 0.0, slip_rate_radps: 0.0, floor: [0.0; 5], ..BICYCLE };

/// Hypotheses of equal probability. Each has the same control in all its steps.
fn steady(controls: &[[f64; 2]], cholesky: [f64; 3]) -> (Vec<f64>, Vec<ControlStep>) {
    let steps = controls.iter().flat_map(|&mean| [ControlStep { mean, cholesky }; STEPS]);
    (vec![1.0; controls.len()], steps.collect())
}

fn forecast<'a>((probability, controls): &'a (Vec<f64>, Vec<ControlStep>)) -> Forecast<'a> {
    Forecast { age_ns: 0, step_ns: STEP_NS, heading_rad: 0.0, probability, controls }
}

#[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
fn assert_idle_hypothesis_is_the_filter<P: Controlled<N> + Copy, const N: usize>(
    process: P,
    start: Gaussian<N>,
) {
    let mut plain = start;
    let priors = Priors { kinematic_weight: 0.0, ..Priors::new(process, process) };
    let mut mixture = Mixture::new(start, priors, 1);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let idle = steady(&[[0.0; 2]], [0.0; 3]);
    for tick in 0..500_u32 {
        if tick % 25 == 0 {
            mixture.adopt(&forecast(&idle)).unwrap();
        }
        let dt_ns = rng.random_range(1_000_000..170_000_000);
        plain.predict(dt_ns, &process).unwrap();
        mixture.predict(dt_ns).unwrap();
        assert!(mixture.is_learned());
        if tick % 3 != 0 {
            let observed = Observation {
                heading_rad: (tick % 2 == 0).then_some((rng.random_range(-1.0..1.0), 0.1)),
                speed_mps: (tick % 5 == 0).then_some((rng.random_range(0.0..5.0), 0.5)),
                ..at(rng.random_range(-2.0..2.0), f64::from(tick) * 0.1, 0.3)
            };
            let evidence = plain.update(&observed, &process).unwrap();
            assert_eq!(mixture.update(&observed).unwrap(), evidence.log_likelihood);
        }
        assert_eq!(mixture.moments(), plain);
    }
}

#[test]
fn one_idle_hypothesis_is_the_plain_filter_to_the_bit() {
    let bicycle = Gaussian::new([0.0, 0.0, 0.5, 3.0, 0.0], [0.1, 0.1, 0.1, 4.0, 0.01]);
    assert_idle_hypothesis_is_the_filter(BICYCLE, bicycle);
    assert_idle_hypothesis_is_the_filter(PEDESTRIAN, Gaussian::new([0.0; 4], [0.1, 0.1, 1.0, 1.0]));
}

#[test]
fn equal_components_have_the_moments_of_the_plain_filter() {
    let start = Gaussian::new([0.0, 0.0, 3.1, 3.0, 0.0], [0.1, 0.1, 0.1, 4.0, 0.01]);
    let mut plain = start;
    let mut mixture = Mixture::new(start, Priors::new(BICYCLE, BICYCLE), 1);
    mixture.adopt(&forecast(&steady(&[[0.0; 2]; 20], [0.0; 3]))).unwrap();
    for tick in 1..40 {
        plain.predict(TICK_NS, &BICYCLE).unwrap();
        mixture.predict(TICK_NS).unwrap();
        let observed = at(-0.24 * f64::from(tick), 0.1, 0.2);
        let expected = plain.update(&observed, &BICYCLE).unwrap().log_likelihood;
        assert!((mixture.update(&observed).unwrap() - expected).abs() < 1e-12);
        let found = mixture.moments();
        assert!((found.mean - plain.mean).amax() < 1e-12);
        assert!((found.covariance - plain.covariance).amax() < 1e-12);
        let kinematic: f64 = mixture.components().filter(|c| c.0.is_none()).map(|c| c.1).sum();
        assert!((kinematic - 0.05).abs() < 1e-9);
    }
}

/// Steps at tick rate against the model's own steps of 0.4 s, in mean and covariance.
#[test]
fn bicycle_controls_reproduce_the_forecast_trajectory() {
    let controls = steady(&[[1.5, 0.02]], [0.4, 0.01, 0.05]);
    let start = Gaussian::new([0.0, 0.0, 0.4, 6.0, 0.01], [0.0; 5]);
    let priors = Priors { kinematic_weight: 0.0, ..Priors::new(BICYCLE, NOISELESS) };
    let mut mixture = Mixture::new(start, priors, 1);
    mixture.adopt(&forecast(&controls)).unwrap();
    let model =
        kinematics::Bicycle { rear_axle_m: 1.2_f64, slip_limit_rad: None, integrator: Integrator::Midpoint };
    let (mut mean, mut covariance) = (start.mean, start.covariance);
    let variance = nalgebra::Matrix2::new(0.16, 0.004, 0.004, 0.0026);
    for step in 1..=10 {
        for _ in 0..5 {
            mixture.predict(TICK_NS).unwrap();
        }
        let moved = model.linearise(&mean, &Vector2::new(1.5, 0.02), 0.4);
        covariance = moved.by_state * covariance * moved.by_state.transpose()
            + moved.by_control * variance * moved.by_control.transpose();
        mean = moved.next;
        let found = mixture.moments();
        let mut off: Vector5<f64> = found.mean - mean;
        off[2] = wrapped(off[2]);
        assert!(off.amax() < 0.1, "step {step}: {off}");
        for component in [3, 4] {
            let (found, expected) =
                (found.covariance[(component, component)], covariance[(component, component)]);
            assert!((found / expected - 1.0).abs() < 1e-9, "step {step}: {found} instead of {expected}");
        }
        if step >= 4 {
            let ratio = found.covariance[(0, 0)] / covariance[(0, 0)];
            assert!((0.8..1.25).contains(&ratio), "step {step}: variance of x is {ratio} of the model's");
        }
    }
}

/// Gains are powers of two, so both sides are equal to the bit.
#[test]
fn control_gain_scales_mean_and_covariance() {
    let start = Gaussian::new([0.0, 0.0, 0.4, 6.0, 0.01], [0.1, 0.1, 0.01, 0.2, 0.001]);
    let moved = |control_gain, mean, cholesky| {
        let priors = Priors { control_gain, ..Priors::new(BICYCLE, NOISELESS) };
        let mut mixture = Mixture::new(start, priors, 1);
        mixture.adopt(&forecast(&steady(&[mean], cholesky))).unwrap();
        for _ in 0..20 {
            mixture.predict(TICK_NS).unwrap();
        }
        mixture.moments()
    };
    let shared = moved([0.5, 0.25], [1.5, 0.04], [0.4, 0.04, 0.16]);
    assert_eq!(shared, moved([1.0; 2], [0.75, 0.01], [0.2, 0.01, 0.04]));
    assert_ne!(shared, moved([1.0; 2], [1.5, 0.04], [0.4, 0.04, 0.16]));
}

/// ∫ a (1 − e^(−t/T)) dt = a (t − T (1 − e^(−t/T)))
#[test]
fn controls_fade_in_with_their_time_constant() {
    let start = Gaussian::new([0.0, 0.0, 0.4, 6.0, 0.0], [0.0; 5]);
    let priors = Priors { kinematic_weight: 0.0, fade_in_s: 0.8, ..Priors::new(BICYCLE, NOISELESS) };
    let mut mixture = Mixture::new(start, priors, 1);
    mixture.adopt(&forecast(&steady(&[[1.5, 0.0]], [0.0; 3]))).unwrap();
    for tick in 1..=30 {
        mixture.predict(TICK_NS).unwrap();
        let elapsed_s = f64::from(tick) * TICK_NS as f64 / 1e9;
        let gained_mps = 1.5 * (elapsed_s + 0.8 * (-elapsed_s / 0.8).exp_m1());
        let found_mps = mixture.moments().mean[3] - 6.0;
        assert!((found_mps - gained_mps).abs() < 1e-3, "{elapsed_s} s: {found_mps}, not {gained_mps}");
    }
}

/// Displacements of a pedestrian at constant acceleration, along a heading.
#[test]
fn displacements_reproduce_the_forecast_trajectory() {
    let (accel, step_s) = (0.3, 0.4);
    let controls: Vec<ControlStep> = (0..STEPS)
        .map(|k| ControlStep {
            mean: [accel * step_s * step_s * (k as f64 + 0.5), 0.0],
            cholesky: [0.1, 0.0, 0.1],
        })
        .collect();
    let heading = 0.7_f64;
    let all = Forecast {
        age_ns: 0,
        step_ns: STEP_NS,
        heading_rad: heading,
        probability: &[1.0],
        controls: &controls,
    };
    let start = Gaussian::new([1.0, 2.0, 0.5, 0.2], [0.0; 4]);
    let still = ConstantVelocity { density: 0.0 };
    let priors = Priors { kinematic_weight: 0.0, ..Priors::new(PEDESTRIAN, still) };
    let mut mixture = Mixture::new(start, priors, 1);
    mixture.adopt(&all).unwrap();
    let (sin, cos) = heading.sin_cos();
    for tick in 1..=55 {
        mixture.predict(TICK_NS).unwrap();
        let t = f64::from(tick) * 0.08;
        let gone = accel * t * t / 2.0;
        let found = mixture.moments();
        assert!((found.mean[0] - (1.0 + 0.5 * t + gone * cos)).abs() < 1e-9, "{tick}");
        assert!((found.mean[1] - (2.0 + 0.2 * t + gone * sin)).abs() < 1e-9);
        assert!((found.mean[2] - (0.5 + accel * t * cos)).abs() < 1e-9);
        assert!((found.covariance[(0, 0)] - 0.01 * t / step_s).abs() < 1e-12);
    }
}

/// The weights sum to 1 at every tick, and a second run gives the same bits.
#[test]
fn the_true_hypothesis_gains_weight_and_bridges_a_gap() {
    let rates = [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0];
    let controls: Vec<[f64; 2]> =
        rates.iter().flat_map(|&a| [-0.1, 0.0, 0.1].map(|slip| [a, slip])).take(20).collect();
    let sets = steady(&controls, [0.1, 0.0, 0.01]);
    let true_hypothesis = 3 * 5 + 1;
    let run = || {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let start = Gaussian::new([0.0, 0.0, 0.2, 8.0, 0.0], [0.01, 0.01, 0.001, 0.25, 1e-4]);
        let mut mixture = Mixture::new(start, Priors::new(BICYCLE, NOISELESS), 3);
        let mut plain = start;
        mixture.adopt(&forecast(&sets)).unwrap();
        let mut truth = Gaussian::new(start.mean.into(), [0.0; 5]);
        let control = Bicycle::control(&sets.1[STEPS * true_hypothesis..][..1], 0, 0.4, 0.0);
        let mut fewest = usize::MAX;
        for tick in 1..=45 {
            truth = NOISELESS.step_controlled(&truth, &control, 0.08);
            mixture.predict(TICK_NS).unwrap();
            plain.predict(TICK_NS, &BICYCLE).unwrap();
            if tick <= 25 {
                let mut noise = || 0.05 * Distribution::<f64>::sample(&StandardNormal, &mut rng);
                let observed = at(truth.mean[0] + noise(), truth.mean[1] + noise(), 0.05);
                mixture.update(&observed).unwrap();
                plain.update(&observed, &BICYCLE).unwrap();
            }
            let sum: f64 = mixture.components().map(|c| c.1).sum();
            assert!((sum - 1.0).abs() < 1e-12, "{sum}");
            fewest = fewest.min(mixture.components().count());
        }
        assert!(fewest < 21, "no hypothesis was dropped");
        let off_m = |state: &Gaussian<5>| (state.mean - truth.mean).fixed_rows::<2>(0).norm();
        (mixture.moments(), off_m(&mixture.moments()), off_m(&plain), mixture.weight(true_hypothesis))
    };
    let (state, learned_m, kinematic_m, weight) = run();
    println!("1.6 s without measurement: {learned_m:.3} m against {kinematic_m:.3} m, weight {weight:.3}");
    assert!(weight > 0.8 && learned_m < 0.5 * kinematic_m);
    assert_eq!(run().0, state);
}

#[test]
fn wrong_hypotheses_lose_their_weight_to_the_kinematic_one() {
    let start = Gaussian::new([0.0, 0.0, 0.0, 8.0, 0.0], [0.01, 0.01, 0.001, 0.25, 1e-4]);
    let mut mixture = Mixture::new(start, Priors::new(BICYCLE, NOISELESS), 3);
    mixture.adopt(&forecast(&steady(&[[-5.0, 0.0], [-4.0, 0.0]], [0.05, 0.0, 0.01]))).unwrap();
    for tick in 1..=12 {
        mixture.predict(TICK_NS).unwrap();
        mixture.update(&at(0.64 * f64::from(tick), 0.0, 0.05)).unwrap();
    }
    let learned: f64 = mixture.components().filter(|c| c.0.is_some()).map(|c| c.1).sum();
    assert!(learned < 1e-3, "{learned}");
}

#[test]
fn a_forecast_past_its_horizon_is_dropped() {
    let start = Gaussian::new([0.0, 0.0, 0.0, 8.0, 0.0], [0.01, 0.01, 0.001, 0.25, 1e-4]);
    let mut mixture = Mixture::new(start, Priors::new(BICYCLE, NOISELESS), 3);
    let sets = steady(&[[1.0, 0.0], [-1.0, 0.0]], [0.1, 0.0, 0.01]);
    let age_ns = 11 * STEP_NS;
    mixture.adopt(&Forecast { age_ns, ..forecast(&sets) }).unwrap();
    for _ in 0..5 {
        mixture.predict(TICK_NS).unwrap();
        assert_eq!(mixture.components().count(), 3);
    }
    assert_eq!(mixture.forecast_age_ns(), Some(12 * STEP_NS));
    let mut collapsed = mixture.moments();
    mixture.predict(TICK_NS).unwrap();
    collapsed.predict(TICK_NS, &BICYCLE).unwrap();
    assert_eq!((mixture.moments(), mixture.forecast_age_ns()), (collapsed, None));
}

#[test]
fn invalid_forecasts_are_refused_and_change_nothing() {
    let start = Gaussian::new([0.0, 0.0, 0.0, 8.0, 0.0], [0.01, 0.01, 0.001, 0.25, 1e-4]);
    let mut mixture = Mixture::new(start, Priors::new(BICYCLE, NOISELESS), 3);
    let good = steady(&[[1.0, 0.0], [-1.0, 0.0]], [0.1, 0.0, 0.01]);
    let mut broken = good.clone();
    broken.1[STEPS + 2].cholesky[1] = f64::NAN;
    let fault = mixture.adopt(&forecast(&broken)).unwrap_err();
    assert_eq!(fault, ForecastFault::NotFinite { hypothesis: 1 });
    let horizon_ns = 12 * STEP_NS;
    let fault = mixture.adopt(&Forecast { age_ns: horizon_ns, ..forecast(&good) }).unwrap_err();
    assert_eq!(fault, ForecastFault::Over { age_ns: horizon_ns, horizon_ns });
    for probability in [&[0.0, 0.0][..], &[1.0, -0.1], &[1.0, f64::INFINITY]] {
        let fault = mixture.adopt(&Forecast { probability, ..forecast(&good) }).unwrap_err();
        assert!(matches!(fault, ForecastFault::Probability(_)), "{fault}");
    }
    let crowd = steady(&[[0.0; 2]; 33], [0.1, 0.0, 0.1]);
    for (probability, controls) in [(&crowd.0[..], &crowd.1[..]), (&[], &good.1), (&good.0, &good.1[..23])] {
        let fault = mixture.adopt(&Forecast { probability, controls, ..forecast(&good) }).unwrap_err();
        assert!(matches!(fault, ForecastFault::Shape { .. }), "{fault}");
    }
    assert!(!mixture.is_learned());
    assert_eq!(mixture.moments(), start);
}

/// 10,000 random ticks: teleports, impossible variances, arbitrary forecasts.
#[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
fn assert_stays_sound<P: Controlled<N> + Copy, const N: usize>(process: P, start: Gaussian<N>) {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let mut mixture = Mixture::new(start, Priors::new(process, process), 17);
    let mut updated = 0;
    for tick in 0..10_000_u32 {
        if tick % 4 == 0 {
            let means: Vec<[f64; 2]> =
                (0..20).map(|_| [rng.random_range(-6.0..6.0), rng.random_range(-1.0..1.0)]).collect();
            let mut sets = steady(&means, [rng.random_range(0.0..2.0), rng.random_range(-0.1..0.1), 0.1]);
            if tick % 16 == 0 {
                sets.1[100].mean[0] = f64::NAN;
            }
            let expected =
                if tick % 16 == 0 { Err(ForecastFault::NotFinite { hypothesis: 8 }) } else { Ok(()) };
            assert_eq!(mixture.adopt(&forecast(&sets)), expected);
        }
        mixture.predict(rng.random_range(0..300_000_000)).unwrap();
        let exponent: f64 = rng.random_range(-12.0..6.0);
        let variance = if tick % 50 == 0 { f64::NAN } else { 10_f64.powf(exponent) };
        let observed = Observation {
            position_m: [rng.random_range(-100.0..100.0), rng.random_range(-100.0..100.0)],
            position_variance: variance,
            elongation: [0.0; 2],
            heading_rad: rng.random_bool(0.3).then_some((rng.random_range(-9.0..9.0), variance)),
            speed_mps: rng.random_bool(0.3).then_some((rng.random_range(-30.0..30.0), variance)),
        };
        let done = mixture.update(&observed);
        updated += usize::from(done.is_ok());
        assert!(
            done.is_ok_and(f64::is_finite) || done == Err(FilterFault::NotPositive),
            "tick {tick}: {done:?}"
        );
        let sum: f64 = mixture.components().map(|c| c.1).sum();
        assert!((sum - 1.0).abs() < 1e-9, "tick {tick}: weights sum to {sum}");
        let state = mixture.moments();
        assert!(is_sound(&state), "tick {tick}, R = 1e{exponent}: {state:?}");
    }
    assert!(updated >= 9_700, "{updated}");
}

#[test]
fn random_ticks_keep_the_mixture_sound() {
    assert_stays_sound(BICYCLE, Gaussian::new([0.0, 0.0, 0.5, 3.0, 0.0], [0.1, 0.1, 0.1, 4.0, 0.01]));
    assert_stays_sound(PEDESTRIAN, Gaussian::new([0.0; 4], [0.1, 0.1, 1.0, 1.0]));
}

#[test]
fn a_forecast_leads_ahead_where_predictions_without_measurements_go() {
    let start = Gaussian::new([0.0, 0.0, 0.5, 8.0, 0.0], [0.1, 0.1, 1e-4, 0.1, 1e-4]);
    let priors = Priors { kinematic_weight: 0.0, ..Priors::new(BICYCLE, NOISELESS) };
    let one = steady(&[[-2.0, 0.05]], [0.0; 3]);
    let mut mixture = Mixture::new(start, priors, 1);
    mixture.adopt(&forecast(&one)).expect("a forecast");
    let ahead: [_; 2] = mixture.ahead(STEP_NS).expect("within the horizon");
    let mut plain = start;
    for ahead in ahead {
        mixture.predict(STEP_NS).expect("a state");
        plain.predict(STEP_NS, &BICYCLE).expect("a state");
        for axis in 0..2 {
            assert!((ahead.learned_m[axis] - mixture.moments().mean[axis]).abs() < 1e-9, "{ahead:?}");
            assert!((ahead.kinematic_m[axis] - plain.mean[axis]).abs() < 1e-9, "{ahead:?}");
        }
    }
    // For two hypotheses, the mean of their controls leads near the mean of their positions.
    let two = steady(&[[-2.0, 0.05], [2.0, -0.02]], [0.0; 3]);
    let mut mixture = Mixture::new(start, priors, 1);
    mixture.adopt(&forecast(&two)).expect("a forecast");
    let [_, ahead]: [_; 2] = mixture.ahead(STEP_NS).expect("within the horizon");
    mixture.predict(2 * STEP_NS).expect("a state");
    let apart_m = (ahead.learned_m[0] - mixture.moments().mean[0])
        .hypot(ahead.learned_m[1] - mixture.moments().mean[1]);
    assert!(apart_m < 0.1, "{apart_m} m, of hypotheses that are 1.3 m apart");
    assert!(mixture.ahead::<2>(6 * STEP_NS).is_none(), "past the horizon");
    mixture.reset(start);
    assert!(mixture.ahead::<2>(STEP_NS).is_none(), "without a forecast");
}
