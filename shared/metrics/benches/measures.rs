//! Times of two groups of measures:
//!
//! * forecasts: one agent with 20 modes of 12 steps, which an evaluation repeats for every window;
//! * tracking: frames of 100 objects.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use metrics::tracking::{ClearMot, Frame, Hota, Object, SetDistance, linear_similarity};
use metrics::{Limits, Point, highest_density_level, kde_log_density, min_displacement};
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
    c.bench_function("minimum displacement of 20", |bench| {
        bench.iter(|| min_displacement(black_box(&modes), black_box(&truth)));
    });
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
        bench.iter(|| {
            black_box(&modes).iter().filter(|mode| limits.violated_by(&now, &mode[1..], 1.0)).count()
        });
    });
}

/// Ten frames of a hundred objects 3 m apart, each with a slightly displaced track.
fn frames() -> Vec<Frame> {
    let object = |frame: u32, id: u32, aside_m: f64| {
        let position_m = [f64::from(id % 10) * 3.0 + f64::from(frame), f64::from(id / 10) * 3.0 + aside_m];
        Object { id: id.into(), position_m }
    };
    let frame = |frame: u32| {
        let side = |aside_m: f64| (0..100).map(|id| object(frame, id, aside_m)).collect::<Vec<_>>();
        Frame::new(&side(0.0), &side(0.4)).expect("finite positions, distinct ids")
    };
    (0..10).map(frame).collect()
}

fn tracking(c: &mut Criterion) {
    let frames = frames();
    c.bench_function("CLEAR-MOT of 10 frames of 100", |bench| {
        bench.iter(|| {
            let mut clear_mot = ClearMot::new(1.0).expect("a gate in range");
            black_box(&frames).iter().for_each(|frame| clear_mot.add(frame));
            clear_mot.finish()
        });
    });
    c.bench_function("HOTA of 10 frames of 100", |bench| {
        bench.iter(|| {
            let mut hota = Hota::default();
            let similarity = |distance_m| linear_similarity(distance_m, 4.0);
            black_box(&frames).iter().for_each(|frame| hota.add(frame, similarity));
            hota.finish()
        });
    });
    let distance = SetDistance::new(4.0, 2.0).expect("an ordinary cutoff");
    c.bench_function("GOSPA of a frame of 100", |bench| bench.iter(|| distance.gospa(black_box(&frames[0]))));
}

criterion_group!(benches, displacements, densities, limits, tracking);
criterion_main!(benches);
