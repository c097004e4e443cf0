use crate::options::{InputModel, TrackerOptions};

/// Coasting is earned: being seen for a while lets a track go unseen for so many times as long. What clutter keeps alive is
/// seen too seldom for that.
const COAST_RATIO: u64 = 2;
/// An agent of whom so much can be seen is detected as well as in full view. Chosen on KITTI, where tracks that are half hidden and not
/// seen mostly have no agent.
const SHARE_TO_DETECT: f64 = 0.5;
/// Existence is believed or doubted no further than this, so that a few frames can change it.
const EXISTENCE_MAX: f64 = 10.0;
/// Log-odds of one in a hundred: so many of the detections that no track explains are agents, the others clutter.
const EXISTENCE_AT_BIRTH: f64 = -4.6;
/// Log-odds of 99 %, from which on a track is certain and may be confirmed.
const EXISTENCE_TO_CONFIRM: f64 = 4.6;
/// Frames over which hits are counted, as a mask of the newest.
const HITS_MASK: u8 = 0b1_1111;
/// Hits among them that a confirmed track has had.
const HITS_TO_CONFIRM: u32 = 3;
/// Misses among them after which a tentative track can't be confirmed in time.
const MISSES_TO_END: u32 = 3;

/// Whether there is an agent at all, and for how long it may go unseen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Life {
    /// Log-odds of the object's existence.
    existence: f64,
    /// One bit per frame that observed the type, the newest lowest: was it detected?
    hits: u8,
    /// Frames that observed the type since birth, counted up to five.
    frames: u8,
    confirmed: bool,
    /// Whether detections carry an identity that can be trusted.
    trusted: bool,
    /// How much longer the track may go unseen, negative where it went unseen for longer.
    earned_ns: i64,
    /// How much longer that was at the last detection.
    saved_ns: u64,
    /// For so long since the last detection nobody could have seen the agent.
    hidden_ns: u64,
}

impl Life {
    /// The life after the first detection; confirmed at once where the detection's identity can be trusted.
    #[must_use]
    pub const fn new(trusted: bool) -> Self {
        let existence = if trusted { 0.0 } else { EXISTENCE_AT_BIRTH };
        Self {
            existence,
            hits: 1,
            frames: 1,
            confirmed: trusted,
            trusted,
            earned_ns: 0,
            saved_ns: 0,
            hidden_ns: 0,
        }
    }

    /// Takes in a detection of that log-density under the prediction, `moved_ns` after the state before.
    pub fn see(&mut self, log_density: f64, moved_ns: u64, input: &InputModel, options: &TrackerOptions) {
        self.believe((options.detection_probability / options.clutter_density).ln() + log_density);
        self.count(true);
        self.confirmed |= self.hits.count_ones() >= HITS_TO_CONFIRM && self.is_certain();
        let earned_ns = moved_ns.saturating_mul(COAST_RATIO);
        self.earned_ns = self.earned_ns.max(0).saturating_add_unsigned(earned_ns.min(input.coast_ns));
        self.earned_ns = self.earned_ns.min(input.coast_ns.cast_signed());
        self.saved_ns = self.earned_ns.unsigned_abs();
        self.hidden_ns = 0;
    }

    /// Takes in that a frame did not see the agent, of which it could have seen that share, `moved_ns` after the state before.
    ///
    /// Hidden time is not free: who has earned all that one can lasts to the forecast's horizon on it, who has earned little, as a
    /// ghost behind a lorry, hardly longer than in view.
    pub fn miss(&mut self, visible_share: f64, moved_ns: u64, input: &InputModel, options: &TrackerOptions) {
        self.count(false);
        let detectable = (visible_share / SHARE_TO_DETECT).min(1.0);
        let hidden_ns = ((1.0 - detectable) * moved_ns as f64) as u64;
        self.hidden_ns = self.hidden_ns.saturating_add(hidden_ns);
        let [saved_ns, coast_ns] = [self.saved_ns, input.coast_ns].map(|ns| ns as f64);
        let spared_share = saved_ns / coast_ns.max(1.0) * (1.0 - coast_ns / options.horizon_ns.max(1) as f64);
        let spared_ns = (spared_share.clamp(0.0, 1.0) * hidden_ns as f64) as u64;
        self.earned_ns = self.earned_ns.saturating_sub_unsigned(moved_ns - spared_ns.min(moved_ns));
        self.believe((1.0 - detectable * options.detection_probability).ln());
    }

    /// Whether it has come to its end, that long after the last detection.
    #[must_use]
    pub fn is_over(&self, unseen_ns: u64, input: &InputModel, options: &TrackerOptions) -> bool {
        let missed = !self.is_hit();
        let misses_len = u32::from(self.frames) - self.hits.count_ones();
        (!self.confirmed && misses_len >= MISSES_TO_END)
            || (missed && unseen_ns.saturating_sub(self.hidden_ns) > input.coast_ns)
            || (missed && self.confirmed && !self.trusted && self.earned_ns < 0)
            || unseen_ns > options.horizon_ns
    }

    /// Whether enough frames have seen the agent, near enough to where it was expected.
    #[must_use]
    pub const fn is_confirmed(&self) -> bool {
        self.confirmed
    }

    /// Whether the newest frame that observed the type saw it.
    #[must_use]
    pub const fn is_hit(&self) -> bool {
        self.hits & 1 == 1
    }

    /// Whether the agent is there as surely as a track must be to be confirmed.
    #[must_use]
    pub fn is_certain(&self) -> bool {
        self.existence >= EXISTENCE_TO_CONFIRM
    }

    /// Probability that the agent exists.
    #[must_use]
    pub fn probability(&self) -> f64 {
        1.0 / (1.0 + (-self.existence).exp())
    }

    fn count(&mut self, hit: bool) {
        self.hits = (self.hits << 1 | u8::from(hit)) & HITS_MASK;
        self.frames = (self.frames + 1).min(HITS_MASK.count_ones() as u8);
    }

    fn believe(&mut self, log_odds: f64) {
        let log_odds = log_odds.clamp(-EXISTENCE_MAX, EXISTENCE_MAX);
        self.existence = (self.existence + log_odds).clamp(-EXISTENCE_MAX, EXISTENCE_MAX);
    }
}
