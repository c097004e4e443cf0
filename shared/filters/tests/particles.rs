//! The particle filter against a reference run with all its random numbers, and against the exact filter.
//! Moments of samples against reference values.

use std::path::PathBuf;

use filters::{
    Bicycle, Control, ControlStep, Controlled, FilterFault, Forecast, Gaussian, Innovation, Mixture,
    Observation, Particles, Priors, Process, interpolated, sample_moments, wrapped,
};
use nalgebra::{SVector, Vector2};

use crate::support::bicycle::BICYCLE;
use crate::support::state::{PEDESTRIAN, at};

const TICK_NS: u64 = 80_000_000;

fn golden(name: &str) -> serde_json::Value {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/unit").join(name);
    serde_json::from_str(&std::fs::read_to_string(path).expect("golden file")).expect("JSON")
}

fn numbers<const N: usize>(value: &serde_json::Value) -> SVector<f64, N> {
    let list = value.as_array().expect("a list").iter();
    SVector::from_iterator(list.map(|x| x.as_f64().expect("a number")))
}

/// A point that moves by standard normal numbers, once per 80 ms.
#[derive(Clone, Copy)]
struct RandomWalk;

impl Process<2> for RandomWalk {
    const ANGLES: &'static [usize] = &[];

    fn step(&self, state: &Gaussian<2>, dt_s: f64) -> Gaussian<2> {
        let mut moved = *state;
        moved.covariance += nalgebra::Matrix2::identity() * (dt_s / 0.08);
        moved
    }

    fn innovation(&self, mean: &Vector2<f64>, observation: &Observation) -> Innovation<2> {
        let [x, y] = observation.position_m;
        Innovation::of_position([x - mean[0], y - mean[1]], observation.position_variance)
    }

    fn constrain(&self, _: &mut Vector2<f64>) {}
}

impl Controlled<2> for RandomWalk {
    fn step_controlled(&self, state: &Gaussian<2>, _: &Control, dt_s: f64) -> Gaussian<2> {
        self.step(state, dt_s)
    }

    fn control(_: &[ControlStep], _: usize, _: f64, _: f64) -> Control {
        Control::default()
    }

    fn first_ns(step_ns: u64) -> u64 {
        step_ns
    }
}

#[test]
fn particle_filter_equals_the_reference() {
    let all = golden("pf_small.json");
    let list = |key: &str| all[key].as_array().unwrap().clone();
    let states: Vec<Vector2<f64>> = list("x0").iter().map(numbers).collect();
    let mut particles = Particles::of(&states, Priors::new(RandomWalk, RandomWalk), 1);
    let steps = list("steps");
    assert_eq!((states.len(), steps.len()), (64, 12));
    let mut resampled_count = 0;
    for (k, expected) in steps.iter().enumerate() {
        let noise: Vec<Vector2<f64>> = all["noise"][k].as_array().unwrap().iter().map(numbers).collect();
        let mut normals = noise.iter().flat_map(|pair| [pair[0], pair[1]]);
        particles.predict_with(TICK_NS, || normals.next().unwrap()).unwrap();
        let log_likelihood = particles
            .weigh(&{
                let [x, y] = numbers::<2>(&all["z"][k]).into();
                at(x, y, 0.3)
            })
            .unwrap();
        let number = |key: &str| expected[key].as_f64().unwrap();
        // The reference omits the density's constant.
        let constant = (std::f64::consts::TAU * 0.09).ln();
        assert!((log_likelihood + constant - number("loglik_unnormalised")).abs() < 1e-9);
        assert!((particles.effective_size() - number("ess")).abs() < 1e-9);
        assert!((particles.moments().mean - numbers::<2>(&expected["mean"])).amax() < 1e-9);
        assert_eq!(particles.is_degenerate(), expected["resampled"].as_bool().unwrap());
        if particles.is_degenerate() {
            let before: Vec<Vector2<f64>> = particles.particles().map(|p| *p.2).collect();
            particles.resample(all["u"][k].as_f64().unwrap());
            let chosen = expected["idx"].as_array().unwrap().iter().map(|i| i.as_u64().unwrap() as usize);
            assert!(particles.particles().map(|p| *p.2).eq(chosen.map(|i| before[i])), "step {k}");
            resampled_count += 1;
        }
    }
    assert!(resampled_count > 5);
}

#[test]
fn sample_moments_equal_the_reference() {
    let all = golden("sample_prior.json");
    let step_s = all["step"].as_f64().unwrap();
    let samples: Vec<Vec<SVector<f64, 5>>> = all["samples"]
        .as_array()
        .unwrap()
        .iter()
        .map(|sample| sample.as_array().unwrap().iter().map(numbers).collect())
        .collect();
    let angles = Bicycle::ANGLES;
    let queries = all["queries"].as_array().unwrap();
    assert_eq!(queries.len(), 7);
    for query in queries {
        let at = query["tau"].as_f64().unwrap() / step_s;
        let k = (at.floor() as usize).min(samples[0].len() - 2);
        let points: Vec<_> =
            samples.iter().map(|s| interpolated(&s[k], &s[k + 1], at - k as f64, angles)).collect();
        let found = sample_moments(&points, angles);
        let mut off = found.mean - numbers::<5>(&query["mean"]);
        off[2] = wrapped(off[2]);
        assert!(off.amax() < 1e-9, "{off}");
        for (row, expected) in query["cov"].as_array().unwrap().iter().enumerate() {
            let off = found.covariance.row(row).transpose() - numbers::<5>(expected);
            assert!(off.amax() < 1e-9, "{off}");
        }
    }
}

/// A linear process, for which the Kalman filter is exact.
#[test]
fn many_particles_have_the_kalman_filters_moments() {
    let mut exact = Gaussian::new([0.0, 0.0, 1.0, 0.0], [0.1, 0.1, 0.3, 0.3]);
    let mut particles = Particles::new(&exact, Priors::new(PEDESTRIAN, PEDESTRIAN), 10_000, 7);
    let (mut exact_log, mut log) = (0.0, 0.0);
    for tick in 1..=25 {
        exact.predict(TICK_NS, &PEDESTRIAN).unwrap();
        particles.predict(TICK_NS).unwrap();
        let observed = at(0.1 * f64::from(tick), 0.05, 0.3);
        exact_log += exact.update(&observed, &PEDESTRIAN).unwrap().log_likelihood;
        log += particles.update(&observed).unwrap();
    }
    let found = particles.moments();
    let sigma = exact.covariance.map_diagonal(f64::sqrt);
    assert!((found.mean - exact.mean).component_div(&sigma).amax() < 0.1, "{}", found.mean - exact.mean);
    let ratio = found.covariance.diagonal().component_div(&exact.covariance.diagonal());
    assert!(ratio.iter().all(|ratio| (0.85..1.15).contains(ratio)), "{ratio}");
    assert!((log - exact_log).abs() < 0.5, "{log} instead of {exact_log}");
}

#[test]
fn particles_and_mixture_agree_under_a_forecast() {
    let bicycle = Bicycle { acceleration_mps2: 1.0, slip_rate_radps: 0.05, ..BICYCLE };
    let start = Gaussian::new([0.0, 0.0, 3.1, 6.0, 0.0], [0.01, 0.01, 0.001, 0.25, 1e-4]);
    let priors = Priors::new(bicycle, bicycle);
    let controls: Vec<ControlStep> = [-3.0, 0.0, 3.0]
        .iter()
        .flat_map(|&a| [ControlStep { mean: [a, 0.0], cholesky: [0.2, 0.0, 0.02] }; 12])
        .collect();
    let forecast = Forecast {
        age_ns: 0,
        step_ns: 400_000_000,
        heading_rad: 3.1,
        probability: &[1.0; 3],
        controls: &controls,
    };
    let mut mixture = Mixture::new(start, priors, 3);
    let run = || {
        let mut particles = Particles::new(&start, priors, 4_000, 3);
        particles.adopt(&forecast).unwrap();
        for tick in 1..=12 {
            particles.predict(TICK_NS).unwrap();
            let t = f64::from(tick) * 0.08;
            let path_m = 6.0 * t + 1.5 * t * t;
            particles.update(&at(-path_m * 0.999, path_m * 0.0416, 0.1)).unwrap();
        }
        particles
    };
    mixture.adopt(&forecast).unwrap();
    for tick in 1..=12 {
        mixture.predict(TICK_NS).unwrap();
        let t = f64::from(tick) * 0.08;
        let path_m = 6.0 * t + 1.5 * t * t;
        mixture.update(&at(-path_m * 0.999, path_m * 0.0416, 0.1)).unwrap();
    }
    let particles = run();
    let mut weight = [0.0; 3];
    let mut sum = 0.0;
    for (hypothesis, share, _) in particles.particles() {
        sum += share;
        if let Some(hypothesis) = hypothesis {
            weight[hypothesis] += share;
        }
    }
    assert!((sum - 1.0).abs() < 1e-9);
    assert!(weight[2] > 0.5 && weight[2] > weight[0] && weight[2] > weight[1], "{weight:?}");
    assert!(mixture.weight(2) > mixture.weight(0).max(mixture.weight(1)));
    let (found, expected) = (particles.moments(), mixture.moments());
    let mut off = found.mean - expected.mean;
    off[2] = wrapped(off[2]);
    let off = off.component_div(&expected.covariance.map_diagonal(f64::sqrt));
    assert!(off.amax() < 0.3, "{off}");
    assert_eq!(run().moments(), found);
}

#[test]
fn invalid_observations_are_refused_and_far_ones_are_found() {
    let start = Gaussian::new([0.0, 0.0, 1.0, 0.0], [0.1, 0.1, 0.3, 0.3]);
    let mut particles = Particles::new(&start, Priors::new(PEDESTRIAN, PEDESTRIAN), 100, 7);
    let before = particles.moments();
    let sigma = |position_variance| Observation { position_variance, ..at(0.0, 0.0, 1.0) };
    for variance in [f64::NAN, -1.0, 0.0] {
        assert_eq!(particles.update(&sigma(variance)), Err(FilterFault::NotPositive), "{variance}");
    }
    assert_eq!(particles.update(&at(f64::NAN, 0.0, 1.0)), Err(FilterFault::NotPositive));
    assert_eq!(particles.moments(), before);
    // A far and sharp observation moves the cloud although no particle was near it.
    particles.update(&at(1e6, -1e6, 1e-6)).unwrap();
    let found = particles.moments();
    assert!((found.mean.fixed_rows::<2>(0) - Vector2::new(1e6, -1e6)).amax() < 1e-3, "{}", found.mean);
    assert!(
        found.is_finite() && found.covariance.fixed_view::<2, 2>(0, 0).amax() < 1e-6,
        "{}",
        found.covariance
    );
}
