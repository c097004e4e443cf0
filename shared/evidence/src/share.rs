//! Counts how often each of a few candidates has been the nearest.

use crate::fading;

/// The discounted share of matured forecasts in which each candidate has been the nearest.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shares<const N: usize> {
    nearest: [f64; N],
}

impl<const N: usize> Shares<N> {
    /// Initial shares with the weight of `len` forecasts.
    pub(crate) fn new(shares: [f32; N], len: f64) -> Self {
        Self { nearest: shares.map(|share| len * f64::from(share)) }
    }

    pub(crate) fn discount(&mut self, kept: f64) {
        let kept = fading(kept, self.nearest.iter().sum());
        self.nearest.iter_mut().for_each(|nearest| *nearest *= kept);
    }

    /// Adds a forecast by its distances to the candidates.
    pub(crate) fn add(&mut self, distances_m: &[f32; N], weight: f32) {
        let nearest = self.nearest.iter_mut().zip(distances_m).min_by(|a, b| a.1.total_cmp(b.1));
        nearest.into_iter().for_each(|(nearest, _)| *nearest += f64::from(weight));
    }

    pub(crate) fn get(&self) -> [f32; N] {
        let sum: f64 = self.nearest.iter().sum();
        self.nearest.map(|nearest| (nearest / sum) as f32)
    }

    /// The shares, sharpened: s_i^p / Σ s_j^p.
    pub(crate) fn decided(&self, power: i32) -> [f32; N] {
        let powers = self.get().map(|share| share.powi(power));
        let sum: f32 = powers.iter().sum();
        powers.map(|power| power / sum)
    }

    /// Calls `each` with all numbers, to read or to change them.
    pub(crate) fn numbers(&mut self, each: &mut impl FnMut(&mut f64)) {
        self.nearest.iter_mut().for_each(each);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_begin_with_their_prior_and_follow_what_is_nearest() {
        let mut shares = Shares::new([0.3, 0.7], 10.0);
        assert_eq!(shares.get(), [0.3, 0.7]);
        (0..30).for_each(|_| shares.add(&[1.0, 2.0], 1.0));
        assert_eq!(shares.get(), [33.0 / 40.0, 7.0 / 40.0]);
    }

    #[test]
    fn decided_shares_keep_what_is_certain_and_what_is_even() {
        let decided = |shares: [f32; 2]| Shares::new(shares, 1.0).decided(4);
        assert_eq!([[0.0, 1.0], [0.5, 0.5]].map(decided), [[0.0, 1.0], [0.5, 0.5]]);
        assert!(decided([0.7, 0.3])[0] > 0.95);
    }
}
