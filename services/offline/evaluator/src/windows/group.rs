//! Agents whose errors are reported together: a fold, a site, a file.

use metrics::{ExactSum, Interval, PairedErrors, paired_bootstrap, paired_bootstrap_ratio};
use serde::{Deserialize, Serialize};

use super::{Block, Measure, Method, Subset, Tally};
use crate::forecaster::Crowding;
use crate::table::{RESAMPLES, SEED};

/// The baselines that our forecasts are compared with, and the measures.
pub(crate) const COMPARED: [(Measure, Method); 6] = [
    (Measure::BestOf, Method::Base),
    (Measure::BestOf, Method::Anchors),
    (Measure::Joint, Method::Base),
    (Measure::Joint, Method::Anchors),
    (Measure::Single, Method::Base),
    (Measure::Single, Method::ConstantVelocity),
];

/// Our errors compared with the errors of another method on the same agents, with 95 % intervals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contrast {
    /// Our error minus the other error.
    pub difference: Interval,
    /// Our error divided by the other error.
    pub ratio: Interval,
}

/// Errors of two methods on the same agents, up to the longest horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Paired {
    /// Sums of our (ADE, FDE).
    ours: [ExactSum; 2],
    /// Sums of the other method's.
    theirs: [ExactSum; 2],
    /// Number of agents; 0 if the other method has no forecast for some of them.
    len: u64,
}

/// What intervals need of a block: its errors in each comparison of [`COMPARED`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct BlockErrors([Paired; COMPARED.len()]);

impl BlockErrors {
    fn of(block: &Tally) -> Self {
        let last = block.horizon_count().saturating_sub(1);
        Self(COMPARED.map(|(measure, theirs)| {
            let len = block.len(theirs, measure);
            if len == 0 || len != block.len(Method::Network, measure) {
                return Paired::default();
            }
            let [ours, theirs] = [Method::Network, theirs].map(|method| block.sum(method, measure, last));
            Paired { ours, theirs, len }
        }))
    }

    /// Adds the errors of `other`.
    pub(crate) fn merge(&mut self, other: &Self) {
        for (own, more) in self.0.iter_mut().zip(&other.0) {
            own.ours.iter_mut().zip(&more.ours).for_each(|(sum, more)| sum.merge(more));
            own.theirs.iter_mut().zip(&more.theirs).for_each(|(sum, more)| sum.merge(more));
            own.len += more.len;
        }
    }

    /// The same errors in another unit of length.
    pub(crate) fn scaled(&self, per_m: f64) -> Self {
        let scaled = |sums: [ExactSum; 2]| sums.map(|sum| sum.scaled(per_m));
        Self(self.0.map(|of| Paired { ours: scaled(of.ours), theirs: scaled(of.theirs), len: of.len }))
    }
}

/// A set of agents with their errors.
#[derive(Clone, Debug)]
pub struct Group {
    /// The part of the data that they belong to.
    pub part: String,
    /// The rule that selects them.
    pub subset: Subset,
    /// Unit of the lengths.
    pub unit: &'static str,
    /// All agents together.
    pub total: Tally,
    /// By block; intervals resample blocks.
    pub(crate) blocks: Vec<BlockErrors>,
}

impl Group {
    /// The agents of one subset over these blocks. `place` is the subset's index among each block's tallies.
    #[must_use]
    pub fn new(part: &str, subset: Subset, place: usize, blocks: &[Block]) -> Self {
        let tallies = || blocks.iter().map(|block| &block.tallies[place]);
        let total = sum(tallies());
        let blocks = tallies().filter(|tally| !tally.is_empty()).map(BlockErrors::of).collect();
        Self { part: part.to_owned(), subset, unit: "m", total, blocks }
    }

    /// All agents of several groups.
    #[must_use]
    pub fn pooled(part: &str, groups: &[&Self]) -> Self {
        let (subset, unit) = groups.first().map_or((Subset::All, "m"), |group| (group.subset, group.unit));
        let mut total = sum(groups.iter().map(|group| &group.total));
        // Each part reports its own crowding.
        total.crowding = Crowding::default();
        let blocks = groups.iter().flat_map(|group| group.blocks.iter().copied()).collect();
        Self { part: part.to_owned(), subset, unit, total, blocks }
    }

    /// The same errors in another unit, with `per_m` units per metre.
    #[must_use]
    pub fn scaled(&self, unit: &'static str, per_m: f64) -> Self {
        Self {
            unit,
            total: self.total.clone().scaled(per_m),
            blocks: self.blocks.iter().map(|block| block.scaled(per_m)).collect(),
            ..self.clone()
        }
    }

    /// Our ADE and FDE in the comparison with this place in [`COMPARED`], at the longest horizon. `None` if
    /// the other method has no errors, or if a single block gives no interval.
    #[must_use]
    pub(crate) fn compare(&self, place: usize) -> Option<[Contrast; 2]> {
        if self.blocks.len() < 2 {
            return None;
        }
        let contrast = |of: usize| {
            let pair = |block: &BlockErrors| {
                let Paired { ours, theirs, len } = block.0[place];
                PairedErrors { ours: ours[of].value(), theirs: theirs[of].value(), len }
            };
            let pairs: Vec<PairedErrors> = self.blocks.iter().map(pair).collect();
            Some(Contrast {
                difference: paired_bootstrap(&pairs, RESAMPLES, SEED)?,
                ratio: paired_bootstrap_ratio(&pairs, RESAMPLES, SEED)?,
            })
        };
        Some([contrast(0)?, contrast(1)?])
    }
}

/// The sum of tallies, which share the number of horizons.
pub(crate) fn sum<'a>(mut tallies: impl Iterator<Item = &'a Tally>) -> Tally {
    let Some(mut total) = tallies.next().cloned() else { return Tally::new(0) };
    tallies.for_each(|tally| total.merge(tally));
    total
}
