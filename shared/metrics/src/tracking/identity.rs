use std::collections::BTreeMap;

use super::clear_mot::ratio;
use super::frame::{Frame, TrackingError, check_gate};
use super::pairing::{Edge, best_pairs};

/// IDF1 of a recording, frame by frame: how much of the truth is covered by one track per truth.
///
/// Memory: one number per pair of ids that were within the gate in any frame.
#[derive(Clone, Debug)]
pub struct Identity {
    gate_m: f64,
    truths_len: u64,
    track_count: u64,
    /// Frames in which truth and track were within the gate.
    shared: BTreeMap<(u64, u64), u64>,
}

impl Identity {
    /// Counts pairs that are at most `gate_m` apart.
    ///
    /// # Errors
    /// If the gate is not between 0 and 10⁶ m.
    pub fn new(gate_m: f64) -> Result<Self, TrackingError> {
        check_gate(gate_m)?;
        Ok(Self { gate_m, truths_len: 0, track_count: 0, shared: BTreeMap::new() })
    }

    /// Counts a frame.
    pub fn add(&mut self, frame: &Frame) {
        self.truths_len += frame.truths().len() as u64;
        self.track_count += frame.tracks().len() as u64;
        for (truth, track, distance_m) in frame.pairs() {
            if distance_m <= self.gate_m {
                *self.shared.entry((truth.id, track.id)).or_default() += 1;
            }
        }
    }

    /// The counts under the one-to-one pairing of truths and tracks, over the whole recording, that shares
    /// most frames.
    pub fn finish(self) -> IdentityCounts {
        let edge =
            |(&(truth, track), &shared): (&(u64, u64), &u64)| Edge { truth, track, gain: shared as f64 };
        let edges: Vec<Edge> = self.shared.iter().map(edge).collect();
        // Numbers of frames are exact in f64 up to 2⁵³.
        let true_count = best_pairs(&edges).into_iter().map(|i| edges[i].gain).sum::<f64>() as u64;
        IdentityCounts {
            true_count,
            false_count: self.track_count - true_count,
            missed_count: self.truths_len - true_count,
        }
    }
}

/// The counts of [`Identity`] and their ratios. A ratio is `None` if its denominator is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IdentityCounts {
    /// IDTP: truths that are covered by the track paired with them.
    pub true_count: u64,
    /// IDFP: tracks that do not cover the truth paired with them.
    pub false_count: u64,
    /// IDFN: truths that are not covered by the track paired with them.
    pub missed_count: u64,
}

impl IdentityCounts {
    /// Adds the counts of `other`, which is a different recording.
    pub fn merge(&mut self, other: &Self) {
        self.true_count += other.true_count;
        self.false_count += other.false_count;
        self.missed_count += other.missed_count;
    }

    /// IDF1, the harmonic mean of IDP and IDR.
    pub fn idf1(&self) -> Option<f64> {
        ratio(2.0 * self.true_count as f64, 2 * self.true_count + self.false_count + self.missed_count)
    }

    /// IDP: share of the tracks that cover their truth.
    pub fn idp(&self) -> Option<f64> {
        ratio(self.true_count as f64, self.true_count + self.false_count)
    }

    /// IDR: share of the truths that are covered.
    pub fn idr(&self) -> Option<f64> {
        ratio(self.true_count as f64, self.true_count + self.missed_count)
    }
}
