//! Consistency of covariances: a thousand runs of each filter, with truths drawn from the process that the
//! filter assumes.
//!
//! If the filter is exact, the normalised squares (NEES) of all runs at one tick add up to a χ² variable. 95
//! % of the ticks are then within its bounds. Only linear filters are exact; the others are nearly exact.

use filters::{
    Bicycle, ConstantAcceleration, ConstantTurnRate, ConstantVelocity, Control, ControlStep, Controlled,
    Forecast, Gaussian, Mixture, Observation, Particles, Priors, Process, difference,
};
use metrics::tracking::{Consistency, ConsistencySummary, chi_square_bounds, normalised_square};
use nalgebra::SVector;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::support::bicycle;

const SEEDS: u64 = 1_000;
const TICK_NS: u64 = 80_000_000;
const TICK_S: f64 = 0.08;

const VELOCITY: ConstantVelocity = ConstantVelocity { density: 0.5 };
const ACCELERATION: ConstantAcceleration = ConstantAcceleration { density: 1.0 };
const TURN_RATE: ConstantTurnRate = ConstantTurnRate { acceleration_density: 0.5, yaw_density: 0.02 };
const BICYCLE: Bicycle = Bicycle { slip_rate_radps: 0.1, ..bicycle::BICYCLE };
/// A bicycle whose slip decays.
const DECAYING: Bicycle = Bicycle { slip_decay_per_s: 0.8, ..BICYCLE };
/// Like [`BICYCLE`] without process noise, for forecasts.
const NOISELESS: Bicycle = Bicycle { acceleration_mps2: 0.0, slip_rate_radps: 0.0, ..BICYCLE };

/// Standard deviations of a sensor's measurements.
#[derive(Clone, Copy)]
struct Sensor {
    position_m: f64,
    heading_rad: Option<f64>,
    speed_mps: Option<f64>,
}

const SHARP: Sensor = Sensor { position_m: 0.02, heading_rad: None, speed_mps: None };
const POSITIONS: Sensor = Sensor { position_m: 0.2, heading_rad: None, speed_mps: None };
const ALL: Sensor = Sensor { position_m: 0.2, heading_rad: Some(0.1), speed_mps: Some(0.5) };

impl Sensor {
    /// Measures a state. The state begins with x, y, ψ, v if more than the position is measured.
    fn measure<const N: usize>(&self, state: &SVector<f64, N>, rng: &mut ChaCha8Rng) -> Observation {
        let mut noisy = |component: usize, sigma: f64| state[component] + sigma * normal(rng);
        Observation {
            position_m: [noisy(0, self.position_m), noisy(1, self.position_m)],
            position_variance: self.position_m.powi(2),
            elongation: [0.0; 2],
            heading_rad: self.heading_rad.map(|sigma| (noisy(2, sigma), sigma.powi(2))),
            speed_mps: self.speed_mps.map(|sigma| (noisy(3, sigma), sigma.powi(2))),
        }
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// The next state of a truth: one step of the process with drawn noise.
fn drawn<const N: usize>(
    process: &impl Process<N>,
    state: &SVector<f64, N>,
    step: impl Fn(&Gaussian<N>) -> Gaussian<N>,
    rng: &mut ChaCha8Rng,
) -> SVector<f64, N> {
    let certain = Gaussian::new((*state).into(), [0.0; N]);
    let mut next = step(&certain).sample(|| normal(rng));
    process.constrain(&mut next);
    next
}

/// The normalised squares of many runs, for states (NEES) and innovations (NIS).
#[derive(Default)]
struct Squares {
    states: Consistency,
    innovations: Consistency,
}

#[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
impl Squares {
    fn add<const N: usize>(
        &mut self,
        tick: u64,
        truth: &SVector<f64, N>,
        found: &Gaussian<N>,
        angles: &[usize],
    ) {
        let error = difference(truth, &found.mean, angles);
        self.states.add(tick, normalised_square(&error, &found.covariance).unwrap(), N as u32).unwrap();
    }

    fn summary(&self, name: &str) -> ConsistencySummary {
        let states = self.states.summary(0.95).unwrap().unwrap();
        println!(
            "{name}: {:.1} % of {} ticks inside, NEES/n {:.4}",
            100.0 * states.inside,
            states.tick_count,
            states.per_degree
        );
        states
    }
}

/// Runs an extended Kalman filter that assumes `filter`. The agents move by `truth` from a state drawn from
/// `start`.
#[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
fn kalman<P: Process<N>, const N: usize>(
    (truth, filter): (&P, &P),
    start: &Gaussian<N>,
    sensor: Sensor,
    tick_count: u64,
) -> Squares {
    let mut squares = Squares::default();
    for seed in 0..SEEDS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut state = start.sample(|| normal(&mut rng));
        let mut found = *start;
        for tick in 0..tick_count {
            state = drawn(truth, &state, |from| truth.step(from, TICK_S), &mut rng);
            found.predict(TICK_NS, filter).unwrap();
            let evidence = found.update(&sensor.measure(&state, &mut rng), filter).unwrap();
            squares.innovations.add(tick, evidence.nis, evidence.measured_count as u32).unwrap();
            squares.add(tick, &state, &found, P::ANGLES);
        }
    }
    squares
}

/// Linear filters are exact. Innovations are independent, so the sum of all their squares and the number of
/// ticks within the bounds have known distributions. 99.9 % of all seeds pass.
#[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
fn assert_exact(name: &str, squares: &Squares) {
    const SIGMAS: f64 = 3.29;
    let innovations = squares.innovations.summary(0.95).unwrap().unwrap();
    let tick_count = innovations.tick_count as f64;
    let spread = SIGMAS * (0.95 * 0.05 / tick_count).sqrt();
    println!("{name}: {:.1} % inside, NIS/m {:.5}", 100.0 * innovations.inside, innovations.per_degree);
    assert!((innovations.inside - 0.95).abs() < spread, "{name}: {innovations:?}");
    let degrees = 2 * innovations.square_count;
    let bounds = chi_square_bounds(degrees, 0.999).unwrap();
    assert!(bounds.contain(innovations.per_degree * degrees as f64), "{name}: {innovations:?}");
    // Errors of neighbouring ticks are correlated: the share is the same, but its variance is greater.
    let states = squares.summary(name);
    assert!((states.inside - 0.95).abs() < 2.0 * spread, "{name}: {states:?}");
    assert!((states.per_degree - 1.0).abs() < 0.01, "{name}: {states:?}");
}

fn assert_near(name: &str, squares: &Squares) {
    let states = squares.summary(name);
    assert!(states.inside >= 0.9, "{name}: {states:?}");
    assert!((0.9..=1.1).contains(&states.per_degree), "{name}: {states:?}");
}

#[test]
fn linear_filters_are_consistent() {
    let pedestrian = Gaussian::new([3.0, -1.0, 1.0, 0.5], [0.04, 0.04, 0.5, 0.5]);
    let racer = Gaussian::new([3.0, -1.0, 5.0, 2.0, 0.0, 0.0], [0.04, 0.04, 0.5, 0.5, 1.0, 1.0]);
    for (name, sensor) in [("σ 0.02 m", SHARP), ("σ 0.2 m", POSITIONS)] {
        let squares = kalman((&VELOCITY, &VELOCITY), &pedestrian, sensor, 400);
        assert_exact(&format!("constant velocity, {name}"), &squares);
        let squares = kalman((&ACCELERATION, &ACCELERATION), &racer, sensor, 400);
        assert_exact(&format!("constant acceleration, {name}"), &squares);
    }
}

/// The bounds must reject a filter that is slightly wrong.
#[test]
fn too_small_a_process_noise_is_inconsistent() {
    let start = Gaussian::new([3.0, -1.0, 1.0, 0.5], [0.04, 0.04, 0.5, 0.5]);
    let wrong = ConstantVelocity { density: VELOCITY.density / 1.2 };
    let states = kalman((&VELOCITY, &wrong), &start, POSITIONS, 100).summary("too small a noise");
    assert!(states.inside < 0.7 && states.per_degree > 1.02, "{states:?}");
}

#[test]
fn linearised_filters_are_nearly_consistent() {
    let start = Gaussian::new([3.0, -1.0, 3.0, 8.0, 0.0], [0.04, 0.04, 0.01, 0.25, 1e-3]);
    for (name, sensor) in [("σ 0.02 m", SHARP), ("σ 0.2 m", POSITIONS), ("with heading and speed", ALL)] {
        let squares = kalman((&TURN_RATE, &TURN_RATE), &start, sensor, 100);
        assert_near(&format!("constant turn rate, {name}"), &squares);
        let squares = kalman((&BICYCLE, &BICYCLE), &start, sensor, 100);
        assert_near(&format!("bicycle, {name}"), &squares);
        let squares = kalman((&DECAYING, &DECAYING), &start, sensor, 100);
        assert_near(&format!("bicycle whose slip decays, {name}"), &squares);
    }
}

/// Duration of each control in the forecast of a [`Scene`].
const STEP_NS: u64 = 400_000_000;
const STEPS: usize = 4;
const HYPOTHESES: usize = 20;
/// Number of ticks between forecasts, and between decisions of the agent.
const FORECAST_TICKS: u64 = 10;

/// Agents with calibrated forecasts. They follow one of the hypotheses, with its probability.
struct Scene<P, const N: usize> {
    priors: Priors<P>,
    start: Gaussian<N>,
    probability: [f64; HYPOTHESES],
    controls: [ControlStep; HYPOTHESES * STEPS],
}

impl<P: Controlled<N> + Copy, const N: usize> Scene<P, N> {
    /// Hypotheses about a circle of the given radii in the plane of controls, with different probabilities.
    fn new(priors: Priors<P>, start: Gaussian<N>, radius: [f64; 2], cholesky: [f64; 3]) -> Self {
        let controls = std::array::from_fn(|i| {
            let turn = (i / STEPS) as f64 / HYPOTHESES as f64 * std::f64::consts::TAU;
            let growth = 1.0 + (i % STEPS) as f64 * 0.2;
            ControlStep { mean: [radius[0] * turn.cos() * growth, radius[1] * turn.sin() * growth], cholesky }
        });
        let probability = std::array::from_fn(|i| 1.0 + (i % 3) as f64);
        Self { priors, start, probability, controls }
    }

    fn forecast(&self) -> Forecast<'_> {
        Forecast {
            age_ns: 0,
            step_ns: STEP_NS,
            heading_rad: 0.4,
            probability: &self.probability,
            controls: &self.controls,
        }
    }

    /// Draws one of the hypotheses, or none.
    fn decide(&self, rng: &mut ChaCha8Rng) -> Option<&[ControlStep]> {
        if rng.random_bool(self.priors.kinematic_weight) {
            return None;
        }
        let mut left = rng.random_range(0.0..self.probability.iter().sum::<f64>());
        let chosen = self.probability.iter().position(|probability| {
            left -= probability;
            left < 0.0
        });
        self.controls.chunks(STEPS).nth(chosen.unwrap_or(HYPOTHESES - 1))
    }

    /// The next state of an agent whose last decision is `age_ns` old.
    fn step(
        &self,
        state: &SVector<f64, N>,
        decided: Option<&[ControlStep]>,
        age_ns: u64,
        rng: &mut ChaCha8Rng,
    ) -> SVector<f64, N> {
        let Some(steps) = decided else {
            let process = &self.priors.kinematic;
            return drawn(process, state, |from| process.step(from, TICK_S), rng);
        };
        let after_ns = (age_ns + TICK_NS / 2).checked_sub(P::first_ns(STEP_NS));
        let number = after_ns.map_or(0, |after_ns| 1 + (after_ns / STEP_NS) as usize);
        let input: Control = P::control(steps, number, STEP_NS as f64 / 1e9, self.forecast().heading_rad);
        let [a, b] = self.priors.control_gain;
        let control = Control {
            rate: [a * input.rate[0], b * input.rate[1]],
            density: [a * a * input.density[0], a * b * input.density[1], b * b * input.density[2]],
        };
        let process = &self.priors.learned;
        drawn(process, state, |from| process.step_controlled(from, &control, TICK_S), rng)
    }

    /// Runs filters built from a seed. They adopt forecasts, predict and update.
    fn evaluate<F>(
        &self,
        sensor: Sensor,
        tick_count: u64,
        new: impl Fn(u64) -> F,
        tick_of: impl Fn(&mut F, Option<&Forecast>, &Observation) -> Gaussian<N>,
    ) -> Squares {
        let mut squares = Squares::default();
        for seed in 0..SEEDS {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut state = self.start.sample(|| normal(&mut rng));
            let mut filter = new(seed);
            let mut decided = None;
            for tick in 0..tick_count {
                let since = tick % FORECAST_TICKS;
                let forecast = (since == 0).then(|| self.forecast());
                if forecast.is_some() {
                    decided = self.decide(&mut rng);
                }
                state = self.step(&state, decided, since * TICK_NS, &mut rng);
                let found = tick_of(&mut filter, forecast.as_ref(), &sensor.measure(&state, &mut rng));
                squares.add(tick, &state, &found, P::ANGLES);
            }
        }
        squares
    }

    #[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
    fn mixture(&self, sensor: Sensor, tick_count: u64) -> Squares {
        let new = |seed| Mixture::new(self.start, self.priors, seed);
        self.evaluate(sensor, tick_count, new, |mixture, forecast, observed| {
            if let Some(forecast) = forecast {
                mixture.adopt(forecast).unwrap();
            }
            mixture.predict(TICK_NS).unwrap();
            mixture.update(observed).unwrap();
            mixture.moments()
        })
    }

    #[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
    fn particles(&self, sensor: Sensor, tick_count: u64, particle_count: usize) -> Squares {
        let new = |seed| Particles::new(&self.start, self.priors, particle_count, seed);
        self.evaluate(sensor, tick_count, new, |particles, forecast, observed| {
            if let Some(forecast) = forecast {
                particles.adopt(forecast).unwrap();
            }
            particles.predict(TICK_NS).unwrap();
            particles.update(observed).unwrap();
            particles.moments()
        })
    }
}

fn vehicles() -> Scene<Bicycle, 5> {
    let start = Gaussian::new([3.0, -1.0, 3.0, 8.0, 0.0], [0.04, 0.04, 0.01, 0.25, 1e-3]);
    Scene::new(Priors::new(BICYCLE, NOISELESS), start, [2.0, 0.1], [0.5, 0.0, 0.05])
}

/// Like [`vehicles`], at control gains below 1 and with the slip decay that remains at these gains.
fn vehicles_at_partial_gain() -> Scene<Bicycle, 5> {
    let Scene { start, .. } = vehicles();
    let learned = Bicycle { slip_decay_per_s: 0.4 * DECAYING.slip_decay_per_s, ..NOISELESS };
    let priors = Priors { control_gain: [0.8, 0.6], ..Priors::new(DECAYING, learned) };
    Scene::new(priors, start, [2.0, 0.1], [0.5, 0.0, 0.05])
}

fn pedestrians() -> Scene<ConstantVelocity, 4> {
    let start = Gaussian::new([3.0, -1.0, 1.0, 0.5], [0.04, 0.04, 0.1, 0.1]);
    Scene::new(
        Priors::new(VELOCITY, ConstantVelocity { density: 0.05 }),
        start,
        [0.15, 0.15],
        [0.03, 0.0, 0.03],
    )
}

#[test]
fn mixtures_are_nearly_consistent() {
    let (vehicles, in_part, pedestrians) = (vehicles(), vehicles_at_partial_gain(), pedestrians());
    for (name, sensor) in [("σ 0.02 m", SHARP), ("σ 0.2 m", POSITIONS), ("with heading and speed", ALL)] {
        assert_near(&format!("mixture of bicycles, {name}"), &vehicles.mixture(sensor, 50));
        assert_near(&format!("mixture of decaying slips, {name}"), &in_part.mixture(sensor, 50));
        if sensor.heading_rad.is_none() {
            assert_near(&format!("mixture of constant velocities, {name}"), &pedestrians.mixture(sensor, 50));
        }
    }
}

#[test]
fn five_hundred_particles_are_nearly_consistent() {
    let vehicles = vehicles();
    for (name, sensor) in [("σ 0.02 m", SHARP), ("σ 0.2 m", POSITIONS)] {
        let states = vehicles.particles(sensor, 12, 500).summary(&format!("500 particles, {name}"));
        assert!((0.9..=1.1).contains(&states.per_degree), "{name}: {states:?}");
    }
}

/// Fewer particles are not enough: the sums over all seeds must be within their bounds as often as for the
/// other filters.
#[test]
fn four_thousand_particles_are_as_consistent_as_the_mixture() {
    // The sharper sensor is the harder case. The test of 500 particles covers both sensors.
    assert_near("4,000 particles, σ 0.02 m", &vehicles().particles(SHARP, 12, 4_000));
}
