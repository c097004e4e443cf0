//! One tick of the tracker with n agents in view, associated by position.

use std::hint::black_box;

use bytemuck::Zeroable;
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tracker::{Tracker, TrackerOptions};
use wire::{AGENTS_MAX, Detection, Header, Track, detection_flags};

const TICKS: usize = 50;

/// Frames of `len` agents that drive straight through a square of 200 m, with noise.
fn frames(len: usize) -> Vec<Vec<Detection>> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut agents: Vec<(f32, f32, f32)> = (0..len)
        .map(|_| {
            let mut place = || rng.random_range(-100.0..100.0_f32);
            let (x, y) = (place(), place());
            (x, y, rng.random_range(-3.0..3.0))
        })
        .collect();
    let mut frame = || {
        agents
            .iter_mut()
            .map(|(x, y, heading)| {
                *x += 0.4 * heading.cos();
                *y += 0.4 * heading.sin();
                let mut noise = || rng.random_range(-0.1..0.1_f32);
                Detection {
                    x_m: *x + noise(),
                    y_m: *y + noise(),
                    heading_rad: *heading + noise(),
                    flags: detection_flags::HAS_HEADING,
                    ..Detection::zeroed()
                }
            })
            .collect()
    };
    (0..TICKS).map(|_| frame()).collect()
}

fn tick(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("tick");
    for len in [10, 100, 500] {
        let frames = frames(len);
        let mut out = vec![Track::zeroed(); AGENTS_MAX];
        let mut tracker = Tracker::new(TrackerOptions::default());
        let mut tick = 0_usize;
        group.bench_function(BenchmarkId::from_parameter(len), |bencher| {
            bencher.iter(|| {
                // There and back again: the scene never jumps, however many ticks the measurement takes.
                let place = tick % (2 * TICKS - 2);
                let frame = &frames[place.min(2 * TICKS - 2 - place)];
                let header =
                    Header { observed_types: 0b111, ..Header::new(1, tick as u64, tick as i64 * 80_000_000) };
                tick += 1;
                black_box(tracker.step(&header, frame, None, &mut out).is_ok())
            });
        });
    }
    group.finish();
}

criterion_group!(benches, tick);
criterion_main!(benches);
