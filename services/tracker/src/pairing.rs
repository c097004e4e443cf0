use std::ops::Range;

use association::Candidate;
use association::assignment::Assigner;
use association::jpda::{Associator, Share};
use kinematics::hypot;
use wire::{AgentType, Detection};

use crate::estimate::Estimate;
use crate::grid::{Grid, Spot};
use crate::observation::{Found, gate_sigma_m};
use crate::options::{Association, InputModel, TrackerOptions};

/// 99 % quantile of a χ² variable with two degrees of freedom: the gate for positions.
const GATE: f64 = 9.210_340_371_976_18;
/// The gate of the second round, for confirmed tracks and detections that the first round left unpaired: five
/// standard deviations. A vehicle that brakes hard leaves the first gate and would start a second track.
const WIDE_GATE: f64 = 25.0;
/// Largest number of rounds in which an estimate gets a further detection, each with another own time.
const MORE_ROUNDS: usize = 8;

/// Associates detections with estimates. Holds only scratch memory.
#[derive(Clone, Debug)]
pub struct Pairing {
    /// The unpaired detections, in an order that is independent of their order in the frame.
    unpaired: Vec<u32>,
    grid: Grid,
    /// (identity, estimate), sorted.
    identities: Vec<(u64, u32)>,
    /// The detections in the order of their identities and own times, without duplicates.
    ordered: Vec<u32>,
    /// Range in `ordered` of the detections of each estimate.
    own: Vec<Range<usize>>,
    /// Further detections of an estimate with other own times: (estimate, detection).
    more: Vec<(u32, u32)>,
    /// The positions of the frame's detections.
    places: PlaceFilter,
    /// Whether each estimate's last detection was sent again.
    resent: Vec<bool>,
    candidates: Vec<Candidate>,
    /// The candidates of the first gate, for the associator.
    possible: Vec<Candidate>,
    assigner: Assigner,
    associator: Associator,
    /// Detection of each estimate, as its only share.
    paired: Vec<Option<Share>>,
    /// Whether each estimate uses the shares of the associator instead.
    joint: Vec<bool>,
    /// The detection of each estimate in one round.
    round: Vec<Option<u32>>,
    /// Whether each detection is paired or discarded as a duplicate.
    taken: Vec<bool>,
    /// Whether the pair of each estimate contradicts the reported velocity.
    contradicted: Vec<bool>,
}

impl Pairing {
    /// Scratch memory for this number of estimates and detections.
    #[must_use]
    pub fn with_capacity(estimate_count: usize, detection_count: usize) -> Self {
        Self {
            unpaired: Vec::with_capacity(detection_count),
            grid: Grid::with_capacity(detection_count),
            identities: Vec::with_capacity(estimate_count),
            ordered: Vec::with_capacity(detection_count),
            own: Vec::with_capacity(estimate_count),
            more: Vec::with_capacity(detection_count),
            places: PlaceFilter::default(),
            resent: Vec::with_capacity(estimate_count),
            candidates: Vec::with_capacity(8 * estimate_count),
            possible: Vec::with_capacity(8 * estimate_count),
            assigner: Assigner::with_capacity(estimate_count, detection_count),
            associator: Associator::with_capacity(estimate_count, detection_count),
            paired: Vec::with_capacity(estimate_count),
            joint: Vec::with_capacity(estimate_count),
            round: Vec::with_capacity(estimate_count),
            taken: Vec::with_capacity(detection_count),
            contradicted: Vec::with_capacity(estimate_count),
        }
    }

    /// The detection of an estimate. No two estimates have the same one.
    #[must_use]
    pub fn paired(&self, estimate: usize) -> Option<u32> {
        self.paired[estimate].map(|share| share.detection)
    }

    /// The detections that update an estimate: its only one, or all that may belong to it.
    #[must_use]
    pub fn shares(&self, estimate: usize) -> &[Share] {
        if self.joint[estimate] {
            self.associator.of_track(estimate)
        } else {
            self.paired[estimate].as_slice()
        }
    }

    /// The detections that start tracks, in an order that is independent of their order in the frame.
    pub fn unpaired(&self) -> impl Iterator<Item = usize> + '_ {
        self.unpaired.iter().map(|&d| d as usize)
    }

    /// The detections of an estimate by its identity, in the order of their own times.
    #[must_use]
    pub fn of_identity(&self, estimate: usize) -> &[u32] {
        &self.ordered[self.own[estimate].clone()]
    }

    /// Further detections of an estimate, with own times other than the paired one's.
    pub fn more(&self, estimate: usize) -> impl Iterator<Item = usize> + '_ {
        let of_estimate = self.more.iter().filter(move |(e, _)| *e as usize == estimate);
        of_estimate.map(|(_, d)| *d as usize)
    }

    /// Whether an estimate's last detection was sent again although the agent moves.
    #[must_use]
    pub fn is_resent(&self, estimate: usize) -> bool {
        self.resent[estimate]
    }

    /// Whether the pair of an estimate contradicts the reported velocity.
    #[must_use]
    pub fn is_contradicted(&self, estimate: usize) -> bool {
        self.contradicted[estimate]
    }

    /// Whether several detections of the frame may have exactly the same position.
    #[must_use]
    pub const fn shares_places(&self) -> bool {
        self.places.has_shared
    }

    /// Groups by identity: detections belong to the estimate of the last detection with their identity.
    /// Detections with the same identity and own time are duplicates, and all but one are discarded.
    ///
    /// Returns the number of discarded detections.
    pub fn by_identity(&mut self, estimates: &[Estimate], detections: &[Detection]) -> usize {
        self.clear(estimates, detections);
        self.places.fill(detections);
        self.unpaired.sort_unstable_by_key(|&d| {
            let d = &detections[d as usize];
            (d.id, d.offset_ns, d.agent_type, d.x_m.to_bits(), d.y_m.to_bits())
        });
        self.unpaired.dedup_by_key(|d| {
            let d = &detections[*d as usize];
            (d.id, d.offset_ns)
        });
        self.identities.clear();
        self.identities.extend(estimates.iter().zip(0..).map(|(estimate, t)| (estimate.source_id(), t)));
        self.identities.sort_unstable();
        self.ordered.clone_from(&self.unpaired);
        self.own.clear();
        self.own.resize(estimates.len(), 0..0);
        let mut from = 0;
        for run in self.ordered.chunk_by(|&a, &b| detections[a as usize].id == detections[b as usize].id) {
            let own = from..from + run.len();
            from = own.end;
            let identity = detections[run[0] as usize].id;
            // If several estimates have the identity, the newest one holds it.
            let end = self.identities.partition_point(|&(id, _)| id <= identity);
            let holder = end.checked_sub(1).and_then(|i| self.identities.get(i));
            if let Some(&(_, t)) = holder.filter(|(id, _)| *id == identity) {
                run.iter().for_each(|&d| self.taken[d as usize] = true);
                self.own[t as usize] = own;
            }
        }
        self.unpaired.retain(|&d| !self.taken[d as usize]);
        detections.len() - self.ordered.len()
    }

    /// Pairs by position and type: the optimal assignment of all pairs within the gate.
    ///
    /// A pair costs d² + ln |S|, plus the costs of the detection's type and of the agent's occlusion. d² and
    /// S refer to the position, so a track does not lose its detection because of a wrong heading or speed. A
    /// second round with a wider gate pairs the remaining confirmed tracks and detections. Occluded tracks do
    /// not take part in it, because their miss needs no explanation.
    ///
    /// Detections with different own times may belong to one agent that several sensors see. In this case
    /// published tracks come first, and each may take one detection per own time.
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
            variance: gate_sigma_m(found, agent_type, input, options).powi(2),
            detection,
            agent_type,
        }));
        let jointly = options.association == Association::Jpda;
        let frame = Frame { detections, types, input, options };
        self.set_aside_resent(estimates, &frame);
        let are_mixed = detections.iter().any(|d| d.offset_ns != detections[0].offset_ns);
        for gate in [GATE, WIDE_GATE] {
            self.find_candidates(estimates, gate, Members::new(are_mixed && gate == GATE), &frame);
            if jointly && gate == GATE {
                self.possible.clone_from(&self.candidates);
            }
            self.pair(gate, detections.len(), options);
            if are_mixed {
                self.pair_more(estimates, Members::UnpairedReady, &frame);
            }
        }
        if are_mixed {
            self.find_candidates(estimates, GATE, Members::UnpairedTentative, &frame);
            self.pair(GATE, detections.len(), options);
            self.pair_more(estimates, Members::UnpairedTentative, &frame);
        }
        if jointly {
            self.associate(estimates, detections.len(), options.miss_cost);
        }
        self.pair_contradicted(estimates, &frame);
        self.unpaired.retain(|&d| !self.taken[d as usize]);
        self.unpaired.sort_unstable_by(|&a, &b| {
            let (a, b) = (&detections[a as usize], &detections[b as usize]);
            a.x_m.total_cmp(&b.x_m).then(a.y_m.total_cmp(&b.y_m)).then(a.agent_type.cmp(&b.agent_type))
        });
    }

    /// Pairs tentative tracks with unpaired detections that have the reports of their last one, wherever they are:
    /// the reported velocity may be wrong.
    fn pair_contradicted(&mut self, estimates: &[Estimate], frame: &Frame<'_>) {
        let Self { grid, candidates, paired, taken, .. } = self;
        let latest_ns = frame.detections.iter().map(|found| found.offset_ns).max().unwrap_or(0);
        candidates.clear();
        for ((estimate, track), paired) in estimates.iter().zip(0..).zip(&*paired) {
            if paired.is_some() || !estimate.follows_reports() {
                continue;
            }
            let (from_m, reach_m) =
                estimate.reach(estimate.stamp_ns().saturating_add(latest_ns), frame.options);
            let near = grid.near(from_m, [reach_m; 2]).filter(|spot| !taken[spot.detection as usize]);
            for &Spot { detection, position_m: [x, y], .. } in near {
                let found = frame.found(detection as usize, estimate.stamp_ns());
                if estimate.resembles(&found, frame.options) {
                    let way_m = hypot(x - from_m[0], y - from_m[1]);
                    // Below the cost of a miss, and higher for longer ways.
                    let cost = frame.options.miss_cost - 1.0 / (1.0 + way_m);
                    candidates.push(Candidate { track, detection, cost });
                }
            }
        }
        if self.candidates.is_empty() {
            return;
        }
        self.pair(GATE, frame.detections.len(), frame.options);
        for (contradicted, found) in self.contradicted.iter_mut().zip(&self.round) {
            *contradicted = found.is_some();
        }
    }

    /// Computes the probability of each pair within the first gate, for the estimates that are ready.
    ///
    /// The assignment alone decides which tracks are hit, and which detections update tentative tracks. A
    /// tentative track that clutter started would otherwise follow more clutter. The assignment also updates
    /// a track whose detection is beyond the first gate.
    fn associate(&mut self, estimates: &[Estimate], detection_count: usize, miss_cost: f64) {
        self.associator.associate(&mut self.possible, estimates.len(), detection_count, miss_cost);
        for (e, estimate) in estimates.iter().enumerate() {
            let shares = self.associator.of_track(e);
            let holds = |pair: Share| shares.iter().any(|share| share.detection == pair.detection);
            self.joint[e] = estimate.is_ready() && self.paired[e].is_none_or(holds);
        }
    }

    /// Sets aside the resent detections and their estimates.
    fn set_aside_resent(&mut self, estimates: &[Estimate], frame: &Frame<'_>) {
        self.places.fill(frame.detections);
        for (estimate, resent) in estimates.iter().zip(&mut self.resent) {
            let Some(place) = estimate.resent_from().filter(|place| self.places.may_hold(*place)) else {
                continue;
            };
            let found = (0..frame.detections.len()).find(|&d| {
                !self.taken[d]
                    && place_of(&frame.detections[d]) == place
                    && estimate.is_resent(&frame.found(d, estimate.stamp_ns()))
            });
            if let Some(d) = found {
                self.taken[d] = true;
                *resent = true;
            }
        }
    }

    /// Pairs the candidates at the least cost.
    fn pair(&mut self, gate: f64, detection_count: usize, options: &TrackerOptions) {
        let miss_cost = options.miss_cost + (gate - GATE);
        self.assigner.solve(&mut self.candidates, detection_count, miss_cost, &mut self.round);
        for (paired, found) in self.paired.iter_mut().zip(&self.round) {
            if let &Some(d) = found {
                *paired = Some(certain(d));
                self.taken[d as usize] = true;
            }
        }
    }

    /// Gives paired estimates further detections, with own times that they do not have yet.
    fn pair_more(&mut self, estimates: &[Estimate], members: Members, frame: &Frame<'_>) {
        for _ in 0..MORE_ROUNDS {
            self.find_candidates(estimates, GATE, members.paired(), frame);
            let (paired, more) = (&self.paired, &self.more);
            let own_ns = |d: u32| frame.detections[d as usize].offset_ns;
            self.candidates.retain(|candidate| {
                let first = paired[candidate.track as usize].map(|share| share.detection);
                let others = more.iter().filter(|(e, _)| *e == candidate.track).map(|(_, d)| *d);
                first.into_iter().chain(others).all(|d| own_ns(d) != own_ns(candidate.detection))
            });
            self.assigner.solve(
                &mut self.candidates,
                frame.detections.len(),
                frame.options.miss_cost,
                &mut self.round,
            );
            let before = self.more.len();
            for (e, found) in (0..).zip(&self.round) {
                if let &Some(d) = found {
                    self.more.push((e, d));
                    self.taken[d as usize] = true;
                }
            }
            if self.more.len() == before {
                return;
            }
        }
    }

    /// Finds all pairs within the gate, of selected estimates and unpaired detections.
    fn find_candidates(&mut self, estimates: &[Estimate], gate: f64, members: Members, frame: &Frame<'_>) {
        let Self { grid, candidates, paired, taken, resent, .. } = self;
        let largest = grid.spots().iter().fold(0.0, |largest, spot| spot.variance.max(largest));
        let lag_max_ns = frame.detections.iter().fold(0, |most, d| d.offset_ns.unsigned_abs().max(most));
        candidates.clear();
        for ((estimate, t), paired) in estimates.iter().zip(0..).zip(&*paired) {
            if paired.is_some() != members.are_paired() || resent[t as usize] {
                continue;
            }
            if (gate > GATE && (!estimate.is_ready() || estimate.is_occluded())) || !members.contain(estimate)
            {
                continue;
            }
            let occlusion_cost = estimate.occlusion_cost(frame.options);
            let (centre_m, [xx, _, yy]) = estimate.belief.position();
            let mut reach_m = [xx, yy].map(|variance| (gate * (variance + largest)).sqrt());
            if lag_max_ns > 0 {
                let moved_m =
                    estimate.belief.motion().velocity_mps.map(|v| v.abs() * lag_max_ns as f64 / 1e9);
                reach_m = [0, 1].map(|axis| reach_m[axis] + moved_m[axis]);
            }
            grid.near(centre_m, reach_m).for_each(|spot| {
                let off = |axis: usize| (spot.position_m[axis] - centre_m[axis]).abs() > reach_m[axis];
                if taken[spot.detection as usize] || off(0) || off(1) {
                    return;
                }
                let found = frame.found(spot.detection as usize, estimate.stamp_ns());
                let fit = estimate.fit(&found, spot.variance, frame.input);
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
        self.more.clear();
        self.resent.clear();
        self.resent.resize(estimates.len(), false);
        self.contradicted.clear();
        self.contradicted.resize(estimates.len(), false);
    }
}

/// The data to associate.
struct Frame<'a> {
    detections: &'a [Detection],
    types: &'a [AgentType],
    input: &'a InputModel,
    options: &'a TrackerOptions,
}

impl Frame<'_> {
    /// A detection of the frame with this stamp.
    fn found(&self, detection: usize, stamp_ns: i64) -> Found<'_> {
        Found::new(stamp_ns, &self.detections[detection], self.types[detection])
    }
}

/// The estimates that take part in a round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Members {
    /// All that are unpaired.
    Unpaired,
    /// The unpaired estimates that are ready. `UnpairedTentative` selects the other unpaired ones.
    UnpairedReady,
    UnpairedTentative,
    /// The paired estimates that are ready. `PairedTentative` selects the other paired ones.
    PairedReady,
    PairedTentative,
}

impl Members {
    const fn new(ready: bool) -> Self {
        if ready { Self::UnpairedReady } else { Self::Unpaired }
    }

    const fn paired(self) -> Self {
        if matches!(self, Self::UnpairedTentative) { Self::PairedTentative } else { Self::PairedReady }
    }

    const fn are_paired(self) -> bool {
        matches!(self, Self::PairedReady | Self::PairedTentative)
    }

    const fn contain(self, estimate: &Estimate) -> bool {
        match self {
            Self::Unpaired => true,
            Self::UnpairedReady | Self::PairedReady => estimate.is_ready(),
            Self::UnpairedTentative | Self::PairedTentative => !estimate.is_ready(),
        }
    }
}

/// The exact positions of a frame's detections as one bit each. A position without its bit is not in the
/// frame.
#[derive(Clone, Debug)]
struct PlaceFilter {
    bits: [u64; 64],
    /// Whether two positions may be equal.
    has_shared: bool,
}

impl Default for PlaceFilter {
    fn default() -> Self {
        Self { bits: [0; 64], has_shared: false }
    }
}

impl PlaceFilter {
    fn fill(&mut self, detections: &[Detection]) {
        *self = Self::default();
        for detection in detections {
            let (word, bit) = Self::at(place_of(detection));
            self.has_shared |= self.bits[word] & bit != 0;
            self.bits[word] |= bit;
        }
    }

    fn may_hold(&self, place: [u32; 2]) -> bool {
        let (word, bit) = Self::at(place);
        self.bits[word] & bit != 0
    }

    /// Fibonacci hashing.
    const fn at([x, y]: [u32; 2]) -> (usize, u64) {
        let mixed = ((x as u64) << 32 | y as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 52;
        ((mixed >> 6) as usize, 1 << (mixed & 63))
    }
}

/// The bits of a detection's position.
const fn place_of(detection: &Detection) -> [u32; 2] {
    [detection.x_m.to_bits(), detection.y_m.to_bits()]
}

const fn certain(detection: u32) -> Share {
    Share { detection, probability: 1.0 }
}
