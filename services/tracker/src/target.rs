use filters::{
    Filter, FilterFault, ForecastFault, Gaussian, Kind, Models, Motion, Observation, Unknown, wrapped,
};
use thiserror::Error;
use wire::{
    AgentType, Detection, HISTORY_MAX, HistoryState, Quality, Rejected, Steering, Track, TrackStatus,
    detection_flags,
};

use crate::belief::Belief;
use crate::class::Class;
use crate::forecasts::{Controls, Forecasts};
use crate::front::Front;
use crate::history::History;
use crate::options::{InputModel, TrackerOptions};

/// What nobody has observed, by type.
const UNKNOWN: [Unknown; 3] = [
    Unknown { speed_mps: 10.0, acceleration_mps2: 3.0, turn_rate_radps: 0.3, slip_rad: 0.05 },
    Unknown { speed_mps: 5.0, acceleration_mps2: 2.0, turn_rate_radps: 0.5, slip_rad: 0.05 },
    Unknown { speed_mps: 2.0, acceleration_mps2: 1.0, turn_rate_radps: 1.0, slip_rad: 0.05 },
];
/// An unknown heading counts as told once the course is known so well, at this speed.
const COURSE_TOLD_RAD: f64 = 0.3;
const COURSE_TOLD_MPS: f64 = 0.5;
/// Slower than this, a course means nothing and the last heading holds.
const COURSE_MIN_MPS: f64 = 0.1;
/// A published heading turns no further in a frame: where the evidence turns a front round, it goes round in three.
const SHOWN_TURN_MAX_RAD: f64 = std::f64::consts::FRAC_PI_3;
/// Coasting is earned: being seen for a while lets a track go unseen for so many times as long. What clutter keeps alive is
/// seen too seldom for that.
const COAST_RATIO: u64 = 2;
/// What a detection may tell of its own noise: beyond that, variances leave the numbers of a published covariance.
const SIGMA_RANGE_M: (f64, f64) = (1e-6, 1e3);
/// Weight of a new detection's size.
const SIZE_WEIGHT: f32 = 0.2;
/// Existence is believed or doubted no further than this, so that a few frames can change it.
const EXISTENCE_MAX: f64 = 10.0;
/// Frames over which hits are counted, as a mask of the newest.
const HITS_MASK: u8 = 0b1_1111;
/// Hits among them that confirm a track.
const HITS_TO_CONFIRM: u32 = 3;
/// Misses among them after which a tentative track can't be confirmed in time.
const MISSES_TO_END: u32 = 3;

/// How well a detection fits a predicted track, by its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Mahalanobis distance, squared.
    pub distance2: f64,
    /// Logarithm of the determinant of the innovation's covariance.
    pub log_det: f64,
}

/// Why a forecast could not become a target's prior.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PriorFault {
    /// Its numbers can't be.
    #[error(transparent)]
    Rejected(#[from] Rejected),
    /// The filter can't take it.
    #[error(transparent)]
    Forecast(#[from] ForecastFault),
}

/// An agent that the tracker follows, from its first detection on.
#[derive(Clone, Debug)]
pub struct Target {
    /// The track's identity.
    pub id: u64,
    /// The newest detection's own identity, 0 where it carries none.
    pub source_id: u64,
    /// Its type.
    pub class: Class,
    /// Its motion at `stamp_ns`.
    pub belief: Belief,
    born_ns: i64,
    stamp_ns: i64,
    seen_ns: i64,
    /// Stamp of the controls of the forecast that was taken last.
    controls_ns: Option<i64>,
    /// Forecasts of earlier stamps tell of another front.
    front_ns: i64,
    /// Log-odds of the object's existence.
    existence: f64,
    front: Front,
    /// One bit per frame that observed the type, the newest lowest: was it detected?
    hits: u8,
    /// Frames that observed the type since birth, counted up to five.
    frames: u8,
    confirmed: bool,
    /// Whether more than a single position was observed, so that the velocity means something.
    moving: bool,
    /// Whether the track has been published.
    shown: bool,
    /// Time since the state before.
    moved_ns: u64,
    /// How much longer the track may go unseen, negative where it went unseen for longer.
    earned_ns: i64,
    /// Whether detections carry an identity that can be trusted.
    trusted: bool,
    /// Heading, held where the filter has none.
    heading_rad: f64,
    /// The heading as it was last recorded.
    shown_heading_rad: f64,
    length_m: f32,
    width_m: f32,
    history: History,
}

impl Target {
    /// The target that a detection starts; confirmed at once where the detection's identity can be trusted.
    #[must_use]
    pub fn new(
        id: u64,
        now_ns: i64,
        detection: &Detection,
        agent_type: AgentType,
        input: &InputModel,
        trusted: bool,
    ) -> Self {
        let seen = observation(detection, agent_type, input);
        let filter = Filter::start(kind(agent_type), &seen, &UNKNOWN[agent_type.index()]);
        let sized = detection.has(detection_flags::HAS_SIZE);
        let heading_rad = seen.heading_rad.map_or(0.0, |(heading, _)| heading);
        Self {
            id,
            source_id: source_id(detection),
            class: Class::new(agent_type),
            belief: Belief::new(filter),
            born_ns: now_ns,
            stamp_ns: now_ns,
            seen_ns: now_ns,
            controls_ns: None,
            front_ns: now_ns,
            existence: 0.0,
            front: Front::new(),
            hits: 1,
            frames: 1,
            confirmed: trusted,
            moving: seen.velocity_mps().is_some(),
            shown: false,
            moved_ns: 0,
            earned_ns: 0,
            trusted,
            heading_rad,
            shown_heading_rad: heading_rad,
            length_m: if sized { detection.length_m } else { 0.0 },
            width_m: if sized { detection.width_m } else { 0.0 },
            history: History::new(),
        }
    }

    /// Takes the target's own among the forecasts as its prior from now on, where one is due.
    ///
    /// One is due every Δt, so that hypotheses live long enough to be told apart, and only if it knows more than the one
    /// before: in a gap the last forecast of when the agent was seen holds.
    ///
    /// # Errors
    /// [`PriorFault`]; the target then goes on as before.
    pub fn adopt(
        &mut self,
        forecasts: &mut Forecasts<'_>,
        controls: &mut Controls,
        input: &InputModel,
    ) -> Result<(), PriorFault> {
        let Some(forecast) = forecasts.find(self.id) else { return Ok(()) };
        let steering = Steering::try_from(forecast.steering)?;
        let agent_type = self.class.current();
        let controls_ns = forecasts.controls_ns(forecast);
        let is_due = self.belief.forecast_age_ns().is_none_or(|age_ns| age_ns >= forecasts.step_ns());
        let knows_more =
            self.seen_ns == self.stamp_ns && self.controls_ns.is_none_or(|last_ns| controls_ns > last_ns);
        let fits = (self.front_ns..=self.stamp_ns).contains(&controls_ns)
            && forecast.agent_type == agent_type as u32
            && self.belief.suits(steering);
        if !(is_due && knows_more && fits) {
            return Ok(());
        }
        let trust = &input.trust;
        controls.read(forecasts, forecast, steering, trust.fade_in_s)?;
        let age_ns = self.stamp_ns.abs_diff(controls_ns);
        let prior = controls.forecast(age_ns, forecasts.step_ns(), f64::from(forecast.frame_heading_rad));
        self.belief.adopt(&prior, (&self.models(input), trust), self.id)?;
        self.controls_ns = Some(controls_ns);
        Ok(())
    }

    /// Moves the motion on to `now_ns`.
    ///
    /// # Errors
    /// [`FilterFault`]; the motion is then as before.
    pub fn predict(&mut self, now_ns: i64, input: &InputModel) -> Result<(), FilterFault> {
        let dt_ns = now_ns.saturating_sub(self.stamp_ns).max(0).unsigned_abs();
        self.stamp_ns = now_ns;
        self.moved_ns = dt_ns;
        let models = self.models(input);
        self.belief.predict(dt_ns, &models, &input.trust)
    }

    /// How well a position with the given variance per axis fits the prediction.
    #[must_use]
    pub fn fit(&self, position_m: [f64; 2], variance: f64) -> Fit {
        let ([x, y], [xx, xy, yy]) = self.belief.position();
        let (xx, yy) = (xx + variance, yy + variance);
        let (dx, dy) = (position_m[0] - x, position_m[1] - y);
        let det = xx * yy - xy * xy;
        let distance2 = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det;
        Fit { distance2, log_det: det.ln() }
    }

    /// Takes in the detection of a frame.
    ///
    /// # Errors
    /// [`FilterFault`]; the motion is then as predicted.
    pub fn update(
        &mut self,
        detection: &Detection,
        agent_type: AgentType,
        input: &InputModel,
        options: &TrackerOptions,
    ) -> Result<(), FilterFault> {
        let mut seen = observation(detection, agent_type, input);
        let fit = self.fit(seen.position_m, seen.position_variance);
        let density = (-0.5 * (fit.distance2 + fit.log_det)).exp() / std::f64::consts::TAU;
        self.believe((options.detection_probability * density / options.clutter_density).ln());
        if self.class.observe(agent_type) {
            self.belief.forget_forecast();
            if self.class.current() == AgentType::Pedestrian {
                self.belief.turn_into(Kind::ConstantVelocity, &UNKNOWN[agent_type.index()]);
            }
        }
        self.source_id = source_id(detection);
        self.resize(detection);
        self.count(true);
        let earned_ns = self.moved_ns.saturating_mul(COAST_RATIO);
        self.earned_ns = self.earned_ns.max(0).saturating_add_unsigned(earned_ns.min(input.coast_ns));
        self.earned_ns = self.earned_ns.min(input.coast_ns.cast_signed());
        self.seen_ns = self.stamp_ns;
        self.moving = true;
        if let (Filter::Bicycle(_), Some((heading, _))) = (self.belief.filter(), &mut seen.heading_rad) {
            *heading = self.front.fold(*heading, self.heading_rad);
        }
        self.belief.update(&seen, &self.models(input))?;
        self.find_front();
        Ok(())
    }

    /// Takes in that a frame which observed the target's type did not see it.
    pub fn miss(&mut self, options: &TrackerOptions) {
        self.count(false);
        self.earned_ns = self.earned_ns.saturating_sub_unsigned(self.moved_ns);
        self.believe((1.0 - options.detection_probability).ln());
    }

    /// Whether the target has come to its end.
    #[must_use]
    pub fn is_over(&self, input: &InputModel, options: &TrackerOptions) -> bool {
        let missed = self.hits & 1 == 0;
        let misses_len = u32::from(self.frames) - self.hits.count_ones();
        let unseen_ns = self.unseen_ns(self.stamp_ns);
        (!self.confirmed && misses_len >= MISSES_TO_END)
            || (missed && unseen_ns > input.coast_ns)
            || (missed && self.confirmed && !self.trusted && self.earned_ns < 0)
            || unseen_ns > options.horizon_ns
            || !self.is_possible()
    }

    /// Time since the last detection.
    #[must_use]
    pub fn unseen_ns(&self, now_ns: i64) -> u64 {
        now_ns.saturating_sub(self.seen_ns).max(0).unsigned_abs()
    }

    /// Time between the last detection and the state, in seconds.
    #[must_use]
    pub fn since_seen_s(&self) -> f64 {
        self.unseen_ns(self.stamp_ns) as f64 / 1e9
    }

    /// Whether the target is fit to be published: confirmed, with a velocity that means something.
    #[must_use]
    pub const fn is_ready(&self) -> bool {
        self.confirmed && self.moving
    }

    /// Keeps the state of now for the window, so that it can be published.
    pub fn record(&mut self) {
        let motion = self.belief.motion();
        self.heading_rad = self.heading(&motion);
        let turn_rad = wrapped(self.heading_rad - self.shown_heading_rad);
        self.shown_heading_rad = if self.shown && turn_rad.abs() > SHOWN_TURN_MAX_RAD {
            // Forecasts that start from a heading under way do not fit the state.
            self.front_ns = self.stamp_ns.saturating_add(1);
            wrapped(self.shown_heading_rad + SHOWN_TURN_MAX_RAD.copysign(turn_rad))
        } else {
            self.heading_rad
        };
        let state = HistoryState {
            x_m: motion.position_m[0] as f32,
            y_m: motion.position_m[1] as f32,
            vx_mps: motion.velocity_mps[0] as f32,
            vy_mps: motion.velocity_mps[1] as f32,
            heading_rad: self.shown_heading_rad as f32,
            present: 1,
        };
        if self.is_ready() && !self.shown {
            self.shown = true;
            self.history.backfill(&state);
        }
        // Before the first publication only what was detected counts: predictions without a velocity stand still.
        if self.shown || self.seen_ns == self.stamp_ns {
            self.history.push(self.stamp_ns, state);
        }
    }

    /// The track as it is published; the state of now must have been recorded.
    pub fn publish(&self, options: &TrackerOptions) -> Track {
        let motion = self.belief.motion();
        let mut history = [HistoryState::default(); HISTORY_MAX];
        let window = &mut history[..options.history_len];
        self.history.window(self.stamp_ns, options.step_ns, options.gap_max_ns, window);
        let present_len: u32 = window.iter().map(|state| state.present).sum();
        let age_ns = self.stamp_ns.saturating_sub(self.born_ns).unsigned_abs();
        let status = if self.hits & 1 == 1 { TrackStatus::Confirmed } else { TrackStatus::Coasting };
        let prior_age_ns = self.belief.forecast_age_ns();
        // By its age when it began to move the state here.
        let prior = match prior_age_ns.map(|age_ns| age_ns.saturating_sub(self.moved_ns)) {
            None => Quality::Kinematic,
            Some(age_ns) if age_ns < options.step_ns => Quality::Learned,
            Some(_) => Quality::Held,
        };
        let (state_len, covariance) = match self.belief.filter() {
            Filter::Bicycle(state) => (5, row_major(state)),
            other => (4, row_major(&other.cartesian())),
        };
        Track {
            id: self.id,
            source_id: self.source_id,
            born_ns: self.born_ns,
            unseen_ns: self.unseen_ns(self.stamp_ns),
            agent_type: self.class.current() as u32,
            status: status as u32,
            state_len,
            forecastable: u32::from(present_len >= 2 && age_ns >= options.step_ns),
            x_m: motion.position_m[0] as f32,
            y_m: motion.position_m[1] as f32,
            heading_rad: self.shown_heading_rad as f32,
            speed_mps: motion.speed_mps as f32,
            slip_rad: motion.slip_rad as f32,
            vx_mps: motion.velocity_mps[0] as f32,
            vy_mps: motion.velocity_mps[1] as f32,
            length_m: self.length_m,
            width_m: self.width_m,
            existence: (1.0 / (1.0 + (-self.existence).exp())) as f32,
            type_probability: self.class.probability().map(|p| p as f32),
            covariance,
            history,
            prior: prior as u32,
            reserved: 0,
            prior_age_ns: prior_age_ns.unwrap_or(0),
            prior_weights: self.belief.weights(),
            reserved_end: [0; 5],
        }
    }

    /// Finds out which end is in front and the heading, after an update.
    fn find_front(&mut self) {
        let agent_type = self.class.current();
        if kind(agent_type) == Kind::Bicycle
            && matches!(self.belief.filter(), Filter::ConstantVelocity(_))
            && self.belief.motion().speed_mps > COURSE_TOLD_MPS
            && self.belief.filter().course_sigma_rad() < COURSE_TOLD_RAD
        {
            self.belief.turn_into(Kind::Bicycle, &UNKNOWN[agent_type.index()]);
        }
        if let Filter::Bicycle(state) = self.belief.filter() {
            let sigma_mps = state.covariance[(3, 3)].max(0.0).sqrt();
            self.front.moved(state.mean[3], sigma_mps, self.shown);
            if self.front.take_turn(self.shown) {
                self.belief.turn_round();
                self.front_ns = self.stamp_ns;
            }
        }
        self.heading_rad = self.heading(&self.belief.motion());
    }

    fn models(&self, input: &InputModel) -> Models {
        input.models(self.class.current(), f64::from(self.length_m))
    }

    fn heading(&self, motion: &Motion) -> f64 {
        let [vx, vy] = motion.velocity_mps;
        match motion.heading_rad {
            Some(heading) => heading,
            None if motion.speed_mps >= COURSE_MIN_MPS => vy.atan2(vx),
            None => self.heading_rad,
        }
    }

    fn count(&mut self, hit: bool) {
        self.hits = (self.hits << 1 | u8::from(hit)) & HITS_MASK;
        self.frames = (self.frames + 1).min(HITS_MASK.count_ones() as u8);
        self.confirmed |= self.hits.count_ones() >= HITS_TO_CONFIRM;
    }

    fn believe(&mut self, log_odds: f64) {
        // A density that underflows says "no" as loudly as it can, not "nobody knows".
        let log_odds = log_odds.clamp(-EXISTENCE_MAX, EXISTENCE_MAX);
        self.existence = (self.existence + log_odds).clamp(-EXISTENCE_MAX, EXISTENCE_MAX);
    }

    fn resize(&mut self, detection: &Detection) {
        if detection.has(detection_flags::HAS_SIZE) {
            let smooth = |old: f32, new: f32| if old == 0.0 { new } else { old + SIZE_WEIGHT * (new - old) };
            self.length_m = smooth(self.length_m, detection.length_m);
            self.width_m = smooth(self.width_m, detection.width_m);
        }
    }

    fn is_possible(&self) -> bool {
        let motion = self.belief.motion();
        motion.position_m.iter().all(|x| x.abs() <= f64::from(wire::POSITION_MAX_M))
            && motion.speed_mps.abs() <= f64::from(wire::SPEED_MAX_MPS)
    }
}

/// How agents of a type move.
const fn kind(agent_type: AgentType) -> Kind {
    match agent_type {
        AgentType::Pedestrian => Kind::ConstantVelocity,
        AgentType::Vehicle | AgentType::Cyclist => Kind::Bicycle,
    }
}

fn source_id(detection: &Detection) -> u64 {
    if detection.has(detection_flags::HAS_ID) { detection.id } else { 0 }
}

/// What a detection tells, with the noise of its type where it tells none itself.
fn observation(detection: &Detection, agent_type: AgentType, input: &InputModel) -> Observation {
    let noise = &input.sensor[agent_type.index()];
    let value = |flag, value: f32, sigma: f64| detection.has(flag).then(|| (f64::from(value), sigma.powi(2)));
    Observation {
        position_m: [f64::from(detection.x_m), f64::from(detection.y_m)],
        position_variance: position_sigma_m(detection, agent_type, input).powi(2),
        heading_rad: value(detection_flags::HAS_HEADING, detection.heading_rad, noise.heading_rad),
        speed_mps: value(detection_flags::HAS_SPEED, detection.speed_mps, noise.speed_mps),
    }
}

/// Standard deviation of a detection's position per axis.
#[must_use]
pub fn position_sigma_m(detection: &Detection, agent_type: AgentType, input: &InputModel) -> f64 {
    match detection.sigma_m {
        sigma_m if sigma_m > 0.0 => f64::from(sigma_m).clamp(SIGMA_RANGE_M.0, SIGMA_RANGE_M.1),
        _ => input.sensor[agent_type.index()].position_m,
    }
}

fn row_major<const N: usize>(state: &Gaussian<N>) -> [f32; 25] {
    let mut numbers = [0.0; 25];
    for (number, value) in numbers.iter_mut().zip(state.covariance.transpose().iter()) {
        *number = *value as f32;
    }
    numbers
}
