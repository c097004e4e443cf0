use super::{JointAssociation, SIDE_MAX};
use crate::Candidate;
use crate::assignment::Assigner;
use crate::components::Components;

/// A detection that may belong to a track, with the probability that it does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share {
    /// Number of the detection.
    pub detection: u32,
    /// Probability of the pair, β.
    pub probability: f64,
}

/// Finds the probability of each pair of a frame. Holds the last result and scratch memory.
///
/// The weight of an event is exp(−½ Σ cost). The [assignment](Assigner::solve) of the same candidates
/// minimises the same cost. It finds the most likely event, while this sums over all events.
///
/// Components of up to [`SIDE_MAX`] tracks and detections are exact. A larger component is cut into such
/// components. The pairs of its optimal assignment remain, followed by the cheapest other pairs that keep
/// within the bound. A removed pair counts as beyond the gate.
#[derive(Clone, Debug, Default)]
pub struct Associator {
    components: Components,
    assigner: Assigner,
    /// Candidates for the assignment of a component that is too large. `paired` holds its result.
    for_assigner: Vec<Candidate>,
    paired: Vec<Option<u32>>,
    shares: Vec<Share>,
    /// Start and end of each track's shares.
    of_track: Vec<[u32; 2]>,
}

impl Associator {
    /// Scratch memory for this number of tracks and detections.
    #[must_use]
    pub fn with_capacity(track_count: usize, detection_count: usize) -> Self {
        Self {
            components: Components::with_capacity(track_count, detection_count),
            assigner: Assigner::with_capacity(track_count, detection_count),
            for_assigner: Vec::new(),
            paired: Vec::with_capacity(track_count),
            shares: Vec::new(),
            of_track: Vec::with_capacity(track_count),
        }
    }

    /// Finds the probabilities of all candidates. Costs are on the scale of −2 ln of a likelihood:
    ///
    /// ```text
    /// cost − miss_cost = −2 ln (P_D N(y; 0, S) / λ) + 2 ln (1 − P_D)
    /// ```
    ///
    /// Candidates are sorted in place. A candidate is ignored if its cost is not finite or if it was cut.
    ///
    /// # Panics
    /// If a candidate names a track or detection beyond the given numbers.
    pub fn associate(
        &mut self,
        candidates: &mut Vec<Candidate>,
        track_count: usize,
        detection_count: usize,
        miss_cost: f64,
    ) {
        candidates.retain(|c| c.cost.is_finite());
        self.components.clear(track_count, detection_count);
        for candidate in candidates.iter() {
            self.components.join(candidate, usize::MAX);
        }
        if self.components.exceed(SIDE_MAX) {
            self.cut(candidates, track_count, detection_count, miss_cost);
        }
        self.shares.clear();
        self.of_track.clear();
        self.of_track.resize(track_count, [0; 2]);
        for component in self.components.split(candidates) {
            for (track, shares) in probabilities(component, miss_cost) {
                let begin = self.shares.len() as u32;
                self.shares.extend(shares);
                self.of_track[track as usize] = [begin, self.shares.len() as u32];
            }
        }
    }

    /// The detections that may belong to a track, in rising order. The remaining probability is that of its
    /// miss.
    ///
    /// # Panics
    /// If the track does not exist.
    #[must_use]
    pub fn of_track(&self, track: usize) -> &[Share] {
        let [begin, end] = self.of_track[track];
        &self.shares[begin as usize..end as usize]
    }

    /// Removes candidates of oversized components until every component is within the bound.
    fn cut(
        &mut self,
        candidates: &mut Vec<Candidate>,
        track_count: usize,
        detection_count: usize,
        miss_cost: f64,
    ) {
        self.for_assigner.clone_from(candidates);
        self.paired.clear();
        self.paired.resize(track_count, None);
        self.assigner.solve(&mut self.for_assigner, detection_count, miss_cost, &mut self.paired);
        let paired = &self.paired;
        let is_paired = |c: &Candidate| paired[c.track as usize] == Some(c.detection);
        candidates.sort_unstable_by(|a, b| {
            let by_cost = is_paired(b).cmp(&is_paired(a)).then(a.cost.total_cmp(&b.cost));
            by_cost.then((a.track, a.detection).cmp(&(b.track, b.detection)))
        });
        self.components.clear(track_count, detection_count);
        candidates.retain(|candidate| self.components.join(candidate, SIDE_MAX));
    }
}

/// The tracks of a component, each with the probabilities of its detections.
fn probabilities(
    component: &[Candidate],
    miss_cost: f64,
) -> impl Iterator<Item = (u32, impl Iterator<Item = Share>)> {
    let mut detections = [None; SIDE_MAX];
    let mut log_weights = [[None; SIDE_MAX]; SIDE_MAX];
    let by_track = || component.chunk_by(|a, b| a.track == b.track);
    for (row, of_track) in by_track().enumerate() {
        for candidate in of_track {
            let column = column(&detections, candidate);
            detections[column] = Some(candidate.detection);
            log_weights[row][column] = Some(-0.5 * candidate.cost);
        }
    }
    let (track_count, detection_count) = (by_track().count(), detections.iter().flatten().count());
    let log_weight = |row: usize, column: usize| log_weights[row][column];
    let found = JointAssociation::enumerate(track_count, detection_count, -0.5 * miss_cost, log_weight);
    by_track().enumerate().map(move |(row, of_track)| {
        let share = move |candidate: &Candidate| {
            let probability = found.pair(row, column(&detections, candidate));
            Share { detection: candidate.detection, probability }
        };
        (of_track[0].track, of_track.iter().map(share))
    })
}

/// Column of a candidate's detection in its component. A new detection gets the next free column.
fn column(detections: &[Option<u32>; SIDE_MAX], candidate: &Candidate) -> usize {
    let found = detections.iter().position(|d| d.is_none_or(|d| d == candidate.detection));
    found.expect("a component within the bound")
}
