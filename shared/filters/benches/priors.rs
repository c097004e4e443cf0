//! Time of one tick of 100 tracks for each prior: prediction, update and moment matching.

#[path = "../tests/support/bicycle.rs"]
mod bicycle;

use std::hint::black_box;

use bicycle::BICYCLE;
use criterion::{Criterion, criterion_group, criterion_main};
use filters::{ControlStep, Forecast, Gaussian, Mixture, Observation, Particles, Priors};

const TRACKS: usize = 100;
const HYPOTHESES: usize = 20;
const STEPS: usize = 12;
const PARTICLES: usize = 200;
const TICK_NS: u64 = 80_000_000;

fn ticks(criterion: &mut Criterion) {
    let start = Gaussian::new([0.0, 0.0, 0.2, 8.0, 0.0], [0.01, 0.01, 0.001, 0.25, 1e-4]);
    let position = Observation::of_position([0.63, 0.12], 0.04);
    let observed = Observation { heading_rad: Some((0.2, 0.01)), ..position };
    let controls: Vec<ControlStep> = (0..HYPOTHESES * STEPS)
        .map(|i| ControlStep { mean: [0.2 * ((i / STEPS) as f64 - 10.0), 0.0], cholesky: [0.3, 0.0, 0.03] })
        .collect();
    let forecast = Forecast {
        age_ns: TICK_NS,
        step_ns: 400_000_000,
        heading_rad: 0.2,
        probability: &[1.0; HYPOTHESES],
        controls: &controls,
    };
    let priors = Priors::new(BICYCLE, BICYCLE);

    let mut plain = vec![start; TRACKS];
    criterion.bench_function("kinematic", |bencher| {
        bencher.iter(|| {
            for state in &mut plain {
                *state = start;
                black_box(state.predict(TICK_NS, &BICYCLE)).ok();
                black_box(state.update(&observed, &BICYCLE)).ok();
            }
        });
    });
    let mut mixtures = vec![Mixture::new(start, priors, 1); TRACKS];
    criterion.bench_function("mixture of 20, a forecast per tick", |bencher| {
        bencher.iter(|| {
            for mixture in &mut mixtures {
                mixture.reset(start);
                black_box(mixture.adopt(&forecast)).ok();
                black_box(mixture.predict(TICK_NS)).ok();
                black_box(mixture.update(&observed)).ok();
                black_box(mixture.moments());
            }
        });
    });
    let clouds = vec![Particles::new(&start, priors, PARTICLES, 1); TRACKS];
    let mut under_way = clouds.clone();
    criterion.bench_function("200 particles, a forecast per tick", |bencher| {
        bencher.iter(|| {
            under_way.clone_from(&clouds);
            for cloud in &mut under_way {
                black_box(cloud.adopt(&forecast)).ok();
                black_box(cloud.predict(TICK_NS)).ok();
                black_box(cloud.update(&observed)).ok();
                black_box(cloud.moments());
            }
        });
    });
}

criterion_group!(benches, ticks);
criterion_main!(benches);
