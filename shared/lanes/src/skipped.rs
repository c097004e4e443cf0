//! What of a map did not become lanes.

use std::collections::BTreeMap;

use crate::LaneMapError;

/// Content of a map that was skipped: lanes do not need it, or can do without it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Skipped {
    /// Nodes, ways and relations that lanes do not need.
    pub(crate) unneeded: [usize; 3],
    /// Count of each kind of fault, and the first.
    faults: BTreeMap<SkippedKind, (usize, String)>,
}

/// A kind of fault in a map that is skipped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SkippedKind {
    /// A lanelet that can't be used.
    Lanelet,
    /// An area that can't be used.
    Area,
    /// A speed limit that is not a speed: that of the kind of road counts.
    Limit,
    /// A reference to a regulatory element that the map lacks.
    Rule,
    /// Another tag with an unusual value: the usual one counts.
    Tag,
    /// An element without a number.
    Element,
}

impl SkippedKind {
    const fn name(self) -> &'static str {
        match self {
            Self::Lanelet => "lanelets",
            Self::Area => "areas",
            Self::Limit => "speed limits",
            Self::Rule => "references to regulatory elements",
            Self::Tag => "tags",
            Self::Element => "elements without a number",
        }
    }
}

impl Skipped {
    /// Nodes, ways and relations of the map that lanes do not need.
    #[must_use]
    pub const fn unneeded(&self) -> [usize; 3] {
        self.unneeded
    }

    /// Number of faults of a kind.
    #[must_use]
    pub fn count(&self, kind: SkippedKind) -> usize {
        self.faults.get(&kind).map_or(0, |(count, _)| *count)
    }

    /// A sentence for each kind of fault, with the first one.
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
