//! Sums that do not depend on the order of their terms.
//!
//! A sum of f64 depends on the order: (1e16 + 1) − 1e16 is 0, but (1e16 − 1e16) + 1 is 1. Two machines that
//! split the same recordings in different ways would therefore print different last digits. An [`ExactSum`]
//! is an integer, so any order and any split give the same sum to the bit.

use serde::{Deserialize, Serialize};

/// Units per 1: terms are whole multiples of 2⁻⁶⁰.
const UNITS: f64 = (1_u64 << 60) as f64;
/// Terms beyond this size count as this size. More than 10⁹ of them fit a sum.
const TERM_MAX: f64 = (1_u64 << 36) as f64;

/// A sum whose value does not depend on the order of its terms.
///
/// A term is rounded to a multiple of 2⁻⁶⁰, and limited to ± 2³⁶. Terms of at least 2⁻⁸ are therefore exact.
/// A term that is not a number counts as 2³⁶, so that the sum shows it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ExactSum(i128);

impl ExactSum {
    /// Adds a term.
    pub fn add(&mut self, term: f64) {
        let term = if term.is_nan() { TERM_MAX } else { term.clamp(-TERM_MAX, TERM_MAX) };
        self.0 += (term * UNITS).round() as i128;
    }

    /// Adds all terms of `other`.
    pub const fn merge(&mut self, other: &Self) {
        self.0 += other.0;
    }

    /// The sum, rounded once.
    pub fn value(&self) -> f64 {
        self.0 as f64 / UNITS
    }

    /// The sum times a factor.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self((self.0 as f64 * factor).round() as i128)
    }
}

/// A running mean that does not depend on the order of its values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExactMean {
    sum: ExactSum,
    len: u64,
}

impl ExactMean {
    /// Counts one value.
    pub fn add(&mut self, value: f64) {
        self.sum.add(value);
        self.len += 1;
    }

    /// Adds the counts of `other`.
    pub const fn merge(&mut self, other: &Self) {
        self.sum.merge(&other.sum);
        self.len += other.len;
    }

    /// The mean; `None` if nothing was counted.
    pub fn value(&self) -> Option<f64> {
        (self.len > 0).then(|| self.sum.value() / self.len as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sum(terms: &[f64]) -> ExactSum {
        let mut sum = ExactSum::default();
        terms.iter().for_each(|term| sum.add(*term));
        sum
    }

    #[test]
    fn large_terms_do_not_hide_small_ones() {
        assert_eq!(sum(&[3e10, 1e-9, -3e10]).value(), sum(&[1e-9]).value());
        assert_eq!([3e10, 1e-9, -3e10].iter().sum::<f64>(), 0.0, "as f64 hides it");
    }

    #[test]
    fn terms_that_are_no_numbers_show() {
        for term in [f64::NAN, f64::INFINITY, 1e300] {
            assert_eq!(sum(&[1.0, term]).value(), TERM_MAX + 1.0);
        }
        assert_eq!(sum(&[f64::NEG_INFINITY]).value(), -TERM_MAX);
        assert_eq!(ExactMean::default().value(), None);
    }

    #[test]
    fn scaled_sums_equal_sums_of_scaled_terms() {
        let terms = [0.1, 0.2, 5.0];
        assert!((sum(&terms).scaled(20.0).value() - 106.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn every_order_and_split_gives_the_same_sum(
            terms in proptest::collection::vec((-1e6..1e6_f64, any::<u32>(), 0..4_usize), 0..200),
        ) {
            let plain: Vec<f64> = terms.iter().map(|(term, ..)| *term).collect();
            let whole = sum(&plain);
            let mut shuffled = terms.clone();
            shuffled.sort_by_key(|(_, key, _)| *key);
            let mut parts = [ExactSum::default(); 4];
            shuffled.iter().for_each(|(term, _, part)| parts[*part].add(*term));
            let mut merged = ExactSum::default();
            parts.iter().rev().for_each(|part| merged.merge(part));
            prop_assert_eq!(merged, whole);
            let size: f64 = plain.iter().map(|term| term.abs()).sum();
            prop_assert!((whole.value() - plain.iter().sum::<f64>()).abs() <= 1e-13 * size.max(1.0));
        }
    }
}
