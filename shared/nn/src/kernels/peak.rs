//! The peak of this processor, measured in the same run for comparison with the kernels.

use std::hint::black_box;
use std::time::{Duration, Instant};

use super::product::{Gather, Panels, Product};
use super::{Kernel, Lanes, dispatch};
use crate::buffer::Buffer;

/// Steps of the register loop in one timing.
const STEPS: usize = 1 << 16;
/// Side length of the multiplied matrices.
const SIDE: usize = 512;

struct Fma;

impl Kernel for Fma {
    type Output = usize;

    /// Runs [`STEPS`] multiply-adds on each of several independent sums; returns the number of floating-point
    /// operations.
    ///
    /// There are enough sums to hide the latency of a multiply-add. They stay in registers, together with two
    /// factors.
    #[inline(always)]
    fn run<L: Lanes>(self, l: L) -> usize {
        if L::REGISTERS == 32 { chains::<L, 24>(l) } else { chains::<L, 12>(l) }
    }
}

#[inline(always)]
fn chains<L: Lanes, const CHAINS: usize>(l: L) -> usize {
    let (a, b) = (l.splat(black_box(0.999)), l.splat(black_box(1e-3)));
    let mut sums = [b; CHAINS];
    for _ in 0..STEPS {
        for sum in &mut sums {
            *sum = l.fma(*sum, a, b);
        }
    }
    let mut total = [0.0; 16];
    for sum in sums {
        l.store(&mut total, sum);
        black_box(&total);
    }
    2 * STEPS * CHAINS * L::LEN
}

/// Multiply-adds in registers: the best result within `budget`, in GFLOP/s of one thread.
#[must_use]
pub fn fma_gflops(budget: Duration) -> f64 {
    best(budget, || dispatch(Fma))
}

/// The same for the product of two packed 512 × 512 matrices.
#[must_use]
pub fn product_gflops(budget: Duration) -> f64 {
    let value = |i: usize| ((i * 37) % 101) as f32 * 0.01 - 0.5;
    let panels = Panels::pack([SIDE, 1, SIDE], |o, _, i| value(o * SIDE + i), value);
    let mut input = Buffer::zeroed(SIDE * SIDE);
    for (i, x) in input.iter_mut().enumerate() {
        *x = value(i);
    }
    let mut out = Buffer::zeroed(SIDE * SIDE);
    best(budget, || {
        let gather = Gather::Rows { stride: SIDE };
        Product { input: &input, gather, panels: &panels, residual: None, relu: false, out: &mut out }.run();
        black_box(out[0]);
        2 * SIDE * SIDE * SIDE
    })
}

fn best(budget: Duration, mut work: impl FnMut() -> usize) -> f64 {
    let start = Instant::now();
    let mut best = 0.0_f64;
    while start.elapsed() < budget || best == 0.0 {
        let before = Instant::now();
        let operations = work();
        best = best.max(operations as f64 / before.elapsed().as_nanos().max(1) as f64);
    }
    best
}
