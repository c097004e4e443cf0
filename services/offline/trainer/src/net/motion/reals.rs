//! Real numbers in the lanes of a vector, so that kernels read like formulas.

use std::ops::{Add, Div, Mul, Sub};

use nn::kernels::{self, Lanes};

/// A real number in each of `L::LEN` lanes.
#[derive(Clone, Copy)]
pub(super) struct Reals<L: Lanes> {
    lanes: L,
    values: L::V,
}

impl<L: Lanes> Reals<L> {
    #[inline(always)]
    const fn new(lanes: L, values: L::V) -> Self {
        Self { lanes, values }
    }

    /// The same number in all lanes.
    #[inline(always)]
    pub(super) fn splat(lanes: L, x: f32) -> Self {
        Self::new(lanes, lanes.splat(x))
    }

    /// The first numbers of a slice.
    #[inline(always)]
    pub(super) fn load(lanes: L, from: &[f32]) -> Self {
        Self::new(lanes, lanes.load(from))
    }

    /// Sets the first numbers of a slice.
    #[inline(always)]
    pub(super) fn store(self, to: &mut [f32]) {
        self.lanes.store(to, self.values);
    }

    /// The nearest number within ± `limit`, and 1 if the number is unchanged, otherwise 0.
    #[inline(always)]
    pub(super) fn clamp(self, limit: f32) -> (Self, Self) {
        let l = self.lanes;
        let clamped = Self::new(l, l.max(l.min(self.values, l.splat(limit)), l.splat(-limit)));
        // Lanes have no comparison. A float's distance to the limit times 1e15 is more than 1 if it exceeds
        // the limit.
        let excess = (self - clamped) * 1e15;
        let outside = Self::new(l, l.min((excess * excess).values, l.splat(1.0)));
        (clamped, Self::splat(l, 1.0) - outside)
    }

    #[inline(always)]
    pub(super) fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = kernels::sin_cos(self.lanes, self.values);
        (Self::new(self.lanes, sin), Self::new(self.lanes, cos))
    }

    #[inline(always)]
    pub(super) fn tanh(self) -> Self {
        Self::new(self.lanes, kernels::tanh(self.lanes, self.values))
    }
}

macro_rules! operators {
    ($($operator:ident::$name:ident;)+) => {
        $(
            impl<L: Lanes> $operator for Reals<L> {
                type Output = Self;

                #[inline(always)]
                fn $name(self, other: Self) -> Self {
                    Self::new(self.lanes, self.lanes.$name(self.values, other.values))
                }
            }
        )+
    };
}

operators! {
    Add::add;
    Sub::sub;
    Mul::mul;
    Div::div;
}

impl<L: Lanes> Mul<f32> for Reals<L> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, factor: f32) -> Self {
        self * Self::splat(self.lanes, factor)
    }
}

impl<L: Lanes> Add<f32> for Reals<L> {
    type Output = Self;

    #[inline(always)]
    fn add(self, summand: f32) -> Self {
        self + Self::splat(self.lanes, summand)
    }
}
