//! Times of the layers, with the processor's peak for comparison.
//!
//! Throughput is in live multiply-adds (two operations each): 1 Gelem/s is 2 GFLOP/s. The first lines print
//! the peak, measured in the same run. `STGDAT_KERNELS=avx2` selects an instruction set other than the
//! fastest.

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use nn::kernels::{self, peak};
use nn::{BurnIn, ContextCnn, ContextMemory, Decoder, DecoderMemory, Draws, Precision, RAW_CONTROL, Weights};
use testing::value;
use wire::AgentType;

/// Side length of the matrices in the comparison.
const SIDE: usize = 512;

/// Peak, our product and faer's on the same instruction set, alternating, so that other load on the machine
/// affects all of them. Prints the best of each.
fn yardstick(_: &mut Criterion) {
    let (turns, time) = (25, Duration::from_millis(40));
    let mut faer = Faer::new();
    let mut best = [0.0_f64; 3];
    for _ in 0..turns {
        let turn = [peak::fma_gflops(time), peak::product_gflops(time), faer.gflops(time)];
        best.iter_mut().zip(turn).for_each(|(best, new)| *best = best.max(new));
    }
    let [fma, ours, faer] = best;
    println!("kernels: {}", kernels::active());
    println!("multiply-adds in registers: {fma:.1} GFLOP/s");
    println!("matrix product {SIDE}, ours: {ours:.1} GFLOP/s, {:.2} of the multiply-adds", ours / fma);
    println!("matrix product {SIDE}, faer: {faer:.1} GFLOP/s; ours is {:.2} of it", ours / faer);
}

/// faer's product on the instruction set of our kernels. `faer::linalg::matmul` always uses the fastest set,
/// so on x86-64 this code calls the function that `matmul` calls.
struct Faer {
    a: Mat<f32>,
    b: Mat<f32>,
    out: Mat<f32>,
}

impl Faer {
    fn new() -> Self {
        let matrix = || Mat::from_fn(SIDE, SIDE, |i, j| value(i * SIDE + j));
        Self { a: matrix(), b: matrix(), out: matrix() }
    }

    fn gflops(&mut self, time: Duration) -> f64 {
        let (start, mut best) = (Instant::now(), 0.0_f64);
        while start.elapsed() < time {
            let before = Instant::now();
            self.multiply();
            best = best.max(2.0 * (SIDE * SIDE * SIDE) as f64 / before.elapsed().as_nanos() as f64);
        }
        best
    }

    fn multiply(&mut self) {
        let Self { a, b, out } = self;
        #[cfg(target_arch = "x86_64")]
        if kernels::active() == kernels::Isa::Avx2 {
            return on_avx2(a, b, out);
        }
        matmul(out, Accum::Replace, &*a, &*b, 1.0, Par::Seq);
    }
}

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "faer's inner function takes pointers")]
fn on_avx2(a: &Mat<f32>, b: &Mat<f32>, out: &mut Mat<f32>) {
    use private_gemm_x86::{Accum, DType, DstKind, IType, InstrSet, gemm};
    let none = std::ptr::null();
    // SAFETY: the matrices have the given side lengths, the scalar has the given type, and AVX2 is in use.
    unsafe {
        gemm(
            DType::F32,
            IType::U64,
            InstrSet::Avx256,
            out.nrows(),
            out.ncols(),
            a.ncols(),
            out.as_ptr_mut().cast(),
            out.row_stride(),
            out.col_stride(),
            none,
            none,
            DstKind::Full,
            Accum::Replace,
            a.as_ptr().cast(),
            a.row_stride(),
            a.col_stride(),
            false,
            none,
            0,
            b.as_ptr().cast(),
            b.row_stride(),
            b.col_stride(),
            false,
            (&raw const ONE).cast(),
            1,
        );
    }
}

#[cfg(target_arch = "x86_64")]
static ONE: f32 = 1.0;

fn context(c: &mut Criterion) {
    let cnn = ContextCnn::new(&Weights::onboard()).expect("onboard weights");
    let mut group = c.benchmark_group("context CNN");
    for patch_count in [1, 16, 64] {
        let patches: Vec<f32> = (0..patch_count * cnn.patch_len()).map(value).collect();
        let (mut out, mut memory) = (vec![[0.0; 32]; patch_count], ContextMemory::default());
        group.throughput(Throughput::Elements((patch_count * cnn.multiply_adds()) as u64));
        group.bench_function(BenchmarkId::from_parameter(patch_count), |bench| {
            bench.iter(|| cnn.embed(black_box(&patches), &mut memory, &mut out));
        });
    }
    group.finish();
}

fn decoder(c: &mut Criterion) {
    let weights = Weights::onboard();
    let (agents_len, draw_count, step_count, horizon_len) = (32, 20, 8, 12);
    let states: Vec<[f32; 6]> = (0..agents_len * step_count).map(|i| [value(i); 6]).collect();
    let present = vec![true; states.len()];
    let latents: Vec<[f32; 32]> = (0..agents_len * draw_count).map(|i| [value(i); 32]).collect();
    let summaries: Vec<[f32; 64]> = (0..agents_len).map(|i| [value(i); 64]).collect();
    let mut hidden = vec![[0.0; 128]; agents_len];
    let mut out = vec![[0.0; RAW_CONTROL]; latents.len() * horizon_len];
    let mut memory = DecoderMemory::default();
    let mut group = c.benchmark_group("decoder");
    let steps = agents_len * step_count + latents.len() * horizon_len;
    group.throughput(Throughput::Elements((steps * 384 * 128) as u64));
    for precision in [Precision::F32, Precision::Bf16] {
        if let Err(why) = precision.check() {
            println!("skipped: {why}");
            continue;
        }
        let decoder = Decoder::with_precision(&weights, precision).expect("onboard weights");
        let decoder = decoder.of(AgentType::Vehicle);
        group.bench_function(format!("32 agents, 20 draws, 12 steps, {precision}"), |bench| {
            bench.iter(|| {
                let agents = BurnIn { agents_len, states: &states, present: &present };
                decoder.burn_in(&agents, &mut memory, &mut hidden);
                let draws = Draws::Given(black_box(&latents));
                decoder.forecast(&hidden, &summaries, draws, &mut memory, &mut out);
            });
        });
    }
    group.finish();
}

criterion_group! {
    name = layers;
    config = Criterion::default().measurement_time(Duration::from_secs(2)).warm_up_time(Duration::from_millis(500));
    targets = yardstick, context, decoder
}
criterion_main!(layers);
