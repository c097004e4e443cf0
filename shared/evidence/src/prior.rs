use std::fmt;

use crate::{BANDS, KNOTS, Statistics};

/// What is expected before any forecast has matured, by type of agent and speed.
///
/// Sums per forecast over recordings that the network was not trained on, as JSON; an empty one expects
/// constant velocity alone.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(transparent)]
pub struct Prior(pub [[ContextPrior; BANDS]; 3]);

/// The expectation of one type at one speed.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContextPrior {
    /// Mean statistics of a forecast, at each knot.
    pub blend: [Statistics; KNOTS],
    /// Logarithm of the factor of the widths, at each knot.
    pub log_width: [f32; KNOTS],
    /// Deviations from the blend along and across the course at each knot, m.
    pub deviation_m: [[f32; 2]; KNOTS],
    /// Distance of the nearest mode of each [`ModeSet`](crate::ModeSet), m; zeros where it is unknown.
    pub nearest_m: [f32; 3],
}

/// A prior that can't be read.
#[derive(Debug)]
pub struct PriorError(serde_json::Error);

impl fmt::Display for PriorError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "the prior of the experts can't be read")
    }
}

impl std::error::Error for PriorError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.0)
    }
}

impl Prior {
    /// The shipped prior: from sources that were left out of the training of the network in turn.
    #[must_use]
    pub fn shipped() -> Self {
        Self::from_json(include_str!("prior.json")).expect("the shipped prior is read by a test")
    }

    /// From the text of [`Prior::to_json`].
    ///
    /// # Errors
    /// [`PriorError`] where it is another text or has a number that is not finite.
    pub fn from_json(text: &str) -> Result<Self, PriorError> {
        serde_json::from_str(text).map_err(PriorError)
    }

    /// As text.
    ///
    /// # Panics
    /// Never: its numbers are finite.
    #[must_use]
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("numbers")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_prior_expects_experts_to_be_worth_something() {
        let prior = Prior::shipped();
        let worth = |of: &ContextPrior| of.blend.iter().all(|at| at.weights().iter().sum::<f32>() > 0.0);
        assert!(prior.0[0].iter().all(worth), "{:?}", prior.0[0].map(|of| of.blend.map(|at| at.weights())));
        assert_eq!(Prior::from_json(&prior.to_json()).unwrap(), prior);
    }
}
