//! Agents whose errors are reported together: a fold, a site, a file.

use metrics::{Interval, PairedErrors, paired_bootstrap, paired_bootstrap_ratio};

use crate::judge::Block;
use crate::{Crowding, Measure, Method, Subset, Tally};

/// Resamples per interval.
pub const RESAMPLES: usize = 1000;

/// Seed of the resamples.
const SEED: u64 = 1;

/// Our errors compared with the errors of another method on the same agents, with 95 % intervals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contrast {
    /// Our error minus the other error.
    pub difference: Interval,
    /// Our error divided by the other error.
    pub ratio: Interval,
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
    blocks: Vec<Tally>,
}

impl Group {
    /// The agents of one subset over these blocks. `place` is the subset's index among each block's tallies.
    #[must_use]
    pub fn new(part: &str, subset: Subset, place: usize, blocks: &[Block]) -> Self {
        let tallies = || blocks.iter().map(|block| &block.tallies[place]);
        let counted = tallies().filter(|tally| !tally.is_empty()).cloned().collect();
        Self::of_tallies(part, subset, "m", horizon_count(tallies()), counted)
    }

    /// All agents of several groups.
    #[must_use]
    pub fn pooled(part: &str, groups: &[&Self]) -> Self {
        let (subset, unit) = groups.first().map_or((Subset::All, "m"), |group| (group.subset, group.unit));
        let blocks = groups.iter().flat_map(|group| group.blocks.iter().cloned()).collect();
        let horizon_count = horizon_count(groups.iter().map(|group| &group.total));
        let mut pooled = Self::of_tallies(part, subset, unit, horizon_count, blocks);
        // Each part reports its own crowding.
        pooled.total.crowding = Crowding::default();
        pooled
    }

    /// The same errors in another unit, with `per_m` units per metre.
    #[must_use]
    pub fn scaled(&self, unit: &'static str, per_m: f64) -> Self {
        let blocks = self.blocks.iter().map(|tally| tally.clone().scaled(per_m)).collect();
        Self::of_tallies(&self.part, self.subset, unit, self.total.horizon_count(), blocks)
    }

    /// Sums `blocks`. The total has `horizon_count` horizons even without blocks.
    fn of_tallies(
        part: &str,
        subset: Subset,
        unit: &'static str,
        horizon_count: usize,
        blocks: Vec<Tally>,
    ) -> Self {
        let mut total = Tally::new(horizon_count);
        blocks.iter().for_each(|block| total.merge(block));
        Self { part: part.to_owned(), subset, unit, total, blocks }
    }

    /// Compares our ADE and FDE with the errors of `theirs` on the same agents. `None` if `theirs` has none,
    /// or if a single block gives no interval.
    #[must_use]
    pub fn compare(&self, theirs: Method, measure: Measure, horizon: usize) -> Option<[Contrast; 2]> {
        if self.blocks.len() < 2 {
            return None;
        }
        let contrast = |of: usize| {
            let blocks = self.blocks.iter();
            let pairs: Vec<PairedErrors> = blocks
                .filter(|block| block.len(theirs, measure) == block.len(Method::Network, measure))
                .map(|block| PairedErrors {
                    ours: block.sum(Method::Network, measure, horizon)[of],
                    theirs: block.sum(theirs, measure, horizon)[of],
                    len: block.len(theirs, measure),
                })
                .collect();
            Some(Contrast {
                difference: paired_bootstrap(&pairs, RESAMPLES, SEED)?,
                ratio: paired_bootstrap_ratio(&pairs, RESAMPLES, SEED)?,
            })
        };
        Some([contrast(0)?, contrast(1)?])
    }
}

/// The number of horizons, which all these tallies share.
fn horizon_count<'a>(mut tallies: impl Iterator<Item = &'a Tally>) -> usize {
    tallies.next().map_or(0, Tally::horizon_count)
}
