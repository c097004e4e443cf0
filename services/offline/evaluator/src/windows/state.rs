//! Mergeable states: the sums behind the tables of recordings.
//!
//! A [`State`] holds what the tables of some recordings need. States of different recordings merge, and every
//! split and every order of the recordings gives the same tables to the digit:
//!
//! * Errors, densities, hits and counts are integers or [exact sums](metrics::ExactSum).
//! * Intervals resample blocks of a window's length. A state keeps the sums of each block, in the order of
//!   the recordings' names.
//! * A state of more than [`RECORDINGS_MAX`] recordings or [`BLOCKS_MAX`] blocks keeps no single recording.
//!   Its blocks are added up in [`BLOCKS_MAX`] bins, which the intervals resample instead. The bin of a block
//!   is a hash of the recording and the block's number, so it does not depend on the order either.
//!
//! A state therefore has a limited size, apart from a line for each recording that is left out or failed. No
//! table of recordings has quantiles, so no sketch of a distribution is needed.

mod bins;
mod file;
mod tables;

use std::collections::BTreeMap;

use data::Recording;
use serde::{Deserialize, Serialize};

use super::{Block, BlockErrors, Group, SUBSETS, Tally};
use crate::error::EvaluateError;
use crate::forecaster::Provenance;
use bins::Bins;

pub use file::StateError;

/// Maximum number of recordings up to which a state keeps every recording.
pub const RECORDINGS_MAX: usize = 256;
/// Maximum number of blocks up to which a state keeps every block: nine hours with windows of 8 s.
pub const BLOCKS_MAX: usize = 4096;

/// The sums behind the tables of some recordings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    basis: Basis,
    parts: Parts,
    /// Names of recordings without an agent over a whole window.
    left_out: Vec<String>,
    /// Recordings that can't be evaluated, one line each.
    failed: Vec<String>,
    /// Probable defects, one line each; empty if single recordings are not kept.
    warnings: Vec<String>,
    /// Recordings and rows with a doubt, by the kind of doubt.
    doubts: BTreeMap<String, DoubtCount>,
}

/// What the figures depend on besides the recordings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Basis {
    /// The weights and the map, of no recording. The path of the weights may differ between states.
    pub(crate) provenance: Provenance,
    /// Whether velocities and headings are derived from positions.
    pub(crate) from_positions: bool,
    /// Whether vehicles are forecast along lanes.
    pub(crate) lanes: bool,
    /// Steps of a window, and their length.
    pub(crate) steps: usize,
    pub(crate) dt_s: f64,
    /// The horizons of the tables.
    pub(crate) horizons_s: Vec<f64>,
}

/// How often the audit of the input doubts recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DoubtCount {
    /// Recordings with the doubt.
    pub recordings: u64,
    /// Rows that the doubt concerns.
    pub rows: u64,
    /// Examined rows of these recordings.
    pub of: u64,
}

/// The evaluated recordings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Parts {
    /// Every recording, in the order of the names.
    Each(Vec<Part>),
    /// All recordings together.
    Total(Box<Total>),
}

/// The sums of one recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Part {
    name: String,
    sha256: String,
    /// Whether training saw the recording.
    is_seen: bool,
    /// By index in [`SUBSETS`].
    tallies: Vec<Tally>,
    /// Blocks of the subsets with intervals, by index in [`SUBSETS`].
    blocks: [Vec<BlockErrors>; COMPARED_SUBSETS],
}

/// The sums of many recordings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Total {
    recordings: u64,
    seen: u64,
    tallies: Vec<Tally>,
    bins: [Bins; COMPARED_SUBSETS],
}

/// The first subsets have tables with intervals.
const COMPARED_SUBSETS: usize = 2;

impl State {
    /// A state without a recording.
    pub(crate) const fn new(basis: Basis) -> Self {
        Self {
            basis,
            parts: Parts::Each(Vec::new()),
            left_out: Vec::new(),
            failed: Vec::new(),
            warnings: Vec::new(),
            doubts: BTreeMap::new(),
        }
    }

    /// Adds a recording that can't be evaluated.
    pub fn add_failure(&mut self, name: &str, reason: &str) {
        // Most reasons begin with the file.
        let line = if reason.starts_with(name) { reason.to_owned() } else { format!("{name}: {reason}") };
        let place = self.failed.partition_point(|other| *other <= line);
        self.failed.insert(place, line);
    }

    /// The state of one recording. `is_seen` states whether training saw it.
    pub(crate) fn of(basis: Basis, recording: &Recording, is_seen: bool, blocks: &[Block]) -> Self {
        let Recording { name, sha256, .. } = recording;
        let mut state = Self::new(basis);
        for doubt in data::findings(recording).into_iter().filter(|found| found.doubtful) {
            state.warnings.push(format!("{name}: {doubt}"));
            // A kind may be there for several types of agents.
            let count = state.doubts.entry(doubt.kind).or_default();
            count.recordings = 1;
            count.rows += doubt.rows.unwrap_or(0);
            count.of += doubt.of.unwrap_or(0);
        }
        let group = |place: usize| Group::new(name, SUBSETS[place], place, blocks);
        let groups: [Group; SUBSETS.len()] = std::array::from_fn(group);
        if groups[0].total.is_empty() {
            state.left_out.push(name.clone());
            return state;
        }
        let [all, moving, ..] = &groups;
        state.parts = Parts::Each(vec![Part {
            name: name.clone(),
            sha256: sha256.clone(),
            is_seen,
            blocks: [all.blocks.clone(), moving.blocks.clone()],
            tallies: groups.into_iter().map(|group| group.total).collect(),
        }]);
        state.merge_blocks();
        state
    }

    /// Merges states. Each one has a name for errors. The order does not matter.
    ///
    /// # Errors
    /// [`StateError`] if there is no state, or if weights or options differ.
    pub fn merged(
        states: impl IntoIterator<Item = Result<(String, Self), StateError>>,
    ) -> Result<Self, StateError> {
        let mut states = states.into_iter();
        let (first, mut whole) = states.next().ok_or(StateError::None)??;
        for state in states {
            let (name, state) = state?;
            whole.basis.check(&state.basis, &name, &first)?;
            whole.add(state);
        }
        whole.sort();
        Ok(whole)
    }

    /// Number of evaluated recordings.
    pub const fn recording_count(&self) -> u64 {
        match &self.parts {
            Parts::Each(parts) => parts.len() as u64,
            Parts::Total(total) => total.recordings,
        }
    }

    /// Recordings that can't be evaluated, one line each.
    pub fn failed(&self) -> &[String] {
        &self.failed
    }

    /// Fails if no recording is evaluated.
    pub(crate) fn need_agents(&self) -> Result<(), EvaluateError> {
        if self.recording_count() > 0 {
            return Ok(());
        }
        Err(self.basis.no_agents(self.left_out.join(", ")))
    }

    /// Whether all tallies have the subsets and horizons of the tables.
    fn is_whole(&self) -> bool {
        let horizon_count = self.basis.horizons_s.len();
        let has_all = |tallies: &[Tally]| {
            tallies.len() == SUBSETS.len() && tallies.iter().all(|tally| tally.has_horizons(horizon_count))
        };
        match &self.parts {
            Parts::Each(parts) => parts.iter().all(|part| has_all(&part.tallies)),
            Parts::Total(total) => has_all(&total.tallies),
        }
    }

    /// Adds a state with the same basis; the lists are not sorted.
    pub(crate) fn add(&mut self, other: Self) {
        let weights = &mut self.basis.provenance.weights;
        *weights = std::mem::take(weights).min(other.basis.provenance.weights);
        self.left_out.extend(other.left_out);
        self.failed.extend(other.failed);
        self.warnings.extend(other.warnings);
        for (kind, DoubtCount { recordings, rows, of }) in other.doubts {
            let count = self.doubts.entry(kind).or_default();
            count.recordings += recordings;
            count.rows += rows;
            count.of += of;
        }
        match (&mut self.parts, other.parts) {
            (Parts::Each(parts), Parts::Each(more)) => parts.extend(more),
            (Parts::Total(total), Parts::Each(more)) => more.iter().for_each(|part| total.add(part)),
            (Parts::Total(total), Parts::Total(more)) => total.merge(&more),
            (Parts::Each(parts), Parts::Total(mut more)) => {
                parts.iter().for_each(|part| more.add(part));
                self.parts = Parts::Total(more);
            }
        }
        self.merge_blocks();
    }

    /// Drops single recordings if there are too many.
    fn merge_blocks(&mut self) {
        let block_count = |parts: &[Part]| parts.iter().map(|part| part.blocks[0].len()).sum::<usize>();
        if let Parts::Each(parts) = &self.parts
            && (parts.len() > RECORDINGS_MAX || block_count(parts) > BLOCKS_MAX)
        {
            let mut total = Total::default();
            parts.iter().for_each(|part| total.add(part));
            self.parts = Parts::Total(Box::new(total));
        }
        if matches!(self.parts, Parts::Total(_)) {
            self.warnings.clear();
        }
    }

    /// Sorts all lists, so that they do not depend on the order of merging.
    pub(crate) fn sort(&mut self) {
        [&mut self.left_out, &mut self.failed, &mut self.warnings].into_iter().for_each(|list| list.sort());
        if let Parts::Each(parts) = &mut self.parts {
            let by_name = |a: &Part, b: &Part| (&a.name, &a.sha256).cmp(&(&b.name, &b.sha256));
            // A recording may be there twice, read in different ways.
            parts.sort_by(|a, b| by_name(a, b).then_with(|| file::encode(a).cmp(&file::encode(b))));
        }
    }
}

impl Total {
    fn add(&mut self, part: &Part) {
        self.recordings += 1;
        self.seen += u64::from(part.is_seen);
        self.add_tallies(&part.tallies);
        for (bins, blocks) in self.bins.iter_mut().zip(&part.blocks) {
            bins.add(&part.sha256, blocks);
        }
    }

    fn merge(&mut self, other: &Self) {
        self.recordings += other.recordings;
        self.seen += other.seen;
        self.add_tallies(&other.tallies);
        self.bins.iter_mut().zip(&other.bins).for_each(|(bins, more)| bins.merge(more));
    }

    fn add_tallies(&mut self, more: &[Tally]) {
        if self.tallies.is_empty() {
            self.tallies = more.to_vec();
        } else {
            self.tallies.iter_mut().zip(more).for_each(|(tally, more)| tally.merge(more));
        }
    }
}

impl Basis {
    /// Fails unless `other` is the same, except for the path of the weights.
    fn check(&self, other: &Self, name: &str, first: &str) -> Result<(), StateError> {
        let pairs = self.options().into_iter().zip(other.options());
        let mut different = pairs.filter(|(own, others)| own != others);
        match different.next() {
            None => Ok(()),
            Some(((option, expected), (_, found))) => Err(StateError::Other {
                name: name.to_owned(),
                first: first.to_owned(),
                option,
                found,
                expected,
            }),
        }
    }

    /// Everything that decides about the figures, in words.
    fn options(&self) -> [(&'static str, String); 5] {
        [
            ("weights", self.provenance.sha256.clone()),
            ("decoder.precision", self.provenance.precision.to_string()),
            ("map", self.provenance.map.clone()),
            ("motion", if self.from_positions { "from positions" } else { "as recorded" }.to_owned()),
            ("lanes", if self.lanes { "used" } else { "not used" }.to_owned()),
        ]
    }

    /// The error of recordings without an agent over a whole window.
    fn no_agents(&self, name: String) -> EvaluateError {
        EvaluateError::NoWindows { name, steps: self.steps, dt_s: self.dt_s }
    }
}

#[cfg(test)]
mod tests;
