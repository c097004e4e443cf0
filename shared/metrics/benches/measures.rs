//! Times of the measures for one agent with 20 modes of 12 steps: an evaluation repeats them for every window.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use metrics::{Limits, Point, best_of, highest_density_level, kde_log_density};
use scene::State;

const MODES: usize = 20;
const STEPS: usize = 12;

/// Modes that fan out from the origin.
fn modes() -> Vec<[Point; STEPS]> {
    let mode = |k: usize| {
        let (sin, cos) = (k as f32 * 0.1 - 1.0).sin_cos();
        std::array::from_fn(|step| [cos * step as f32, sin * step as f32])
    };
    (0..MODES).map(mode).collect()
}

fn displacements(c: &mut Criterion) {
    let modes = modes();
    let truth: [Option<Point>; STEPS] = std::array::from_fn(|step| Some([step as f32, 0.3]));
    c.bench_function("best of 20", |bench| bench.iter(|| best_of(black_box(&modes), black_box(&truth))));
}

fn densities(c: &mut Criterion) {
    let ends: Vec<Point> = modes().iter().map(|mode| mode[STEPS - 1]).collect();
    let covariances = [[1.0, 0.2, 0.5]; MODES];
    let probability = [1.0 / MODES as f32; MODES];
    let truth = [9.0, 1.0];
    c.bench_function("kernel density of a step", |bench| {
        bench.iter(|| kde_log_density(black_box(&ends), &probability, truth));
    });
    c.bench_function("highest-density level of a step", |bench| {
        bench.iter(|| highest_density_level(black_box(&ends), &covariances, &probability, truth, 7));
    });
}

fn limits(c: &mut Criterion) {
    let modes = modes();
    let now = State { velocity_mps: [1.0, 0.0], ..State::default() };
    let limits = Limits::vehicle(1.2);
    c.bench_function("limits of 20", |bench| {
        bench
            .iter(|| black_box(&modes).iter().filter(|mode| limits.broken_by(&now, &mode[1..], 1.0)).count());
    });
}

criterion_group!(benches, displacements, densities, limits);
criterion_main!(benches);
