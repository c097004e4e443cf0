use std::collections::BTreeMap;

use super::frame::{Frame, TrackingError, check_gate, distance_m};
use super::pairing::{Edge, best_pairs};

/// CLEAR-MOT of a recording, frame by frame.
///
/// 1. A truth keeps the track that it was last paired with if both are present and within the gate. If two
///    truths were last paired with one track, the truth with the smaller id keeps it.
/// 2. The remaining objects are paired so that the number of pairs is maximal. Among these pairings, the one
///    with the smallest sum of distances is chosen.
///
/// Memory: a few numbers per id.
#[derive(Clone, Debug)]
pub struct ClearMot {
    gate_m: f64,
    counts: ClearMotCounts,
    truths: BTreeMap<u64, TruthState>,
    /// The truth of the newest new pair of each track.
    truth_of: BTreeMap<u64, u64>,
}

/// The state of one truth.
#[derive(Clone, Copy, Debug, Default)]
struct TruthState {
    /// The track of its last pair.
    track: Option<u64>,
    present_count: u64,
    matched_count: u64,
    /// Whether it was missed after its last pair.
    interrupted: bool,
}

impl ClearMot {
    /// Counts pairs that are at most `gate_m` apart.
    ///
    /// # Errors
    /// If the gate is not between 0 and 10⁶ m.
    pub fn new(gate_m: f64) -> Result<Self, TrackingError> {
        check_gate(gate_m)?;
        Ok(Self {
            gate_m,
            counts: ClearMotCounts::default(),
            truths: BTreeMap::new(),
            truth_of: BTreeMap::new(),
        })
    }

    /// Counts the next frame. Cost: truths × tracks, plus the assignment of objects near each other.
    pub fn add(&mut self, frame: &Frame) {
        let kept = self.kept(frame);
        let fresh = self.fresh(frame, &kept);
        for (&truth, &track) in &fresh {
            self.count_change(truth, track);
        }
        let mut matched_count = 0;
        for truth in frame.truths() {
            let state = self.truths.entry(truth.id).or_default();
            state.present_count += 1;
            let paired = kept.get(&truth.id).or_else(|| fresh.get(&truth.id));
            let Some(track) = paired.and_then(|&id| frame.track(id)) else {
                state.interrupted = state.matched_count > 0;
                continue;
            };
            self.counts.fragmentation_count += u64::from(state.interrupted);
            state.interrupted = false;
            state.track = Some(track.id);
            state.matched_count += 1;
            matched_count += 1;
            self.counts.distance_sum_m += distance_m(truth.position_m, track.position_m);
        }
        self.counts.frames_len += 1;
        self.counts.matched_count += matched_count;
        self.counts.missed_count += frame.truths().len() as u64 - matched_count;
        self.counts.false_count += frame.tracks().len() as u64 - matched_count;
    }

    /// The counts of all frames.
    #[must_use]
    pub fn finish(mut self) -> ClearMotCounts {
        for state in self.truths.values() {
            if 10 * state.matched_count >= 8 * state.present_count {
                self.counts.mostly_tracked_count += 1;
            } else if 10 * state.matched_count >= 2 * state.present_count {
                self.counts.partly_tracked_count += 1;
            } else {
                self.counts.mostly_lost_count += 1;
            }
        }
        self.counts
    }

    /// The track of each truth that keeps its last track.
    fn kept(&self, frame: &Frame) -> BTreeMap<u64, u64> {
        let mut kept = BTreeMap::new();
        let mut taken = Vec::new();
        for truth in frame.truths() {
            let last = self.truths.get(&truth.id).and_then(|state| state.track);
            let Some(track) = last.and_then(|id| frame.track(id)) else { continue };
            let near = distance_m(truth.position_m, track.position_m) <= self.gate_m;
            if near && !taken.contains(&track.id) {
                kept.insert(truth.id, track.id);
                taken.push(track.id);
            }
        }
        kept
    }

    /// The track of each truth in a new pair.
    fn fresh(&self, frame: &Frame, kept: &BTreeMap<u64, u64>) -> BTreeMap<u64, u64> {
        let taken: Vec<u64> = kept.values().copied().collect();
        // One additional pair gains more than any change in distance.
        let pairs_max = frame.truths().len().min(frame.tracks().len()) as f64;
        let pair_gain = (pairs_max + 1.0) * self.gate_m + 1.0;
        let edges: Vec<Edge> = frame
            .pairs()
            .filter(|&(truth, track, distance_m)| {
                distance_m <= self.gate_m && !kept.contains_key(&truth.id) && !taken.contains(&track.id)
            })
            .map(|(truth, track, distance_m)| Edge {
                truth: truth.id,
                track: track.id,
                gain: pair_gain - distance_m,
            })
            .collect();
        best_pairs(&edges).into_iter().map(|i| (edges[i].truth, edges[i].track)).collect()
    }

    /// Counts how a new pair changes earlier pairs.
    fn count_change(&mut self, truth: u64, track: u64) {
        let last_track = self.truths.get(&truth).and_then(|state| state.track);
        let last_truth = self.truth_of.insert(track, truth);
        if last_track.is_some_and(|last| last != track) {
            self.counts.switch_count += 1;
            self.counts.ascent_count += u64::from(last_truth.is_none());
        }
        if last_truth.is_some_and(|last| last != truth) {
            self.counts.transfer_count += 1;
            self.counts.migration_count += u64::from(last_track.is_none());
        }
    }
}

/// The counts of [`ClearMot`] and their ratios. A ratio is `None` if its denominator is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClearMotCounts {
    /// Frames.
    pub frames_len: u64,
    /// Pairs of a truth and a track, summed over frames.
    pub matched_count: u64,
    /// Truths without a track.
    pub missed_count: u64,
    /// Tracks without a truth.
    pub false_count: u64,
    /// Pairs whose truth had another track before.
    pub switch_count: u64,
    /// Times that a truth was missed and paired again while it was present.
    pub fragmentation_count: u64,
    /// New pairs whose track had another truth before.
    pub transfer_count: u64,
    /// Switches to a track that never had a truth.
    pub ascent_count: u64,
    /// Transfers to a truth that never had a track.
    pub migration_count: u64,
    /// Truths paired in at least 80 % of their frames.
    pub mostly_tracked_count: u64,
    /// Truths paired in 20 % to 80 % of their frames.
    pub partly_tracked_count: u64,
    /// Truths paired in less than 20 % of their frames.
    pub mostly_lost_count: u64,
    /// Sum of the distances of all pairs.
    pub distance_sum_m: f64,
}

impl ClearMotCounts {
    /// Adds the counts of `other`, which is a different recording.
    pub fn merge(&mut self, other: &Self) {
        self.frames_len += other.frames_len;
        self.matched_count += other.matched_count;
        self.missed_count += other.missed_count;
        self.false_count += other.false_count;
        self.switch_count += other.switch_count;
        self.fragmentation_count += other.fragmentation_count;
        self.transfer_count += other.transfer_count;
        self.ascent_count += other.ascent_count;
        self.migration_count += other.migration_count;
        self.mostly_tracked_count += other.mostly_tracked_count;
        self.partly_tracked_count += other.partly_tracked_count;
        self.mostly_lost_count += other.mostly_lost_count;
        self.distance_sum_m += other.distance_sum_m;
    }

    /// Truths, summed over frames.
    pub const fn truths_len(&self) -> u64 {
        self.matched_count + self.missed_count
    }

    /// Tracks, summed over frames.
    pub const fn track_count(&self) -> u64 {
        self.matched_count + self.false_count
    }

    /// MOTA: 1 minus misses, false tracks and switches per truth. The best value is 1; there is no lower
    /// limit.
    pub fn mota(&self) -> Option<f64> {
        let errors = self.missed_count + self.false_count + self.switch_count;
        Some(1.0 - ratio(errors as f64, self.truths_len())?)
    }

    /// MODA: MOTA without the switches.
    pub fn moda(&self) -> Option<f64> {
        Some(1.0 - ratio((self.missed_count + self.false_count) as f64, self.truths_len())?)
    }

    /// MOTP: the mean distance of the pairs.
    pub fn motp_m(&self) -> Option<f64> {
        ratio(self.distance_sum_m, self.matched_count)
    }

    /// Share of the truths that have a track.
    pub fn recall(&self) -> Option<f64> {
        ratio(self.matched_count as f64, self.truths_len())
    }

    /// Share of the tracks that have a truth.
    pub fn precision(&self) -> Option<f64> {
        ratio(self.matched_count as f64, self.track_count())
    }

    /// Harmonic mean of precision and recall.
    pub fn f1(&self) -> Option<f64> {
        ratio(2.0 * self.matched_count as f64, self.truths_len() + self.track_count())
    }
}

/// The ratio; `None` if the denominator is 0.
pub(super) fn ratio(sum: f64, len: u64) -> Option<f64> {
    (len > 0).then(|| sum / len as f64)
}
