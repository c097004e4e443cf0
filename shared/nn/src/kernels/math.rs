//! Exponential function, logistic function, hyperbolic tangent, sine and cosine on vectors.

use super::lanes::SHIFT;
use super::{Kernel, Lanes, dispatch};

/// e^x within 2 units in the last place; x is clamped to the range with normal results.
///
/// x = n ln 2 + r with whole n and |r| ≤ ½ ln 2, e^r by a polynomial, 2^n by the exponent bits.
#[inline(always)]
pub fn exp<L: Lanes>(l: L, x: L::V) -> L::V {
    const EXPONENTIAL: Exponential = Exponential { factor: 1.0, range: [-87.0, 88.0] };
    let (r, shifted) = EXPONENTIAL.reduce(l, x);
    EXPONENTIAL.raise(l, r, shifted)
}

/// e^(f x) in two halves, with f folded into the constants of both instead of a multiplication.
pub(crate) struct Exponential {
    /// f: plus or minus a power of two, so that the result has the same bits as for a precomputed f x.
    pub(crate) factor: f32,
    /// The range to which x is clamped.
    pub(crate) range: [f32; 2],
}

impl Exponential {
    /// (r / f, [`SHIFT`] + n) with f x = n ln 2 + r.
    #[inline(always)]
    pub(crate) fn reduce<L: Lanes>(&self, l: L, x: L::V) -> (L::V, L::V) {
        /// −ln 2 in two parts: n times the first is exact.
        const MINUS_LN_2: [f32; 2] = [-0.693_359_4, 2.121_944_4e-4];
        let Self { factor, range: [least, most] } = *self;
        let x = l.max(l.min(x, l.splat(most)), l.splat(least));
        let shifted = l.fma(x, l.splat(std::f32::consts::LOG2_E * factor), l.splat(SHIFT));
        let n = l.sub(shifted, l.splat(SHIFT));
        let r = l.fma(n, l.splat(MINUS_LN_2[0] / factor), x);
        (l.fma(n, l.splat(MINUS_LN_2[1] / factor), r), shifted)
    }

    /// e^r 2^n from the result of [`reduce`](Self::reduce).
    #[inline(always)]
    pub(crate) fn raise<L: Lanes>(&self, l: L, rest: L::V, shifted: L::V) -> L::V {
        /// Polynomial for e^r, lowest power first, with a relative error of at most 9.2e-8 for |r| ≤ ½ ln 2.
        /// The coefficients besides the first minimise that error.
        const POLYNOMIAL: [f32; 6] =
            [1.0, 9.999_997e-1, 4.999_915e-1, 1.666_763_7e-1, 4.189_797_5e-2, 8.290_306e-3];
        let of_rest = |power: usize| POLYNOMIAL[power] * self.factor.powi(power as i32);
        let mut p = l.splat(of_rest(5));
        for power in (0..5).rev() {
            p = l.fma(p, rest, l.splat(of_rest(power)));
        }
        l.scale(p, shifted)
    }
}

/// 1 / (1 + e^−x).
#[inline(always)]
pub fn sigmoid<L: Lanes>(l: L, x: L::V) -> L::V {
    let one = l.splat(1.0);
    l.div(one, l.add(one, exp(l, l.sub(l.splat(0.0), x))))
}

/// tanh x = 1 − 2 / (1 + e^2x), with an absolute error below 2e-7.
#[inline(always)]
pub fn tanh<L: Lanes>(l: L, x: L::V) -> L::V {
    let one = l.splat(1.0);
    l.sub(one, l.div(l.splat(2.0), l.add(one, exp(l, l.add(x, x)))))
}

/// (sin x, cos x) within 2e-7, for |x| up to 300 rad.
///
/// x = n π + r with |r| ≤ ½ π, both functions of r by polynomials, (−1)^n by the parity of n.
#[inline(always)]
pub fn sin_cos<L: Lanes>(l: L, x: L::V) -> (L::V, L::V) {
    /// (sin r − r) / r³ and (cos r − 1 + ½ r²) / r⁴ as polynomials in r², interpolated at Chebyshev points.
    const SIN: [f32; 4] = [2.634_638e-6, -1.982_270_3e-4, 8.333_242e-3, -1.666_666_6e-1];
    const COS: [f32; 4] = [-2.654_507_3e-7, 2.478_605_2e-5, -1.388_881_2e-3, 4.166_666_6e-2];
    let one = l.splat(1.0);
    let n = l.round(l.mul(x, l.splat(std::f32::consts::FRAC_1_PI)));
    // π in two parts, so that the product with the first is exact.
    let r = l.fma(n, l.splat(-3.140_625), x);
    let r = l.fma(n, l.splat(-9.676_536e-4), r);
    let squared = l.mul(r, r);
    let (mut sin, mut cos) = (l.splat(SIN[0]), l.splat(COS[0]));
    for (by_sin, by_cos) in SIN[1..].iter().zip(&COS[1..]) {
        sin = l.fma(sin, squared, l.splat(*by_sin));
        cos = l.fma(cos, squared, l.splat(*by_cos));
    }
    let sin = l.fma(l.mul(sin, squared), r, r);
    let cos = l.fma(l.fma(cos, squared, l.splat(-0.5)), squared, one);
    // ±1 if n is odd and 0 if it is even.
    let odd = l.sub(n, l.mul(l.splat(2.0), l.round(l.mul(n, l.splat(0.5)))));
    let sign = l.fma(l.mul(odd, odd), l.splat(-2.0), one);
    (l.mul(sign, sin), l.mul(sign, cos))
}

struct Exp<'a>(&'a mut [f32]);

impl Kernel for Exp<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let mut chunks = self.0.chunks_exact_mut(L::LEN);
        for chunk in &mut chunks {
            let e = exp(lanes, lanes.load(chunk));
            lanes.store(chunk, e);
        }
        let rest = chunks.into_remainder();
        let mut padded = [0.0; 16];
        padded[..rest.len()].copy_from_slice(rest);
        let e = exp(lanes, lanes.load(&padded));
        lanes.store(&mut padded, e);
        rest.copy_from_slice(&padded[..rest.len()]);
    }
}

/// Replaces every value by its exponential.
pub fn exp_in_place(values: &mut [f32]) {
    dispatch(Exp(values));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::{Isa, portable};

    struct Both<'a>(&'a [f32], &'a mut [f32], &'a mut [f32]);

    impl Kernel for Both<'_> {
        type Output = ();

        #[inline(always)]
        fn run<L: Lanes>(self, l: L) {
            for i in (0..self.0.len()).step_by(L::LEN) {
                let x = l.load(&self.0[i..]);
                l.store(&mut self.1[i..], sigmoid(l, x));
                l.store(&mut self.2[i..], tanh(l, x));
            }
        }
    }

    struct SinCos<'a>(&'a [f32], &'a mut [f32], &'a mut [f32]);

    impl Kernel for SinCos<'_> {
        type Output = ();

        #[inline(always)]
        fn run<L: Lanes>(self, l: L) {
            for i in (0..self.0.len()).step_by(L::LEN) {
                let (sin, cos) = sin_cos(l, l.load(&self.0[i..]));
                l.store(&mut self.1[i..], sin);
                l.store(&mut self.2[i..], cos);
            }
        }
    }

    #[test]
    fn sines_and_cosines_agree_with_double_precision_on_every_set() {
        let x: Vec<f32> = (0..1 << 16).map(|i| (i as f32 - 32768.0) * 0.009).collect();
        for isa in [Isa::Portable, crate::kernels::active()] {
            let (mut s, mut c) = (vec![0.0; x.len()], vec![0.0; x.len()]);
            let both = SinCos(&x, &mut s, &mut c);
            if isa == Isa::Portable {
                portable::run(both);
            } else {
                dispatch(both);
            }
            for (i, &x) in x.iter().enumerate() {
                let (sin, cos) = f64::from(x).sin_cos();
                assert!((f64::from(s[i]) - sin).abs() < 2e-7, "sin {x} = {}, not {sin}", s[i]);
                assert!((f64::from(c[i]) - cos).abs() < 2e-7, "cos {x} = {}, not {cos}", c[i]);
            }
        }
    }

    #[test]
    fn exponentials_agree_with_double_precision_on_every_set() {
        let x: Vec<f32> = (-8700..=8799).map(|i| i as f32 * 0.01).collect();
        for isa in [Isa::Portable, crate::kernels::active()] {
            let mut y = x.clone();
            if isa == Isa::Portable {
                portable::run(Exp(&mut y));
            } else {
                exp_in_place(&mut y);
            }
            for (x, y) in x.iter().zip(&y) {
                let truth = f64::from(*x).exp();
                assert!((f64::from(*y) / truth - 1.0).abs() < 3e-7, "exp {x} = {y}, not {truth}");
            }
        }
    }

    #[test]
    fn logistic_function_and_tangent_agree_with_double_precision_on_every_set() {
        let x: Vec<f32> = (0..4096).map(|i| (i as f32 - 2048.0) * 0.05).collect();
        for isa in [Isa::Portable, crate::kernels::active()] {
            let (mut s, mut t) = (vec![0.0; x.len()], vec![0.0; x.len()]);
            let both = Both(&x, &mut s, &mut t);
            if isa == Isa::Portable {
                portable::run(both);
            } else {
                dispatch(both);
            }
            for (i, &x) in x.iter().enumerate() {
                let x = f64::from(x);
                assert!((f64::from(s[i]) - 1.0 / (1.0 + (-x).exp())).abs() < 2e-7, "sigmoid {x}");
                assert!((f64::from(t[i]) - x.tanh()).abs() < 3e-7, "tanh {x}");
            }
        }
    }
}
