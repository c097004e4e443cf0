//! Whether the network knows the road.

/// Logarithm of the odds that it does, before any forecast has matured.
const LOG_ODDS: f64 = -3.0;
/// Least and largest: a road may become another one.
const LOG_ODDS_RANGE: [f64; 2] = [-5.0, 4.0];
/// How much a forecast changes them whose two distances differ by as much as agents alike deviate, or by
/// more.
const RATE: f64 = 0.3;

/// How probable it is that the network knows the road: [Hedge](https://doi.org/10.1006/jcss.1997.1504)
/// between the network alone, which is right where it does, and the blend that the prior expects to be best
/// where it does not.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Familiarity {
    log_odds: f64,
}

impl Familiarity {
    /// Numbers that are learned.
    pub(crate) const NUMBERS_LEN: usize = 1;

    /// Of a road on which no forecast has matured.
    pub(crate) const fn new() -> Self {
        Self { log_odds: LOG_ODDS }
    }

    /// Adds a forecast by how much nearer to the truth the network was than the prior's blend, as a share of
    /// how far agents alike deviate.
    pub(crate) fn add(&mut self, nearer: f32) {
        let [least, largest] = LOG_ODDS_RANGE;
        self.log_odds = (self.log_odds + RATE * f64::from(nearer.clamp(-1.0, 1.0))).clamp(least, largest);
    }

    /// That the network knows the road, 0 to 1.
    pub(crate) fn probability(&self) -> f64 {
        1.0 / (1.0 + (-self.log_odds).exp())
    }

    /// Gives `each` all numbers that were learned, to read or to change.
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
        // One forecast alone decides nothing.
        road.add(1e9);
        assert!(road.probability() < 0.05);
    }
}
