//! Cost of the end-to-end protection: the check value of a frame of each topic with 32 and 128 agents. The
//! sender and every reader compute it once.
//!
//! Before that, the benchmark counts the single bit flips in header or payload of a forecasts frame that pass
//! the checks of numbers and sizes. Without a check value these are the only checks.

use std::hint::black_box;

use bytemuck::{Zeroable, bytes_of_mut, cast_slice_mut};
use criterion::{Criterion, criterion_group, criterion_main};
use wire::{
    ContextTopic, ControlsTopic, Counts, DetectionsTopic, EncodingsTopic, FeaturesTopic, Forecast,
    ForecastsTopic, Header, Protection, Topic, TracksTopic,
};

const FLIPS: usize = 10_000;

fn protect<T: Topic>(c: &mut Criterion) {
    for agents in [32_u32, 128] {
        // Eight neighbours at each step, and patches of 16 × 16 cells.
        let (history_len, edges_len) = (8, 8 * agents * 9);
        let counts =
            Counts { agents_len: agents, history_len, patch_side: 16, edges_len, ..Counts::default() };
        let payload = vec![T::Element::zeroed(); T::elements_len(&counts)];
        let header = Header { counts, ..Header::new(1, 2, 3) };
        let kilobytes = size_of_val(&payload[..]) as f64 / 1e3;
        c.bench_function(&format!("{} of {agents} agents, {kilobytes:.0} kB", T::NAME), |bench| {
            bench.iter(|| Protection::of::<T>(black_box(&header), black_box(&payload), 0));
        });
    }
}

/// The next number below `most` of a linear congruential generator.
fn next(state: &mut u64, most: usize) -> usize {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    ((*state >> 33) as usize) % most
}

fn flips() {
    let mut good = Header::new(1, 2, 3);
    good.counts.agents_len = 8;
    let number = |i: usize| (i % 97) as f32 * 0.25;
    let forecast = Forecast {
        x_m: 12.5,
        y_m: -3.0,
        modes: std::array::from_fn(|k| std::array::from_fn(|step| [number(k + step), number(k * step)])),
        ..Forecast::default()
    };
    let (frame, mut state, mut passed) = ([forecast; 8], 1, 0);
    for _ in 0..FLIPS {
        let (mut header, mut frame) = (good, frame);
        let place = next(&mut state, size_of::<Header>() + size_of_val(&frame));
        let bit = 1 << next(&mut state, 8);
        match place.checked_sub(size_of::<Header>()) {
            None => bytes_of_mut(&mut header)[place] ^= bit,
            Some(place) => cast_slice_mut::<_, u8>(&mut frame)[place] ^= bit,
        }
        let is_of_the_run = header.run_id == good.run_id && header.counts.agents_len == 8;
        passed += usize::from(
            is_of_the_run && header.check().is_ok() && frame.iter().all(|forecast| forecast.check().is_ok()),
        );
    }
    println!("{passed} of {FLIPS} bit flips in a frame of 8 forecasts pass without a check value");
}

fn costs(c: &mut Criterion) {
    flips();
    protect::<DetectionsTopic>(c);
    protect::<TracksTopic>(c);
    protect::<ContextTopic>(c);
    protect::<FeaturesTopic>(c);
    protect::<EncodingsTopic>(c);
    protect::<ControlsTopic>(c);
    protect::<ForecastsTopic>(c);
}

criterion_group!(benches, costs);
criterion_main!(benches);
