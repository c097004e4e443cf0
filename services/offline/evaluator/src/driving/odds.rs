//! Learns the odds of conflicts.

use std::collections::BTreeSet;

use conflicts::{Odds, OddsOfSources, SIGNS};
use nalgebra::{SMatrix, SVector};

use super::{Pair, Report};

/// Numbers of [`Odds`]: the constant, and a weight for each sign.
const NUMBERS: usize = SIGNS + 1;
/// Strength of the penalty on weights, in units of the deviation of their signs.
const RIDGE: f64 = 10.0;
/// Maximum number of Newton steps.
const STEPS_MAX: usize = 50;
/// Steps end when no number changes by more.
const DONE: f64 = 1e-9;
/// Decimals of the numbers.
const DECIMALS: i32 = 5;

/// The odds of all sources, and without each of them: of the name and pairs of each.
pub(crate) fn of_sources(sources: &[(String, &[Pair])]) -> OddsOfSources {
    let without = |left_out: Option<&str>| {
        let others = sources.iter().filter(|(name, _)| Some(name.as_str()) != left_out);
        learn(&others.flat_map(|(_, pairs)| *pairs).collect::<Vec<_>>())
    };
    let names: BTreeSet<&String> = sources.iter().map(|(name, _)| name).collect();
    OddsOfSources {
        all: without(None),
        without: names.into_iter().map(|name| (name.clone(), without(Some(name)))).collect(),
    }
}

impl Report {
    /// The odds of conflicts, learned on the sources at their own scale.
    #[must_use]
    pub fn odds(&self) -> OddsOfSources {
        let at_scale = self.sources.iter().filter(|(source, _)| source.scale == 1.0);
        let pairs = at_scale.map(|(source, played)| (source.folder_name(), &played.pairs[..]));
        of_sources(&pairs.collect::<Vec<_>>())
    }
}

/// Logistic regression with a ridge penalty, by Newton's method: w ← w − H⁻¹ g of the function
/// Σ ln(1 + e^z) − y z + ½ λ Σ (w s)², z = constant + w · signs. s is the deviation of a sign over the pairs.
/// y is 1 for a conflict.
fn learn(pairs: &[&Pair]) -> Odds {
    let rows: Vec<(SVector<f64, NUMBERS>, f64)> = pairs
        .iter()
        .filter_map(|pair| {
            let signs = pair.signs?;
            let row = SVector::from_fn(|i, _| if i == 0 { 1.0 } else { f64::from(signs[i - 1]) });
            Some((row, if pair.conflict_s.is_some() { 1.0 } else { 0.0 }))
        })
        .collect();
    let count = rows.len().max(1) as f64;
    let mean = rows.iter().map(|(row, _)| row).sum::<SVector<f64, NUMBERS>>() / count;
    let square = rows.iter().map(|(row, _)| row.component_mul(row)).sum::<SVector<f64, NUMBERS>>() / count;
    // A sign that is always the same has no weight.
    let variance = (square - mean.component_mul(&mean)).map(|variance| variance.max(1e-6));
    let penalty = variance.map_with_location(|i, _, variance| if i == 0 { 1e-6 } else { RIDGE * variance });
    let mut numbers = SVector::<f64, NUMBERS>::zeros();
    for _ in 0..STEPS_MAX {
        let mut gradient = penalty.component_mul(&numbers);
        let mut hessian = SMatrix::<f64, NUMBERS, NUMBERS>::from_diagonal(&penalty);
        for (row, is_conflict) in &rows {
            let p = 1.0 / (1.0 + (-numbers.dot(row)).exp());
            gradient += row * (p - is_conflict);
            hessian += row * row.transpose() * (p * (1.0 - p));
        }
        let Some(step) = hessian.cholesky().map(|factor| factor.solve(&gradient)) else { break };
        // Far from the minimum, a whole step may lead past it.
        numbers -= step.map(|step| step.clamp(-2.0, 2.0));
        if step.amax() < DONE {
            break;
        }
    }
    let numbers = numbers.map(rounded);
    Odds { constant: numbers[0], weights: std::array::from_fn(|sign| numbers[sign + 1]) }
}

fn rounded(number: f64) -> f64 {
    let unit = 10_f64.powi(DECIMALS);
    (number * unit).round() / unit
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs with one sign, 4000 of each value, of which a share has a conflict.
    fn pairs(shares: [(f32, usize); 2]) -> Vec<Pair> {
        let of_value = |(value, conflicts): (f32, usize)| {
            let mut signs = [0.0; SIGNS];
            signs[3] = value;
            (0..4000).map(move |i| Pair {
                conflict_s: (i < conflicts).then_some(1.0),
                scores: [0.0; 4],
                signs: Some(signs),
            })
        };
        shares.into_iter().flat_map(of_value).collect()
    }

    #[test]
    fn odds_are_the_share_of_conflicts() {
        let pairs = pairs([(0.0, 400), (1.0, 2000)]);
        let odds = learn(&pairs.iter().collect::<Vec<_>>());
        let logit = |share: f64| (share / (1.0 - share)).ln();
        // The penalty draws them together.
        assert!((odds.constant - logit(0.1)).abs() < 0.1, "{odds:?}");
        assert!((odds.constant + odds.weights[3] - logit(0.5)).abs() < 0.1, "{odds:?}");
        assert_eq!(odds.weights[0], 0.0, "a sign that is always the same");
    }

    #[test]
    fn a_source_has_no_part_in_its_own_odds() {
        let (often, never) = (pairs([(0.0, 2000), (1.0, 3600)]), pairs([(0.0, 20), (1.0, 40)]));
        let sources = [("often".to_owned(), &often[..]), ("never".to_owned(), &never[..])];
        let odds = of_sources(&sources);
        assert_eq!(odds.without["often"], learn(&never.iter().collect::<Vec<_>>()));
        assert!(odds.without["never"].constant > odds.all.constant);
        assert!(odds.all.constant > odds.without["often"].constant);
    }
}
