//! Agents whose errors are told together: a fold, a site, a file.

use metrics::{Interval, PairedErrors, paired_bootstrap};

use crate::judge::Block;
use crate::{Measure, Method, Subset, Tally};

/// Resamples of an interval.
pub(crate) const RESAMPLES: usize = 1000;

/// Some agents with their errors.
#[derive(Clone, Debug)]
pub struct Group {
    /// What part of the data they are of.
    pub part: String,
    /// Which of its agents.
    pub subset: Subset,
    /// Unit of the lengths.
    pub unit: &'static str,
    /// All together.
    pub total: Tally,
    /// By block, what intervals resample.
    blocks: Vec<Tally>,
}

impl Group {
    /// The agents of one subset of some blocks; `subset` is its place among the blocks' tallies.
    #[must_use]
    pub fn new(part: &str, subset: Subset, place: usize, blocks: &[Block]) -> Self {
        let blocks = blocks.iter().map(|block| block.tallies[place].clone());
        Self::of_tallies(part, subset, "m", blocks.filter(|tally| !tally.is_empty()).collect())
    }

    /// All agents of several groups.
    #[must_use]
    pub fn pooled(part: &str, groups: &[&Self]) -> Self {
        let (subset, unit) = groups.first().map_or((Subset::All, "m"), |group| (group.subset, group.unit));
        let blocks = groups.iter().flat_map(|group| group.blocks.iter().cloned()).collect();
        Self::of_tallies(part, subset, unit, blocks)
    }

    /// The same errors in another unit, so many of which make a metre.
    #[must_use]
    pub fn scaled(&self, unit: &'static str, per_m: f64) -> Self {
        let blocks = self.blocks.iter().map(|tally| tally.clone().scaled(per_m)).collect();
        Self::of_tallies(&self.part, self.subset, unit, blocks)
    }

    fn of_tallies(part: &str, subset: Subset, unit: &'static str, blocks: Vec<Tally>) -> Self {
        let horizons_len = blocks.first().map_or(0, Tally::horizons_len);
        let mut total = Tally::new(horizons_len);
        blocks.iter().for_each(|block| total.merge(block));
        Self { part: part.to_owned(), subset, unit, total, blocks }
    }

    /// How much greater our ADE and FDE are than those of `theirs` on the same agents, with 95 % intervals.
    #[must_use]
    pub fn differences(&self, theirs: Method, measure: Measure, horizon: usize) -> Option<[Interval; 2]> {
        let differences = |of: usize| {
            let pairs: Vec<PairedErrors> = self
                .blocks
                .iter()
                .filter(|block| block.len(theirs, measure) == block.len(Method::Network, measure))
                .map(|block| PairedErrors {
                    ours: block.sum(Method::Network, measure, horizon)[of],
                    theirs: block.sum(theirs, measure, horizon)[of],
                    len: block.len(theirs, measure),
                })
                .collect();
            paired_bootstrap(&pairs, RESAMPLES, 1)
        };
        Some([differences(0)?, differences(1)?])
    }

    /// Blocks with an agent that counts.
    #[must_use]
    pub const fn blocks_len(&self) -> usize {
        self.blocks.len()
    }
}
