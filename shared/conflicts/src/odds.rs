use std::collections::BTreeMap;

use crate::{SIGNS, Signs};

/// How often pairs with certain [`Signs`] have a conflict: ln(p / (1 − p)) = constant + Σ weight · sign.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Odds {
    /// The constant.
    pub constant: f64,
    /// The weight of each of [`Signs::numbers`].
    pub weights: [f64; SIGNS],
}

/// The odds of all sources of recordings, and without each of them.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OddsOfSources {
    /// Learned on all sources.
    pub all: Odds,
    /// Learned on the others, by the name of a source.
    pub without: BTreeMap<String, Odds>,
}

impl OddsOfSources {
    /// The shipped odds, which `stgdat evaluate driving --odds FILE` wrote.
    ///
    /// # Panics
    /// Never: a test reads them.
    #[must_use]
    pub fn shipped() -> Self {
        serde_json::from_str(include_str!("odds.json")).expect("the shipped odds")
    }

    /// The odds for a source, which has no part in them.
    #[must_use]
    pub fn for_source(&self, name: &str) -> &Odds {
        self.without.get(name).unwrap_or(&self.all)
    }
}

impl Odds {
    /// The probability of a conflict.
    #[must_use]
    pub fn probability(&self, signs: &Signs) -> f32 {
        let terms = self.weights.iter().zip(signs.numbers()).map(|(weight, sign)| weight * f64::from(sign));
        let logit = self.constant + terms.sum::<f64>();
        (1.0 / (1.0 + (-logit).exp())) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_odds_leave_each_source_out() {
        let odds = OddsOfSources::shipped();
        assert!(odds.without.len() > 5, "{:?}", odds.without.keys());
        assert!(odds.without.values().all(|of| *of != odds.all), "{odds:?}");
        assert_eq!(odds.for_source("of another road"), &odds.all);
    }
}
