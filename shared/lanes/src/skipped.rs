//! The content of a map that did not become lanes.

use std::collections::BTreeMap;

use crate::LaneMapError;

/// The skipped content of a map: lanes do not need it or can do without it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Skipped {
    /// Nodes, ways and relations that lanes do not need.
    pub(crate) unneeded: [usize; 3],
    /// The count of each kind of fault, and the first fault.
    faults: BTreeMap<SkippedKind, (usize, String)>,
}

wire::named! {
    /// A kind of skipped fault.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum SkippedKind {
        /// A lanelet that cannot be used.
        Lanelet => "lanelets",
        /// An area that cannot be used.
        Area => "areas",
        /// A speed limit that is not a speed. The usual limit of the kind of road applies.
        Limit => "speed limits",
        /// A reference to a regulatory element that is not in the map.
        Rule => "references to regulatory elements",
        /// Another tag with an unusual value. The usual value applies.
        Tag => "tags",
        /// An element without a number.
        Element => "elements without a number",
    }
}

impl Skipped {
    /// Nodes, ways and relations of the map that lanes do not need.
    pub const fn unneeded(&self) -> [usize; 3] {
        self.unneeded
    }

    /// Number of faults of a kind.
    #[must_use]
    pub fn count(&self, kind: SkippedKind) -> usize {
        self.faults.get(&kind).map_or(0, |(count, _)| *count)
    }

    /// One sentence per kind of fault, with the first fault.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        self.faults
            .iter()
            .map(|(kind, (count, first))| format!("{} skipped: {count}, the first: {first}", kind.name()))
    }

    /// Counts a fault.
    pub(crate) fn add(&mut self, kind: SkippedKind, error: impl FnOnce() -> LaneMapError) {
        self.faults.entry(kind).or_insert_with(|| (0, error().to_string())).0 += 1;
    }
}
