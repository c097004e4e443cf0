//! Blocks of many recordings, added up in a limited number of bins.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wire::crc64;

use super::BLOCKS_MAX;
use crate::windows::group::BlockErrors;

/// Sums of blocks by bin.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Bins(BTreeMap<u16, BlockErrors>);

impl Bins {
    /// Adds the blocks of a recording. Copies of a recording share their bins, because their errors are the
    /// same.
    pub(super) fn add(&mut self, sha256: &str, blocks: &[BlockErrors]) {
        for (number, block) in (0_u64..).zip(blocks) {
            let hash = crc64(&[sha256.as_bytes(), &number.to_le_bytes()]);
            let bin = (hash % BLOCKS_MAX as u64) as u16;
            self.0.entry(bin).or_default().merge(block);
        }
    }

    /// Adds the sums of `other`.
    pub(super) fn merge(&mut self, other: &Self) {
        for (bin, block) in &other.0 {
            self.0.entry(*bin).or_default().merge(block);
        }
    }

    /// The bins in their order.
    pub(super) fn blocks(&self) -> Vec<BlockErrors> {
        self.0.values().copied().collect()
    }
}
