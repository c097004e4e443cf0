mod chord;
mod gate;
mod held;
mod judgement;
mod kind;
mod published;
mod reports;
mod resent;
mod size;
mod track;
mod visibility;
mod whole;
mod written;

pub use gate::Verdict;
pub use whole::{LONG_M, length_m};

use std::f64::consts::FRAC_PI_2;

use filters::{Filter, FilterFault, Kind, Models, Motion, Observation, wrapped};
use run::SpeedLimits;
use wire::{AgentType, Forecast, Steering};

use crate::belief::Belief;
use crate::class::Class;
use crate::estimate::chord::Chord;
use crate::estimate::gate::Gate;
use crate::estimate::held::Held;
use crate::estimate::kind::{UNKNOWN, kind};
use crate::estimate::published::Published;
use crate::estimate::reports::Reports;
use crate::estimate::size::Size;
use crate::estimate::whole::Whole;
use crate::forecasts::{Controls, Forecasts};
use crate::front::{Front, folded, rate_limited_rad};
use crate::noise::{Measurements, Noise, SensorWindows};
use crate::observation::{Found, nominal_sigma_m, observation, source_id};
use crate::options::{ForecastTrust, InputModel, TrackerOptions};
use crate::smoothing::Spread;
use crate::steady::Steady;
use crate::track_management::TrackManagement;
use crate::trials::{PART_NS, Shown, Trials};

/// Age from which a track without a trusted identity shows the noise of its detections.
const TEACHES_FROM_NS: i64 = 2_000_000_000;

/// The detection that started an estimate. It identifies an agent independent of the order in which frames
/// arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Birth {
    /// Stamp of the detection's frame.
    pub stamp_ns: i64,
    /// Index of the detection in the frame.
    pub detection: u32,
}

/// The belief about an agent at the stamp of a frame.
///
/// It depends only on the frames up to this frame and the forecasts that came with them, in the order of
/// their stamps. A replay therefore reproduces it.
#[derive(Debug)]
pub struct Estimate {
    /// The type.
    pub class: Class,
    /// The free motion at `stamp_ns`.
    pub belief: Belief,
    /// The steady motion at `stamp_ns`.
    steady: Steady,
    /// The newest measurements, from which the noise is learned.
    measurements: Measurements,
    /// Deviation of the newest measurement's position for which the noise is learned as a factor.
    nominal_m: f64,
    birth: Birth,
    /// The newest detection's own identity; 0 if it has none.
    source_id: u64,
    /// Seed of the belief's random numbers.
    seed: u64,
    stamp_ns: i64,
    /// Stamp of the current frame. While the frame is processed, `stamp_ns` may be before it.
    frame_ns: i64,
    seen_ns: i64,
    /// Stamp of the controls of the newest adopted forecast.
    controls_ns: Option<i64>,
    /// Forecasts with earlier stamps are relative to the other front.
    front_ns: i64,
    management: TrackManagement,
    front: Front,
    /// Whether more than a single position was observed, so that the velocity is meaningful.
    has_velocity: bool,
    /// Whether it was ready in an earlier frame and is therefore published.
    was_ready: bool,
    /// Time from the previous state to this one.
    dt_ns: u64,
    /// Share of the agent that is visible in the current frame; 1 if occlusion is not computed.
    visibility: f64,
    /// The state to publish at the end of the frame.
    published: Published,
    held: Held,
    size: Size,
    whole: Whole,
    /// The agent's trials of its forecasts.
    trials: Trials,
    /// The reports of its detections.
    reports: Reports,
    /// Whether its positions confirm the reports.
    chord: Chord,
    gate: Gate,
    /// Whether another estimate continues its identity.
    is_replaced: bool,
}

impl Estimate {
    /// The estimate that a detection starts. It is confirmed immediately if the detection's identity can be
    /// trusted.
    #[must_use]
    pub fn new((birth, seed): (Birth, u64), found: &Found<'_>, input: &InputModel, trusted: bool) -> Self {
        let &Found { detection, agent_type, own_ns } = found;
        let seen = observation(detection, agent_type, input);
        let belief = Belief::new(Filter::start(kind(agent_type), &seen, &UNKNOWN[agent_type.index()]));
        Self {
            chord: Chord::new(own_ns, &seen),
            class: Class::new(agent_type),
            birth,
            source_id: source_id(detection),
            seed,
            stamp_ns: own_ns,
            frame_ns: birth.stamp_ns,
            seen_ns: birth.stamp_ns,
            controls_ns: None,
            front_ns: birth.stamp_ns,
            management: TrackManagement::new(trusted),
            front: Front::new(),
            has_velocity: seen.velocity_mps().is_some(),
            was_ready: false,
            dt_ns: 0,
            visibility: 1.0,
            published: Published::new(
                belief.filter(),
                seen.heading_rad.map_or(0.0, |(heading, _)| heading),
                0.0,
            ),
            held: Held::new(belief.motion(), own_ns),
            size: Size::of_detection(detection),
            whole: Whole::new(length_m(detection)),
            trials: Trials::default(),
            reports: Reports::new(found),
            gate: Gate::new(own_ns),
            is_replaced: false,
            steady: Steady::new(belief.filter()),
            measurements: Measurements::default(),
            nominal_m: 0.0,
            belief,
        }
    }

    /// Adopts the agent's own forecast as the prior from now on, if a forecast is due. Returns `false` if the
    /// forecast's numbers are impossible; the estimate is then unchanged.
    ///
    /// A forecast is due every Δt, so that measurements have time to weigh the hypotheses. It must also be
    /// based on a newer detection than the previous forecast. Through a gap the last forecast from before the
    /// gap therefore stays in force.
    pub fn adopt(
        &mut self,
        (forecasts, forecast): (&Forecasts<'_>, &Forecast),
        controls: &mut Controls,
        input: &InputModel,
        shown: &[Shown; 3],
    ) -> bool {
        let Ok(steering) = Steering::try_from(forecast.steering) else { return false };
        let agent_type = self.class.current();
        let controls_ns = forecasts.controls_ns(forecast);
        let is_due = self.belief.forecast_age_ns().is_none_or(|age_ns| age_ns >= forecasts.step_ns());
        let is_newer = self.is_seen() && self.controls_ns.is_none_or(|last_ns| controls_ns > last_ns);
        let turn_rad = wrapped(f64::from(forecast.frame_heading_rad) - self.published.heading_rad);
        let fits = (self.front_ns..=self.stamp_ns).contains(&controls_ns)
            && forecast.agent_type == agent_type as u32
            && self.belief.accepts(steering)
            // The forecast may be relative to a front that an out-of-sequence frame has since shown to be the
            // rear.
            && (steering != Steering::Bicycle || turn_rad.abs() <= FRAC_PI_2);
        if !(is_due && is_newer && fits) {
            return true;
        }
        let least = input.trust[agent_type.index()].kinematic_weight;
        let kinematic_weight = self.trials.kinematic_weight(&shown[agent_type.index()], agent_type, least);
        let trust = &ForecastTrust { kinematic_weight, ..input.trust[agent_type.index()] };
        let fade_in_s = match steering {
            Steering::Bicycle => trust.control_fade_in_s,
            Steering::None | Steering::Displacement => trust.displacement_fade_in_s,
        };
        if controls.read(forecasts, forecast, steering, fade_in_s).is_err() {
            return false;
        }
        let age_ns = self.stamp_ns.abs_diff(controls_ns);
        let prior = controls.forecast(age_ns, forecasts.step_ns(), f64::from(forecast.frame_heading_rad));
        let adopted = self.belief.adopt(&prior, (&self.models(input), trust), self.seed).is_ok();
        if adopted {
            self.controls_ns = Some(controls_ns);
            if let Some(ahead) = self.belief.ahead(PART_NS) {
                self.trials.begin(self.stamp_ns, ahead);
            }
        }
        adopted
    }

    /// Compares a detection with the agent's forecasts, before the detection updates the estimate.
    pub fn mature(&mut self, found: &Found<'_>) -> impl Iterator<Item = Shown> {
        let velocity_mps = self.belief.motion().velocity_mps;
        self.trials.mature(found.own_ns, found.position_m(), velocity_mps)
    }

    /// Begins a frame, before the motion is predicted to the frame.
    pub const fn begin_frame(&mut self, frame_ns: i64) {
        self.frame_ns = frame_ns;
        self.dt_ns = if frame_ns > self.stamp_ns { frame_ns.abs_diff(self.stamp_ns) } else { 0 };
        self.visibility = 1.0;
    }

    /// Predicts the motion at a later time, at most the time of the frame.
    ///
    /// # Errors
    /// [`FilterFault`]; the motion is then unchanged.
    pub fn predict(&mut self, to_ns: i64, input: &InputModel) -> Result<(), FilterFault> {
        let to_ns = to_ns.min(self.frame_ns);
        if to_ns <= self.stamp_ns {
            return Ok(());
        }
        let dt_ns = to_ns.abs_diff(self.stamp_ns);
        self.stamp_ns = to_ns;
        let models = self.models(input);
        // A failure leaves the steady motion unchanged, and its likelihood then shows that it is wrong.
        let _ = self.steady.predict(self.belief.filter(), dt_ns, &models.steady());
        self.belief.predict(dt_ns, &models, &input.trust[self.class.current().index()])
    }

    /// Predicts the motion of a new estimate to the stamp of its frame. The stamp may be before the
    /// detection's own time.
    ///
    /// # Errors
    /// [`FilterFault`]; the motion is then unchanged.
    pub fn predict_first(&mut self, input: &InputModel) -> Result<(), FilterFault> {
        if self.stamp_ns > self.frame_ns {
            let models = self.models(input);
            let lag_s = self.lag_s(self.frame_ns);
            self.belief.shift(lag_s, &models);
            self.steady.shift(lag_s, &models);
            self.stamp_ns = self.frame_ns;
        }
        self.predict(self.frame_ns, input)
    }

    /// Updates the estimate by a detection in a frame, at the detection's own time. All `possible`
    /// observations correct the motion. At most one of them is an observation of the agent; each comes with
    /// the probability that it is.
    ///
    /// # Errors
    /// [`FilterFault`]; the motion is then as predicted.
    pub fn update(
        &mut self,
        found: &Found<'_>,
        possible: &mut [(f64, Observation)],
        input: &InputModel,
        options: &TrackerOptions,
    ) -> Result<(), FilterFault> {
        let &Found { detection, agent_type, own_ns } = found;
        let seen = observation(detection, agent_type, input);
        if !self.is_hit() {
            let variance = nominal_sigma_m(detection, agent_type, options).powi(2);
            let log_density = self.fit(found, variance, input).log_density();
            self.management.hit(log_density, self.dt_ns, input, options);
        }
        self.settle_gate(found, &seen, input);
        if self.class.observe(agent_type) {
            self.belief.drop_forecast();
            if self.class.current() == AgentType::Pedestrian {
                self.belief.convert_to(Kind::ConstantVelocity, &UNKNOWN[agent_type.index()]);
            }
        }
        self.source_id = source_id(detection);
        self.reports.add(found);
        self.nominal_m = nominal_sigma_m(detection, agent_type, options);
        let weight = input.by_sensor.weight(agent_type, detection.sensor);
        self.measurements.add(found, self.nominal_m, weight);
        self.size.add(detection);
        self.seen_ns = self.frame_ns;
        self.held.end();
        self.has_velocity = true;
        let believed = self.chord.ignored.without(seen);
        if let (Filter::Bicycle(_), Some((heading, _))) = (self.belief.filter(), believed.heading_rad) {
            self.front.observe_heading(heading, self.published.heading_rad);
        }
        if !self.confirm(own_ns, &seen, input) {
            self.correct(possible, self.lag_s(own_ns), input)?;
        }
        self.count_length(length_m(detection));
        self.resolve_front();
        Ok(())
    }

    /// Counts a miss by a frame that observed the agent's type. If some observations were `possible`
    /// nevertheless, they correct the motion.
    ///
    /// # Errors
    /// [`FilterFault`]; the motion is then as predicted.
    pub fn miss(
        &mut self,
        possible: &mut [(f64, Observation)],
        input: &InputModel,
        options: &TrackerOptions,
    ) -> Result<(), FilterFault> {
        self.held.end();
        self.management.miss(self.visibility, self.dt_ns, input, options);
        self.correct(possible, 0.0, input)
    }

    fn correct(
        &mut self,
        possible: &mut [(f64, Observation)],
        lag_s: f64,
        input: &InputModel,
    ) -> Result<(), FilterFault> {
        let ignored = self.chord.ignored;
        let is_bicycle = matches!(self.belief.filter(), Filter::Bicycle(_));
        for (_, seen) in possible.iter_mut() {
            *seen = ignored.without(*seen);
            if let Some((heading, _)) = seen.heading_rad.as_mut().filter(|_| is_bicycle) {
                *heading = folded(*heading, self.published.heading_rad);
            }
        }
        let models = self.models(input);
        self.steady.follow_kind(self.belief.filter());
        // A failure leaves the steady motion unchanged.
        let _ = self.steady.update_at(lag_s, self.belief.filter(), possible, &models);
        self.belief.update_at(lag_s, possible, &models)
    }

    /// Passes what the newest measurement shows of the noise to the noise of the type. Tracks that clutter
    /// started would show noise; few of them become old.
    pub fn teach(&mut self, noise: &mut Noise, input: &InputModel) {
        if self.may_teach() {
            let line_of_sight_m = input.by_view.line_of_sight_m(self.published.motion.position_m);
            let of_type = self.class.current().index();
            noise.learn(of_type, &mut self.measurements, self.nominal_m, line_of_sight_m);
        }
    }

    /// Passes a measurement to the noise of its sensor, after the measurement has updated the estimate.
    pub fn teach_sensor(
        &self,
        found: &Found<'_>,
        (noise, windows): (&mut Noise, &mut SensorWindows),
        options: &TrackerOptions,
    ) {
        if self.may_teach() {
            let nominal_m = nominal_sigma_m(found.detection, found.agent_type, options);
            noise.learn_sensor((self.class.current().index(), self.seed), windows, found, nominal_m);
        }
    }

    fn may_teach(&self) -> bool {
        let age_ns = self.stamp_ns.saturating_sub(self.birth.stamp_ns);
        self.is_ready() && (self.management.is_trusted() || age_ns >= TEACHES_FROM_NS)
    }

    /// Ends a frame. Computes the motion and heading to publish, within the limits of the type.
    pub fn end_frame(&mut self, input: &InputModel, limits: &SpeedLimits) {
        let limit_mps = limits.of(self.class.current());
        self.belief.limit_speed(limit_mps);
        self.steady.follow_kind(self.belief.filter());
        let share = input.steadiness[self.class.current().index()];
        let models = self.models(input);
        let published = &mut self.published;
        published.is_standing = share > 0.0 && self.steady.stands();
        published.state = limited(self.steady.published(self.belief.filter(), share), limit_mps);
        published.motion = self.held.motion(published.state.motion(), self.stamp_ns);
        let density = self.steady.density(&models, share);
        published.spread = Spread::new(&published.state, models.bicycle.rear_axle_m, density, share);
        published.heading_rad = published.heading();
        let last_rad = published.limited_rad;
        let limited_rad =
            if self.was_ready { rate_limited_rad(last_rad, published.heading_rad) } else { None };
        published.limited_rad = limited_rad.unwrap_or(published.heading_rad);
        if limited_rad.is_some() {
            // Forecasts relative to a heading that still turns do not fit the state.
            self.front_ns = self.stamp_ns.saturating_add(1);
        }
        self.was_ready |= self.is_ready();
    }

    /// Whether the estimate is to be deleted at the end of a frame.
    #[must_use]
    pub fn is_over(&self, input: &InputModel, options: &TrackerOptions) -> bool {
        self.is_replaced
            || self.management.is_over(self.unseen_ns(self.stamp_ns), input, options)
            || !self.published.is_within_limits()
    }

    /// The detection that started the estimate.
    #[must_use]
    pub const fn birth(&self) -> Birth {
        self.birth
    }

    /// The newest detection's own identity; 0 if it has none.
    #[must_use]
    pub const fn source_id(&self) -> u64 {
        self.source_id
    }

    /// The time of the estimate.
    #[must_use]
    pub const fn stamp_ns(&self) -> i64 {
        self.stamp_ns
    }

    /// The motion at the end of the frame.
    #[must_use]
    pub const fn motion(&self) -> &Motion {
        &self.published.motion
    }

    /// How later frames smooth the published state.
    #[must_use]
    pub const fn spread(&self) -> &Spread {
        &self.published.spread
    }

    /// Heading. It is held if the motion has none.
    #[must_use]
    pub const fn heading_rad(&self) -> f64 {
        self.published.heading_rad
    }

    /// Whether the current frame has detected the agent so far.
    #[must_use]
    pub const fn is_hit(&self) -> bool {
        self.seen_ns == self.frame_ns
    }

    /// Whether the last frame detected the agent.
    #[must_use]
    pub const fn is_seen(&self) -> bool {
        self.seen_ns == self.stamp_ns
    }

    /// Time since the last detection.
    #[must_use]
    pub fn unseen_ns(&self, now_ns: i64) -> u64 {
        now_ns.saturating_sub(self.seen_ns).max(0).unsigned_abs()
    }

    /// Whether the estimate can be published: it is confirmed and its velocity is meaningful.
    #[must_use]
    pub const fn is_ready(&self) -> bool {
        self.management.is_confirmed() && self.has_velocity
    }

    fn models(&self, input: &InputModel) -> Models {
        input.models(self.class.current(), f64::from(self.size.length_m))
    }
}

impl Clone for Estimate {
    fn clone(&self) -> Self {
        Self { belief: self.belief.clone(), ..*self }
    }

    /// Reuses the memory of the hypotheses.
    fn clone_from(&mut self, source: &Self) {
        let mut belief = std::mem::replace(&mut self.belief, Belief::new(*source.belief.filter()));
        belief.clone_from(&source.belief);
        *self = Self { belief, ..*source };
    }
}

/// The state with at most this speed, a little below it so that coarser numbers in a payload do not exceed it.
fn limited(state: Filter, most_mps: f64) -> Filter {
    let speed_mps = state.motion().speed_mps.abs();
    if speed_mps > most_mps { state.slowed(most_mps / speed_mps * (1.0 - 1e-6)) } else { state }
}
