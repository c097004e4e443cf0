//! Estimates whether the network knows the road.

/// Logarithm of the prior odds that the network knows the road.
const LOG_ODDS: f64 = -3.0;
/// Range of the log odds: a road may change into another one.
const LOG_ODDS_RANGE: [f64; 2] = [-5.0, 4.0];
/// Change of the log odds by a forecast whose two distances differ by at least the typical deviation of
/// similar agents.
const RATE: f64 = 0.3;

/// The probability that the network knows the road. It is computed by
/// [Hedge](https://doi.org/10.1006/jcss.1997.1504) between two experts: the network alone, which is right on
/// a known road, and the blend that the prior expects to be best on an unknown one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Familiarity {
    log_odds: f64,
}

impl Familiarity {
    /// Count of the learned numbers.
    pub(crate) const NUMBERS_LEN: usize = 1;

    /// The state for a road on which no forecast has matured.
    pub(crate) const fn new() -> Self {
        Self { log_odds: LOG_ODDS }
    }

    /// Adds a forecast. `nearer` is the network's advantage over the prior's blend in distance to the truth,
    /// as a share of the typical deviation of similar agents.
    pub(crate) fn add(&mut self, nearer: f32) {
        let [least, largest] = LOG_ODDS_RANGE;
        self.log_odds = (self.log_odds + RATE * f64::from(nearer.clamp(-1.0, 1.0))).clamp(least, largest);
    }

    /// The probability that the network knows the road, 0 to 1.
    pub(crate) fn probability(&self) -> f64 {
        1.0 / (1.0 + (-self.log_odds).exp())
    }

    /// Calls `each` with all learned numbers, to read or to change them.
    pub(crate) fn numbers(&mut self, each: &mut impl FnMut(&mut f64)) {
        each(&mut self.log_odds);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_road_becomes_known_and_strange_again_in_a_few_forecasts() {
        let mut road = Familiarity::new();
        assert!(road.probability() < 0.05);
        (0..1000).for_each(|_| road.add(0.5));
        assert!(road.probability() > 0.95);
        (0..50).for_each(|_| road.add(-0.5));
        assert!(road.probability() < 0.05);
        // A single forecast does not decide.
        road.add(1e9);
        assert!(road.probability() < 0.05);
    }
}
