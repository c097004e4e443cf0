//! Exponential function, logistic function and hyperbolic tangent on vectors.

use super::{Kernel, Lanes, dispatch};

/// e^x within 2 units in the last place; x is held to the range in which the result is a normal number.
///
/// x = n ln 2 + r with |r| ≤ ½ ln 2, e^r by a polynomial, 2^n by the exponent bits. (Cephes, `expf`.)
#[inline(always)]
pub fn exp<L: Lanes>(l: L, x: L::V) -> L::V {
    const POLYNOMIAL: [f32; 6] =
        [1.987_569_1e-4, 1.398_2e-3, 8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 0.5];
    let x = l.max(l.min(x, l.splat(88.0)), l.splat(-87.0));
    let n = l.round(l.mul(x, l.splat(std::f32::consts::LOG2_E)));
    let r = l.fma(n, l.splat(-0.693_359_4), x);
    let r = l.fma(n, l.splat(2.121_944_4e-4), r);
    let mut p = l.splat(POLYNOMIAL[0]);
    for &coefficient in &POLYNOMIAL[1..] {
        p = l.fma(p, r, l.splat(coefficient));
    }
    let one = l.splat(1.0);
    let e = l.fma(l.mul(r, r), p, l.add(r, one));
    l.mul(e, l.pow2(n))
}

/// 1 / (1 + e^−x).
#[inline(always)]
pub fn sigmoid<L: Lanes>(l: L, x: L::V) -> L::V {
    let one = l.splat(1.0);
    l.div(one, l.add(one, exp(l, l.sub(l.splat(0.0), x))))
}

/// tanh x = 1 − 2 / (1 + e^2x): within 2e-7 of the value, not relative to it.
#[inline(always)]
pub fn tanh<L: Lanes>(l: L, x: L::V) -> L::V {
    let one = l.splat(1.0);
    l.sub(one, l.div(l.splat(2.0), l.add(one, exp(l, l.add(x, x)))))
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

    #[test]
    fn exponentials_agree_with_double_precision() {
        let x: Vec<f32> = (-8700..=8799).map(|i| i as f32 * 0.01).collect();
        let mut y = x.clone();
        exp_in_place(&mut y);
        for (x, y) in x.iter().zip(&y) {
            let truth = f64::from(*x).exp();
            assert!((f64::from(*y) / truth - 1.0).abs() < 3e-7, "exp {x} = {y}, not {truth}");
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
