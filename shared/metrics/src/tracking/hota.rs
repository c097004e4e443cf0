use std::collections::BTreeMap;

use super::frame::Frame;
use super::pairing::{Edge, best_pairs};

/// The similarities α at or above which a pair counts as a match: 0.05, 0.10 … 0.95.
pub const ALPHAS: [f64; 19] = {
    let mut alphas = [0.05; 19];
    let mut i = 0;
    while i < alphas.len() {
        alphas[i] += 0.05 * i as f64;
        i += 1;
    }
    alphas
};

/// The similarity that falls from 1 at the same position to 0 at `zero_m` metres and beyond.
#[must_use]
pub fn linear_similarity(distance_m: f64, zero_m: f64) -> f64 {
    (1.0 - distance_m / zero_m).max(0.0)
}

/// HOTA of a recording, frame by frame.
///
/// In each frame, truths and tracks are paired by similarity, weighted by how well their trajectories align
/// over the whole recording. This needs all frames, so every pair with a similarity above 0 is stored until
/// the end. Memory: one entry per stored pair.
#[derive(Clone, Debug, Default)]
pub struct Hota {
    /// Frames of each truth, and of each track.
    truths: BTreeMap<u64, u64>,
    tracks: BTreeMap<u64, u64>,
    /// The pairs of each frame with a similarity above 0.
    frames: Vec<Vec<SimilarPair>>,
    shared: BTreeMap<(u64, u64), Shared>,
}

#[derive(Clone, Copy, Debug)]
struct SimilarPair {
    truth: u64,
    track: u64,
    similarity: f64,
}

/// The overlap of a truth and a track.
#[derive(Clone, Debug, Default)]
struct Shared {
    /// Frames in common, each weighted by how unambiguous the pair is.
    overlap: f64,
    /// Frames in which they were matched, per α.
    matched: [u64; ALPHAS.len()],
}

impl Hota {
    /// Counts a frame. `similarity` maps a distance in metres to 0 (nothing in common) … 1 (the same).
    ///
    /// The result of `similarity` is clamped to this range; NaN counts as 0.
    pub fn add(&mut self, frame: &Frame, similarity: impl Fn(f64) -> f64) {
        frame.truths().iter().for_each(|truth| *self.truths.entry(truth.id).or_default() += 1);
        frame.tracks().iter().for_each(|track| *self.tracks.entry(track.id).or_default() += 1);
        let mut pairs = Vec::new();
        for (truth, track, distance_m) in frame.pairs() {
            let similarity = similarity(distance_m);
            if similarity > 0.0 {
                pairs.push(SimilarPair { truth: truth.id, track: track.id, similarity: similarity.min(1.0) });
            }
        }
        self.add_overlaps(&pairs);
        self.frames.push(pairs);
    }

    /// Adds the pairs of a frame to the overlaps. Each pair adds its similarity divided by the sum of all
    /// similarities of its truth and its track.
    fn add_overlaps(&mut self, pairs: &[SimilarPair]) {
        let (mut of_truth, mut of_track) = (BTreeMap::<u64, f64>::new(), BTreeMap::<u64, f64>::new());
        for pair in pairs {
            *of_truth.entry(pair.truth).or_default() += pair.similarity;
            *of_track.entry(pair.track).or_default() += pair.similarity;
        }
        for pair in pairs {
            let all = of_truth[&pair.truth] + of_track[&pair.track] - pair.similarity;
            let overlap = if all > f64::EPSILON { pair.similarity / all } else { 0.0 };
            self.shared.entry((pair.truth, pair.track)).or_default().overlap += overlap;
        }
    }

    /// Pairs the objects of each frame and counts the matches at every α.
    #[must_use]
    pub fn finish(mut self) -> HotaCounts {
        let mut counts = HotaCounts {
            truths_len: self.truths.values().sum(),
            track_count: self.tracks.values().sum(),
            ..HotaCounts::default()
        };
        for pairs in std::mem::take(&mut self.frames) {
            for i in best_pairs(&self.edges(&pairs)) {
                let SimilarPair { truth, track, similarity } = pairs[i];
                let matched = &mut self.shared.entry((truth, track)).or_default().matched;
                for (k, alpha) in ALPHAS.iter().enumerate() {
                    if similarity >= alpha - f64::EPSILON {
                        matched[k] += 1;
                        counts.alphas[k].similarity_sum += similarity;
                    }
                }
            }
        }
        for (&(truth, track), shared) in &self.shared {
            for (counts, &matched_count) in counts.alphas.iter_mut().zip(&shared.matched) {
                counts.add_association(matched_count, self.truths[&truth], self.tracks[&track]);
            }
        }
        counts
    }

    /// The gain of each pair of a frame: its similarity, weighted by the overlap over the recording.
    fn edges(&self, pairs: &[SimilarPair]) -> Vec<Edge> {
        let edge = |&SimilarPair { truth, track, similarity }: &SimilarPair| {
            let overlap = self.shared[&(truth, track)].overlap;
            let either = (self.truths[&truth] + self.tracks[&track]) as f64 - overlap;
            Edge { truth, track, gain: overlap / either * similarity }
        };
        pairs.iter().map(edge).collect()
    }
}

/// The counts of [`Hota`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HotaCounts {
    /// Truths, summed over frames.
    pub truths_len: u64,
    /// Tracks, summed over frames.
    pub track_count: u64,
    /// The matches at each of [`ALPHAS`].
    pub alphas: [AlphaCounts; ALPHAS.len()],
}

/// The matches at one α, and sums over the matches.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AlphaCounts {
    /// Matches: pairs that are at least as similar as α.
    pub matched_count: u64,
    /// Sum of the similarities of the matches.
    pub similarity_sum: f64,
    /// Sum over matches: frames in which truth and track are matched, divided by the frames that contain
    /// either.
    pub association_sum: f64,
    /// The same, divided by the frames that contain the truth.
    pub association_recall_sum: f64,
    /// The same, divided by the frames that contain the track.
    pub association_precision_sum: f64,
}

impl AlphaCounts {
    fn add_association(&mut self, matched_count: u64, truth_count: u64, track_count: u64) {
        if matched_count == 0 {
            return;
        }
        let squared = (matched_count * matched_count) as f64;
        self.matched_count += matched_count;
        self.association_sum += squared / (truth_count + track_count - matched_count) as f64;
        self.association_recall_sum += squared / truth_count as f64;
        self.association_precision_sum += squared / track_count as f64;
    }

    fn merge(&mut self, other: &Self) {
        self.matched_count += other.matched_count;
        self.similarity_sum += other.similarity_sum;
        self.association_sum += other.association_sum;
        self.association_recall_sum += other.association_recall_sum;
        self.association_precision_sum += other.association_precision_sum;
    }
}

/// HOTA and its parts, at one α or averaged over all. Each is 0 to 1; higher is better.
///
/// If nothing was matched, `loc_a` is 1 and all others are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HotaScore {
    /// Geometric mean of `det_a` and `ass_a`.
    pub hota: f64,
    /// Detection accuracy: matches divided by the number of truths and tracks, matched or not.
    pub det_a: f64,
    /// Detection recall: matches per truth.
    pub det_re: f64,
    /// Detection precision: matches per track.
    pub det_pr: f64,
    /// Association accuracy: mean over the matches of the frames shared by truth and track, per frame of
    /// either.
    pub ass_a: f64,
    /// Association recall: the same per frame of the truth.
    pub ass_re: f64,
    /// Association precision: the same per frame of the track.
    pub ass_pr: f64,
    /// Mean similarity of the matches.
    pub loc_a: f64,
    /// Geometric mean of `det_re` and `ass_a`: HOTA without the penalty of false tracks.
    pub owta: f64,
}

impl HotaCounts {
    /// Adds the counts of `other`, which is a different recording.
    pub fn merge(&mut self, other: &Self) {
        self.truths_len += other.truths_len;
        self.track_count += other.track_count;
        self.alphas.iter_mut().zip(&other.alphas).for_each(|(ours, theirs)| ours.merge(theirs));
    }

    /// The scores at each of [`ALPHAS`].
    pub fn scores(&self) -> [HotaScore; ALPHAS.len()] {
        self.alphas.each_ref().map(|alpha| self.score(alpha))
    }

    /// The mean of the scores over [`ALPHAS`], which papers report.
    pub fn mean(&self) -> HotaScore {
        let scores = self.scores();
        let mean = |part: fn(&HotaScore) -> f64| scores.iter().map(part).sum::<f64>() / scores.len() as f64;
        HotaScore {
            hota: mean(|score| score.hota),
            det_a: mean(|score| score.det_a),
            det_re: mean(|score| score.det_re),
            det_pr: mean(|score| score.det_pr),
            ass_a: mean(|score| score.ass_a),
            ass_re: mean(|score| score.ass_re),
            ass_pr: mean(|score| score.ass_pr),
            loc_a: mean(|score| score.loc_a),
            owta: mean(|score| score.owta),
        }
    }

    fn score(&self, alpha: &AlphaCounts) -> HotaScore {
        if alpha.matched_count == 0 {
            return HotaScore { loc_a: 1.0, ..HotaScore::default() };
        }
        let matched_count = alpha.matched_count as f64;
        let det_re = matched_count / self.truths_len as f64;
        let det_a = matched_count / (self.truths_len + self.track_count - alpha.matched_count) as f64;
        let ass_a = alpha.association_sum / matched_count;
        HotaScore {
            hota: (det_a * ass_a).sqrt(),
            det_a,
            det_re,
            det_pr: matched_count / self.track_count as f64,
            ass_a,
            ass_re: alpha.association_recall_sum / matched_count,
            ass_pr: alpha.association_precision_sum / matched_count,
            loc_a: alpha.similarity_sum / matched_count,
            owta: (det_re * ass_a).sqrt(),
        }
    }
}
