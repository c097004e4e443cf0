use association::Candidate;
use association::assignment::Assigner;
use association::jpda::{Associator, Share};
use elementary::hypot;
use wire::{AgentType, Detection};

use crate::estimate::Estimate;
use crate::grid::{Grid, Spot};
use crate::observation::position_sigma_m;
use crate::options::{Association, InputModel, TrackerOptions};

/// 99 % of a chi-squared variable of two degrees of freedom: the gate for positions.
const GATE: f64 = 9.210_340_371_976_18;
/// The gate of the second round, of confirmed tracks and detections that the first left unpaired: five
/// standard deviations. A vehicle that brakes hard leaves the first gate, and would start a second track.
const WIDE_GATE: f64 = 25.0;
/// A detection that carries an identity belongs to its track unless it is farther away than this and any
/// speed allow.
const JUMP_MIN_M: f64 = 5.0;

/// Associates detections with estimates; holds only scratch memory.
#[derive(Clone, Debug)]
pub struct Pairing {
    /// The unpaired detections, in an order that does not depend on that of the frame.
    unpaired: Vec<u32>,
    grid: Grid,
    /// (identity, estimate), sorted.
    identities: Vec<(u64, u32)>,
    candidates: Vec<Candidate>,
    /// The candidates of the first gate, for the associator.
    possible: Vec<Candidate>,
    assigner: Assigner,
    associator: Associator,
    /// Detection of each estimate, as its only share.
    paired: Vec<Option<Share>>,
    /// Whether each estimate has the shares of the associator instead.
    joint: Vec<bool>,
    /// The detection of each estimate in one round.
    round: Vec<Option<u32>>,
    /// Whether each detection is paired, or left aside as a duplicate.
    taken: Vec<bool>,
}

impl Pairing {
    /// Scratch for so many estimates and detections.
    #[must_use]
    pub fn with_capacity(estimates_len: usize, detections_len: usize) -> Self {
        Self {
            unpaired: Vec::with_capacity(detections_len),
            grid: Grid::with_capacity(detections_len),
            identities: Vec::with_capacity(estimates_len),
            candidates: Vec::with_capacity(8 * estimates_len),
            possible: Vec::with_capacity(8 * estimates_len),
            assigner: Assigner::with_capacity(estimates_len, detections_len),
            associator: Associator::with_capacity(estimates_len, detections_len),
            paired: Vec::with_capacity(estimates_len),
            joint: Vec::with_capacity(estimates_len),
            round: Vec::with_capacity(estimates_len),
            taken: Vec::with_capacity(detections_len),
        }
    }

    /// The detection of an estimate; no two have the same.
    #[must_use]
    pub fn paired(&self, estimate: usize) -> Option<u32> {
        self.paired[estimate].map(|share| share.detection)
    }

    /// What updates an estimate: its detection, or all that may be its own.
    #[must_use]
    pub fn shares(&self, estimate: usize) -> &[Share] {
        if self.joint[estimate] {
            self.associator.of_track(estimate)
        } else {
            self.paired[estimate].as_slice()
        }
    }

    /// The detections that start tracks, in an order that does not depend on that of the frame.
    pub fn unpaired(&self) -> impl Iterator<Item = usize> + '_ {
        self.unpaired.iter().map(|&d| d as usize)
    }

    /// Pairs by identity: a detection belongs to the estimate of the last detection of its identity.
    ///
    /// Returns the number of detections left aside because another one of the frame carries the same
    /// identity.
    pub fn by_identity(&mut self, estimates: &[Estimate], detections: &[Detection]) -> usize {
        self.clear(estimates, detections);
        self.unpaired.sort_unstable_by_key(|&d| {
            let d = &detections[d as usize];
            (d.id, d.agent_type, d.x_m.to_bits(), d.y_m.to_bits())
        });
        self.identities.clear();
        self.identities.extend(estimates.iter().zip(0..).map(|(estimate, t)| (estimate.source_id(), t)));
        self.identities.sort_unstable();
        let mut duplicates_len = 0;
        let mut last = None;
        for &d in &self.unpaired {
            let detection = &detections[d as usize];
            if last.replace(detection.id) == Some(detection.id) {
                self.taken[d as usize] = true;
                duplicates_len += 1;
                continue;
            }
            // Of several estimates with the identity, the newest holds it.
            let end = self.identities.partition_point(|&(id, _)| id <= detection.id);
            let Some(&(id, t)) = end.checked_sub(1).and_then(|i| self.identities.get(i)) else { continue };
            if id == detection.id && !jumped(&estimates[t as usize], detection) {
                self.paired[t as usize] = Some(certain(d));
                self.taken[d as usize] = true;
            }
        }
        self.unpaired.retain(|&d| !self.taken[d as usize]);
        duplicates_len
    }

    /// Pairs by position and type: the optimal assignment of all pairs within the gate.
    ///
    /// A pair costs d² + ln |S|, plus the cost of the detection's type and that of the agent's occlusion; d²
    /// and S are those of the position, so that a wrong heading or speed does not cost a track its detection.
    /// A second round with a wider gate pairs confirmed tracks and detections that are left. Occluded tracks
    /// take no part in it: their miss needs no explanation.
    pub fn by_position(
        &mut self,
        estimates: &[Estimate],
        detections: &[Detection],
        types: &[AgentType],
        input: &InputModel,
        options: &TrackerOptions,
    ) {
        self.clear(estimates, detections);
        let detected = detections.iter().zip(types).zip(0..detections.len() as u32);
        self.grid.fill(detected.map(|((found, &agent_type), detection)| Spot {
            position_m: [f64::from(found.x_m), f64::from(found.y_m)],
            variance: position_sigma_m(found, agent_type, input).powi(2),
            detection,
            agent_type,
        }));
        let jointly = options.association == Association::Jpda;
        for gate in [GATE, WIDE_GATE] {
            self.find_candidates(estimates, gate, options);
            if jointly && gate == GATE {
                self.possible.clone_from(&self.candidates);
            }
            let miss_cost = options.miss_cost + (gate - GATE);
            self.assigner.solve(&mut self.candidates, detections.len(), miss_cost, &mut self.round);
            for (paired, found) in self.paired.iter_mut().zip(&self.round) {
                if let &Some(d) = found {
                    *paired = Some(certain(d));
                    self.taken[d as usize] = true;
                }
            }
        }
        if jointly {
            self.associate(estimates, detections.len(), options.miss_cost);
        }
        self.unpaired.retain(|&d| !self.taken[d as usize]);
        self.unpaired.sort_unstable_by(|&a, &b| {
            let (a, b) = (&detections[a as usize], &detections[b as usize]);
            a.x_m.total_cmp(&b.x_m).then(a.y_m.total_cmp(&b.y_m)).then(a.agent_type.cmp(&b.agent_type))
        });
    }

    /// Finds the probability of each pair within the first gate, for the estimates that are ready.
    ///
    /// The assignment alone decides which tracks are hit, and what updates the tentative ones: updated by all
    /// that may be theirs, those that clutter started would follow more of it. The same holds for a track
    /// whose detection lies beyond the first gate.
    fn associate(&mut self, estimates: &[Estimate], detections_len: usize, miss_cost: f64) {
        self.associator.associate(&mut self.possible, estimates.len(), detections_len, miss_cost);
        for (e, estimate) in estimates.iter().enumerate() {
            let shares = self.associator.of_track(e);
            let holds = |pair: Share| shares.iter().any(|share| share.detection == pair.detection);
            self.joint[e] = estimate.is_ready() && self.paired[e].is_none_or(holds);
        }
    }

    /// Finds all pairs within the gate, of estimates and detections that are unpaired.
    fn find_candidates(&mut self, estimates: &[Estimate], gate: f64, options: &TrackerOptions) {
        let Self { grid, candidates, paired, taken, .. } = self;
        let largest = grid.spots().iter().fold(0.0, |largest, spot| spot.variance.max(largest));
        candidates.clear();
        for ((estimate, t), paired) in estimates.iter().zip(0..).zip(&*paired) {
            if paired.is_some() || (gate > GATE && (!estimate.is_ready() || estimate.is_occluded())) {
                continue;
            }
            let occlusion_cost = estimate.occlusion_cost(options);
            let (centre_m, [xx, _, yy]) = estimate.belief.position();
            let reach_m = [xx, yy].map(|variance| (gate * (variance + largest)).sqrt());
            grid.near(centre_m, reach_m).for_each(|spot| {
                let off = |axis: usize| (spot.position_m[axis] - centre_m[axis]).abs() > reach_m[axis];
                if taken[spot.detection as usize] || off(0) || off(1) {
                    return;
                }
                let fit = estimate.fit(spot.position_m, spot.variance);
                if fit.distance2 <= gate {
                    let cost = fit.cost() + estimate.class.disagreement(spot.agent_type) + occlusion_cost;
                    candidates.push(Candidate { track: t, detection: spot.detection, cost });
                }
            });
        }
    }

    fn clear(&mut self, estimates: &[Estimate], detections: &[Detection]) {
        self.unpaired.clear();
        self.unpaired.extend(0..detections.len() as u32);
        self.taken.clear();
        self.taken.resize(detections.len(), false);
        self.paired.clear();
        self.paired.resize(estimates.len(), None);
        self.joint.clear();
        self.joint.resize(estimates.len(), false);
        self.round.clear();
        self.round.resize(estimates.len(), None);
    }
}

const fn certain(detection: u32) -> Share {
    Share { detection, probability: 1.0 }
}

fn jumped(estimate: &Estimate, detection: &Detection) -> bool {
    let ([x, y], _) = estimate.belief.position();
    let distance_m = hypot(f64::from(detection.x_m) - x, f64::from(detection.y_m) - y);
    distance_m > JUMP_MIN_M + f64::from(wire::SPEED_MAX_MPS) * estimate.since_seen_s()
}
