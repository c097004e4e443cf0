//! Track management: whether an agent exists, when its track is confirmed, and how long it may coast.
//!
//! **Existence.** The log-odds of existence grow by ln(P_D p(z) / λ) with each hit, where p(z) is the
//! detection's density under the prediction, and by ln(1 − P_D) with each miss. The miss probability accounts
//! for occlusion: if less than half of an agent is visible, its P_D falls with its visibility.
//!
//! **Confirmation.** A track is tentative until three of the last five frames that observed its type have
//! detected it and its existence is nearly certain.
//!
//! **Coast time.** A track earns coast time while it is detected. A track that clutter keeps alive is
//! detected too rarely to earn much. Occluded time uses up less coast time, depending on how much was earned.

use crate::options::{InputModel, TrackerOptions};

/// Coast time earned per time in which a track is detected.
const COAST_RATIO: u64 = 2;
/// From this visibility on, an agent is detected as well as in full view. The value was chosen on KITTI,
/// where missed tracks that are half occluded mostly have no agent.
const VISIBILITY_TO_DETECT: f64 = 0.5;
/// Bounds of the log-odds of existence and of each change, so that a few frames can change them.
const EXISTENCE_MAX: f64 = 10.0;
/// Log-odds of one in a hundred. This share of the detections that no track explains are agents; the others
/// are clutter.
const EXISTENCE_AT_BIRTH: f64 = -4.6;
/// Log-odds of 99 %, from which a track may be confirmed.
const EXISTENCE_TO_CONFIRM: f64 = 4.6;
/// Frames over which hits are counted, as a mask of the newest frames.
const HITS_MASK: u8 = 0b1_1111;
/// Number of hits among these frames that confirms a track.
const HITS_TO_CONFIRM: u32 = 3;
/// Number of misses among these frames that deletes a tentative track, because it cannot be confirmed in
/// time.
const MISSES_TO_DELETE: u32 = 3;

/// Existence, confirmation and coast time of one track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackManagement {
    /// Log-odds that the agent exists.
    existence: f64,
    /// One bit per frame that observed the type, newest in the lowest bit: 1 for a hit.
    hits: u8,
    /// Number of frames since birth that observed the type, counted up to five.
    frames: u8,
    confirmed: bool,
    /// Whether detections have an identity that can be trusted.
    trusted: bool,
    /// Remaining coast time. It is negative if the track has coasted for longer.
    coast_left_ns: i64,
    /// Coast time at the last hit.
    coast_earned_ns: u64,
    /// Time since the last hit during which the agent was occluded.
    occluded_ns: u64,
}

impl TrackManagement {
    /// The state after the first detection. It is confirmed immediately if the detection's identity can be
    /// trusted.
    #[must_use]
    pub const fn new(trusted: bool) -> Self {
        let existence = if trusted { 0.0 } else { EXISTENCE_AT_BIRTH };
        Self {
            existence,
            hits: 1,
            frames: 1,
            confirmed: trusted,
            trusted,
            coast_left_ns: 0,
            coast_earned_ns: 0,
            occluded_ns: 0,
        }
    }

    /// The state of a confirmed track with this existence probability and age, `unseen_ns` after its last
    /// hit. The track is assumed to have been detected until then.
    #[must_use]
    pub fn of_confirmed(
        probability: f64,
        (age_ns, unseen_ns): (u64, u64),
        trusted: bool,
        input: &InputModel,
    ) -> Self {
        let odds = probability / (1.0 - probability).max(f64::MIN_POSITIVE);
        let earned_ns = age_ns.saturating_sub(unseen_ns).saturating_mul(COAST_RATIO).min(input.coast_ns);
        Self {
            existence: odds.max(f64::MIN_POSITIVE).ln().clamp(-EXISTENCE_MAX, EXISTENCE_MAX),
            hits: if unseen_ns == 0 { HITS_MASK } else { HITS_MASK & !1 },
            frames: HITS_MASK.count_ones() as u8,
            confirmed: true,
            trusted,
            coast_left_ns: earned_ns.cast_signed().saturating_sub_unsigned(unseen_ns),
            coast_earned_ns: earned_ns,
            occluded_ns: 0,
        }
    }

    /// Counts a detection with this log-density under the prediction, `dt_ns` after the previous state.
    pub fn hit(&mut self, log_density: f64, dt_ns: u64, input: &InputModel, options: &TrackerOptions) {
        self.add_evidence((options.detection_probability / options.clutter_density).ln() + log_density);
        self.count(true);
        self.confirmed |= self.hits.count_ones() >= HITS_TO_CONFIRM && self.is_certain();
        let earned_ns = dt_ns.saturating_mul(COAST_RATIO);
        self.coast_left_ns = self.coast_left_ns.max(0).saturating_add_unsigned(earned_ns.min(input.coast_ns));
        self.coast_left_ns = self.coast_left_ns.min(input.coast_ns.cast_signed());
        self.coast_earned_ns = self.coast_left_ns.unsigned_abs();
        self.occluded_ns = 0;
    }

    /// Counts a miss by a frame `dt_ns` after the previous state. `visibility` is the share of the agent
    /// visible to the frame.
    ///
    /// Occluded time is not free. A track with the maximum coast time lasts until the forecast's horizon. A
    /// track with little earned coast time, such as a false track behind a lorry, lasts hardly longer than in
    /// view.
    pub fn miss(&mut self, visibility: f64, dt_ns: u64, input: &InputModel, options: &TrackerOptions) {
        self.count(false);
        let detectable = (visibility / VISIBILITY_TO_DETECT).min(1.0);
        let occluded_ns = ((1.0 - detectable) * dt_ns as f64) as u64;
        self.occluded_ns = self.occluded_ns.saturating_add(occluded_ns);
        let [earned_ns, coast_ns] = [self.coast_earned_ns, input.coast_ns].map(|ns| ns as f64);
        let spared_share =
            earned_ns / coast_ns.max(1.0) * (1.0 - coast_ns / options.horizon_ns.max(1) as f64);
        let spared_ns = (spared_share.clamp(0.0, 1.0) * occluded_ns as f64) as u64;
        self.coast_left_ns = self.coast_left_ns.saturating_sub_unsigned(dt_ns - spared_ns.min(dt_ns));
        let miss_probability = 1.0 - detectable * options.detection_probability;
        self.add_evidence(miss_probability.ln());
    }

    /// Whether the track is to be deleted, this long after the last hit.
    #[must_use]
    pub fn is_over(&self, unseen_ns: u64, input: &InputModel, options: &TrackerOptions) -> bool {
        let missed = !self.was_hit();
        let miss_count = u32::from(self.frames) - self.hits.count_ones();
        (!self.confirmed && miss_count >= MISSES_TO_DELETE)
            || (missed && unseen_ns.saturating_sub(self.occluded_ns) > input.coast_ns)
            || (missed && self.confirmed && !self.trusted && self.coast_left_ns < 0)
            || unseen_ns > options.horizon_ns
    }

    /// Whether enough frames have detected the agent, near enough to the prediction.
    #[must_use]
    pub const fn is_confirmed(&self) -> bool {
        self.confirmed
    }

    /// Whether the detections' identities can be trusted.
    #[must_use]
    pub const fn is_trusted(&self) -> bool {
        self.trusted
    }

    /// Whether the newest frame that observed the type was a hit.
    #[must_use]
    pub const fn was_hit(&self) -> bool {
        self.hits & 1 == 1
    }

    /// Whether existence is certain enough for confirmation.
    #[must_use]
    pub fn is_certain(&self) -> bool {
        self.existence >= EXISTENCE_TO_CONFIRM
    }

    /// Probability that the agent exists.
    #[must_use]
    pub fn existence_probability(&self) -> f64 {
        1.0 / (1.0 + (-self.existence).exp())
    }

    fn count(&mut self, hit: bool) {
        self.hits = (self.hits << 1 | u8::from(hit)) & HITS_MASK;
        self.frames = (self.frames + 1).min(HITS_MASK.count_ones() as u8);
    }

    fn add_evidence(&mut self, log_odds: f64) {
        let log_odds = log_odds.clamp(-EXISTENCE_MAX, EXISTENCE_MAX);
        self.existence = (self.existence + log_odds).clamp(-EXISTENCE_MAX, EXISTENCE_MAX);
    }
}
