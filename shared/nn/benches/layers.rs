//! Times of the layers beside the processor's peak.
//!
//! Throughput is in live multiply-adds (two operations each): 1 Gelem/s is 2 GFLOP/s. The first lines print
//! the peak that was measured in the same run. `STGDAT_KERNELS=avx2` measures another instruction set than the
//! fastest.

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use nn::kernels::{self, peak};
use nn::{BurnIn, ContextCnn, ContextMemory, Decoder, DecoderMemory, Draws, RAW_CONTROL, Weights};
use wire::AgentType;

fn value(i: usize) -> f32 {
    ((i * 37) % 101) as f32 * 0.01 - 0.5
}

fn yardstick(_: &mut Criterion) {
    let budget = Duration::from_millis(500);
    println!("kernels: {}", kernels::active());
    println!("multiply-adds in registers: {:.1} GFLOP/s", peak::fma_gflops(budget));
    println!("matrix product 512, ours: {:.1} GFLOP/s", peak::product_gflops(budget));
}

fn matrix_product(c: &mut Criterion) {
    let side = 512;
    let matrix = || Mat::from_fn(side, side, |i, j| value(i * side + j));
    let (a, b, mut out) = (matrix(), matrix(), matrix());
    let mut group = c.benchmark_group("matrix product 512");
    group.throughput(Throughput::Elements((side * side * side) as u64));
    group.bench_function("faer", |bench| {
        bench.iter(|| matmul(&mut out, Accum::Replace, &a, &b, 1.0, Par::Seq));
    });
    group.finish();
}

fn context(c: &mut Criterion) {
    let cnn = ContextCnn::new(&Weights::onboard()).expect("onboard weights");
    let mut group = c.benchmark_group("context CNN");
    for patches_len in [1, 16, 64] {
        let patches: Vec<f32> = (0..patches_len * cnn.patch_len()).map(value).collect();
        let (mut out, mut memory) = (vec![[0.0; 32]; patches_len], ContextMemory::default());
        group.throughput(Throughput::Elements((patches_len * cnn.multiply_adds()) as u64));
        group.bench_function(BenchmarkId::from_parameter(patches_len), |bench| {
            bench.iter(|| cnn.embed(black_box(&patches), &mut memory, &mut out));
        });
    }
    group.finish();
}

fn decoder(c: &mut Criterion) {
    let weights = Weights::onboard();
    let decoder = Decoder::new(&weights).expect("onboard weights");
    let decoder = decoder.of(AgentType::Vehicle);
    let (agents_len, draws_len, steps_len, horizon_len) = (32, 20, 8, 12);
    let states: Vec<[f32; 6]> = (0..agents_len * steps_len).map(|i| [value(i); 6]).collect();
    let present = vec![true; states.len()];
    let latents: Vec<[f32; 32]> = (0..agents_len * draws_len).map(|i| [value(i); 32]).collect();
    let summaries: Vec<[f32; 64]> = (0..agents_len).map(|i| [value(i); 64]).collect();
    let mut hidden = vec![[0.0; 128]; agents_len];
    let mut out = vec![[0.0; RAW_CONTROL]; latents.len() * horizon_len];
    let mut memory = DecoderMemory::default();
    let mut group = c.benchmark_group("decoder");
    let steps = agents_len * steps_len + latents.len() * horizon_len;
    group.throughput(Throughput::Elements((steps * 384 * 128) as u64));
    group.bench_function("32 agents, 20 draws, 12 steps", |bench| {
        bench.iter(|| {
            let agents = BurnIn { agents_len, states: &states, present: &present };
            decoder.burn_in(&agents, &mut memory, &mut hidden);
            decoder.forecast(&hidden, &summaries, Draws::Given(black_box(&latents)), &mut memory, &mut out);
        });
    });
    group.finish();
}

criterion_group! {
    name = layers;
    config = Criterion::default().measurement_time(Duration::from_secs(2)).warm_up_time(Duration::from_millis(500));
    targets = yardstick, matrix_product, context, decoder
}
criterion_main!(layers);
