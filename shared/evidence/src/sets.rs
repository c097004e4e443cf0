//! The probabilities of the network's and the fan's modes, from how often each set had the nearest mode.

use crate::fading;

/// Weight of the prior, in forecasts.
const PRIOR_LEN: f64 = 100.0;
/// Assumed forecasts of all speeds at the start, half for each set.
const EVEN_LEN: f64 = 10.0;
/// Minimum count of each set: an event that was not seen for days may still occur.
const LEAST_LEN: f64 = 0.01;

/// Matured forecasts of one type at all speeds in which the network, and the fan, had the nearest mode.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SetsOfType {
    nearest: [f64; 2],
    /// The counts that the prior would expect.
    expected: [f64; 2],
}

/// The counts at one speed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SetsAtSpeed {
    nearest: [f64; 2],
    /// The shares that the prior expects, and its remaining weight in forecasts.
    prior: [f32; 2],
    prior_count: f64,
}

impl SetsOfType {
    /// Count of the learned numbers.
    pub(crate) const NUMBERS_LEN: usize = 4;

    pub(crate) const fn new() -> Self {
        Self { nearest: [0.5 * EVEN_LEN; 2], expected: [0.5 * EVEN_LEN; 2] }
    }

    pub(crate) fn discount(&mut self, kept: f64) {
        let kept = fading(kept, self.nearest.iter().sum());
        self.nearest.iter_mut().chain(&mut self.expected).for_each(|sum| *sum *= kept);
    }

    /// The probability of each set at a speed.
    ///
    /// The odds of the network at all speeds are a multiple of the prior's odds, and the same multiple is
    /// expected at this speed. If s is the resulting share, the probability is s² / (s² + (1 − s)²).
    pub(crate) fn probability(&self, at: &SetsAtSpeed) -> [f32; 2] {
        let odds = |of: [f64; 2]| of[0].max(LEAST_LEN) / of[1].max(LEAST_LEN);
        let more = odds(self.nearest) / odds(self.expected);
        let [network, fan] = at.prior.map(f64::from);
        let expected = more * network / (more * network + fan);
        let network = at.nearest[0] + at.prior_count * expected;
        let fan = at.nearest[1] + at.prior_count * (1.0 - expected);
        let squares = [network * network, fan * fan];
        let sum: f64 = squares.iter().sum();
        squares.map(|square| (square / sum) as f32)
    }

    /// Calls `each` with all numbers, to read or to change them.
    pub(crate) fn numbers(&mut self, each: &mut impl FnMut(&mut f64)) {
        self.nearest.iter_mut().chain(&mut self.expected).for_each(each);
    }
}

impl SetsAtSpeed {
    /// Count of the learned numbers.
    pub(crate) const NUMBERS_LEN: usize = 3;

    /// A state with the network's share that the prior expects.
    pub(crate) fn new(network_share: f32) -> Self {
        Self { nearest: [0.0; 2], prior: [network_share, 1.0 - network_share], prior_count: PRIOR_LEN }
    }

    pub(crate) fn discount(&mut self, kept: f64) {
        let kept = fading(kept, self.nearest.iter().sum::<f64>() + self.prior_count);
        self.nearest.iter_mut().chain([&mut self.prior_count]).for_each(|sum| *sum *= kept);
    }

    /// Adds a forecast by the distances of the nearest mode of each set.
    pub(crate) fn add(&mut self, of_type: &mut SetsOfType, distances_m: [f32; 2], weight: f32) {
        let nearest = usize::from(distances_m[1] < distances_m[0]);
        self.nearest[nearest] += f64::from(weight);
        of_type.nearest[nearest] += f64::from(weight);
        for (sum, share) in of_type.expected.iter_mut().zip(self.prior) {
            *sum += f64::from(weight * share);
        }
    }

    /// The network's share of the forecasts, including the prior's.
    pub(crate) fn network_share(&self) -> f32 {
        let network = self.nearest[0] + self.prior_count * f64::from(self.prior[0]);
        (network / (self.nearest.iter().sum::<f64>() + self.prior_count)) as f32
    }

    /// Calls `each` with all learned numbers, to read or to change them.
    pub(crate) fn numbers(&mut self, each: &mut impl FnMut(&mut f64)) {
        self.nearest.iter_mut().chain([&mut self.prior_count]).for_each(each);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_begin_with_their_prior_and_follow_what_is_nearest() {
        let (mut of_type, mut at) = (SetsOfType::new(), SetsAtSpeed::new(0.4));
        assert!((of_type.probability(&at)[0] - 0.16 / (0.16 + 0.36)).abs() < 1e-6);
        assert!((at.network_share() - 0.4).abs() < 1e-6);
        (0..300).for_each(|_| at.add(&mut of_type, [1.0, 2.0], 1.0));
        assert!(of_type.probability(&at)[0] > 0.99 && (at.network_share() - 0.85).abs() < 1e-6);
    }

    #[test]
    fn what_was_nearest_at_one_speed_is_expected_at_the_others() {
        let (mut of_type, mut slow) = (SetsOfType::new(), SetsAtSpeed::new(0.5));
        let [fast, sure] = [0.5, 0.99].map(SetsAtSpeed::new);
        (0..90).for_each(|n| slow.add(&mut of_type, [1.0, if n % 10 < 2 { 2.0 } else { 0.5 }], 1.0));
        assert!(of_type.probability(&fast)[0] < 0.15);
        assert!(of_type.probability(&sure)[0] > 0.99);
    }

    #[test]
    fn a_set_that_has_not_been_the_nearest_for_days_is_improbable_and_no_more() {
        for (network_share, distances_m) in [(0.0, [2.0, 1.0]), (0.3, [2.0, 1.0]), (1.0, [2.0, 1.0])] {
            let (mut of_type, mut at) = (SetsOfType::new(), SetsAtSpeed::new(network_share));
            for _ in 0..4 * 86_400 {
                of_type.discount(0.99);
                at.discount(0.99);
                at.add(&mut of_type, distances_m, 1.0);
            }
            let [network, fan] = of_type.probability(&at);
            assert!(network < 0.01 && (network + fan - 1.0).abs() < 1e-6, "{network} {fan}");
        }
    }
}
