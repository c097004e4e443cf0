//! Whether a detection can be a measurement of an agent.

use filters::Observation;
use kinematics::hypot;

use super::gate::{Misfit, SETTLED, Verdict};
use super::reports::Reported;
use super::{Birth, Estimate};
use crate::fit::Fit;
use crate::observation::{Found, observation, position_sigma_m};
use crate::options::{InputModel, TrackerOptions};
use crate::placeholders::is_marked;

/// Distance from the prediction that even the best measurement may have, by type. Annotations have errors.
const MARGIN_M: [f64; 3] = [1.5, 1.0, 0.6];
/// Highest acceleration by type, including turns.
const ACCELERATION_MAX_MPS2: [f64; 3] = [8.0; 3];
/// Highest initial speed by type, for an agent whose first position is the origin. A faster agent was never
/// at the origin.
const BEGINNING_MPS: [f64; 3] = [16.0, 8.0, 3.0];
/// Standard deviations of the prediction and of earlier residuals that the gate adds.
const SIGMAS: f64 = 4.0;
/// The 95 % gate. A measurement beyond it may belong to another agent.
const STRANGE: f64 = 6.0;
/// The 99 % gate, for measurements with another identity.
const EXCHANGED: f64 = 9.21;
/// Time after which a position is believed, if a moving agent's detections jump to it and stay there.
const STAY_MIN_NS: u64 = 500_000_000;

impl Estimate {
    /// Compares a detection that has the agent's identity with the prediction.
    #[must_use]
    pub fn judge(&self, found: &Found<'_>, input: &InputModel, options: &TrackerOptions) -> Verdict {
        let variance = position_sigma_m(found.detection, found.agent_type, input).powi(2);
        let (agent_type, since_s) = (self.class.current(), self.gate.since_measured_s(found.own_ns));
        let from_m = self.reports.last.position_m();
        let moved_m = [0, 1].map(|axis| found.position_m()[axis] - from_m[axis]);
        let distance2 = self.fit(found, variance, input).distance2;
        let reach_m = options.speed_limits.of(agent_type) * since_s;
        let is_first = self.gate.measured < SETTLED;
        let least_m = MARGIN_M[agent_type.index()] + reach_m;
        let is_near = moved_m[0] * moved_m[0] + moved_m[1] * moved_m[1] <= least_m * least_m;
        // The common case: within three standard deviations, and therefore within the wider limits below.
        if !is_first && is_near && distance2 <= STRANGE {
            return Verdict::Fits;
        }
        let moved_m = hypot(moved_m[0], moved_m[1]);
        let margin_m =
            MARGIN_M[agent_type.index()] + SIGMAS * (self.gate.residual_m2.sqrt() + variance.sqrt());
        let is_placeholder = is_first && self.meets_placeholder(found, (moved_m, distance2), since_s);
        if is_placeholder || moved_m > margin_m + reach_m {
            return Verdict::Misfit;
        }
        // The agent can be where it was before. In that case its velocity estimate is wrong.
        if is_first || moved_m <= margin_m {
            return Verdict::Fits;
        }
        let (residual_m, sigma_m) = self.residual(found, variance, input);
        let turned_m = 0.5 * ACCELERATION_MAX_MPS2[agent_type.index()] * since_s * since_s;
        if residual_m > margin_m + turned_m + SIGMAS * sigma_m {
            return Verdict::Misfit;
        }
        if distance2 > STRANGE { Verdict::Strange } else { Verdict::Fits }
    }

    /// Whether, among the first detections, one is at a marked position and another is not, and motion hardly
    /// explains the step between them.
    fn meets_placeholder(&self, found: &Found<'_>, (moved_m, distance2): (f64, f64), since_s: f64) -> bool {
        let place = match self.placeholder_at_start() {
            Some(place) if place != found.place() => place,
            None if is_marked(found.place()) && self.reports.last.place() != found.place() => {
                if self.has_velocity {
                    return distance2 > STRANGE;
                }
                found.place()
            }
            _ => return false,
        };
        let of_type = self.class.current().index();
        // The origin is an ordinary position for users who choose it.
        let is_origin = place.map(f32::from_bits) == [0.0; 2];
        let begun_m = if is_origin { BEGINNING_MPS[of_type] * since_s } else { 0.0 };
        moved_m > 0.5 * MARGIN_M[of_type] + begun_m
    }

    /// The marked position of all of the first detections, if there is one.
    #[must_use]
    pub fn placeholder_at_start(&self) -> Option<[u32; 2]> {
        self.standing_at().filter(|place| self.gate.measured < SETTLED && is_marked(*place))
    }

    /// Whether the agent can have moved from its last detection to this one.
    #[must_use]
    pub fn reaches(&self, found: &Found<'_>, options: &TrackerOptions) -> bool {
        let (from_m, reach_m) = self.reach(found.own_ns, options);
        hypot(found.position_m()[0] - from_m[0], found.position_m()[1] - from_m[1]) <= reach_m
    }

    /// The position of the last detection, and the way from there that the agent can have moved by then.
    #[must_use]
    pub fn reach(&self, own_ns: i64, options: &TrackerOptions) -> ([f64; 2], f64) {
        let agent_type = self.class.current();
        let way_m = options.speed_limits.of(agent_type) * self.gate.since_measured_s(own_ns);
        (self.reports.last.position_m(), MARGIN_M[agent_type.index()] + way_m)
    }

    /// How much better another identity's detection fits than the agent's own, as a difference of squared
    /// Mahalanobis distances. Returns `None` if the other detection does not fit at all.
    #[must_use]
    pub fn prefers(&self, other: &Found<'_>, own: &Found<'_>, input: &InputModel) -> Option<f64> {
        let distance2 = |found: &Found<'_>| {
            let variance = position_sigma_m(found.detection, found.agent_type, input).powi(2);
            self.fit(found, variance, input).distance2
        };
        let fits = other.agent_type == self.class.current() && distance2(other) <= EXCHANGED;
        fits.then(|| distance2(own) - distance2(other))
    }

    /// How well a detection's position, with this variance per axis, fits the prediction at the detection's
    /// own time.
    #[must_use]
    pub fn fit(&self, found: &Found<'_>, variance: f64, input: &InputModel) -> Fit {
        let ([x, y], covariance_m2) = self.position_at(found.own_ns, input);
        Fit::new([found.position_m()[0] - x, found.position_m()[1] - y], covariance_m2, variance)
    }

    /// The observation of a detection that may be the agent's. If the detection was made at another time than
    /// the estimate, the observation is moved by the agent's motion, with the noise of that motion.
    #[must_use]
    pub fn observe(&self, found: &Found<'_>, input: &InputModel) -> Observation {
        let mut seen = observation(found.detection, found.agent_type, input);
        if found.own_ns != self.stamp_ns {
            let lag_s = self.lag_s(found.own_ns);
            let moving = self.belief.filter().cartesian();
            for (axis, position_m) in seen.position_m.iter_mut().enumerate() {
                *position_m -= lag_s * moving.mean[2 + axis];
            }
            let velocity_variance = 0.5 * (moving.covariance[(2, 2)] + moving.covariance[(3, 3)]);
            seen.position_variance += lag_s * lag_s * velocity_variance;
        }
        seen
    }

    /// Position and covariance at a time near the estimate's time.
    #[must_use]
    pub fn position_at(&self, own_ns: i64, input: &InputModel) -> ([f64; 2], [f64; 3]) {
        if own_ns == self.stamp_ns {
            return self.belief.position();
        }
        self.belief.filter().shifted(self.lag_s(own_ns), &self.models(input)).position()
    }

    /// Time from the estimate to another time.
    pub(super) fn lag_s(&self, own_ns: i64) -> f64 {
        own_ns.saturating_sub(self.stamp_ns) as f64 / 1e9
    }

    /// Distance of a detection from the prediction, and the largest standard deviation of this distance.
    pub(super) fn residual(&self, found: &Found<'_>, variance: f64, input: &InputModel) -> (f64, f64) {
        let ([x, y], [xx, xy, yy]) = self.position_at(found.own_ns, input);
        let largest = 0.5 * (xx + yy) + (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        (hypot(found.position_m()[0] - x, found.position_m()[1] - y), (largest + variance).max(0.0).sqrt())
    }

    /// Records how far a measurement is beyond the covariance.
    pub(super) fn settle_gate(&mut self, found: &Found<'_>, seen: &Observation, input: &InputModel) {
        let (residual_m, sigma_m) = self.residual(found, seen.position_variance, input);
        self.gate.add(found.own_ns, (residual_m - 2.0 * sigma_m).max(0.0));
    }

    /// Whether an older estimate has the same position from a detection with another own time: two sensors
    /// see one agent.
    #[must_use]
    pub fn is_twin_of(&self, older: &Self) -> bool {
        let ([x, y], own_m2) = self.belief.position();
        let ([older_x, older_y], older_m2) = older.belief.position();
        let covariance_m2 = [0, 1, 2].map(|entry| own_m2[entry] + older_m2[entry]);
        // An estimate from a single position may soon be anywhere.
        self.has_velocity
            && older.has_velocity
            && self.is_hit()
            && older.is_hit()
            && self.class.current() == older.class.current()
            && self.gate.measured_ns != older.gate.measured_ns
            && Fit::new([x - older_x, y - older_y], covariance_m2, 0.0).distance2 <= EXCHANGED
    }

    /// Ends the estimate because another estimate continues its identity.
    pub const fn replace(&mut self) {
        self.is_replaced = true;
    }

    /// The position of the last consecutive misfit.
    #[must_use]
    pub fn misfit_at(&self) -> Option<[u32; 2]> {
        self.gate.misfits[1].as_ref().map(|misfit| Reported::new(&misfit.detection).place())
    }

    /// Adds a misfit. If it agrees with the previous misfits, this returns the new estimate that starts from
    /// them, and the present estimate ends.
    pub fn add_misfit(
        &mut self,
        found: &Found<'_>,
        (birth, seed): (Birth, u64),
        input: &InputModel,
        options: &TrackerOptions,
    ) -> Option<Self> {
        let [first, second] = self.gate.misfits;
        let new = Misfit::new(found);
        let is_same = |old: &Misfit| Reported::new(&old.detection) == Reported::new(&new.detection);
        let begun = match second {
            // The same misfit again does not count as a second one, unless it stays.
            Some(second) if is_same(&second) && self.moving_from().is_some() => {
                if new.own_ns.saturating_sub(second.own_ns) < STAY_MIN_NS.cast_signed() {
                    return None;
                }
                Some(self.begun_at((birth, seed), &[second, new], input, options))
            }
            Some(second)
                if self.placeholder_at_start().is_some() && self.connects(&second, &new, options) =>
            {
                Some(self.begun_at((birth, seed), &[second, new], input, options))
            }
            Some(second) if self.has_jumped(&second, &new, input) => {
                Some(self.moved_to(&new, (birth, seed), input))
            }
            Some(second) => first
                .filter(|first| self.is_handed_on([first, &second, &new], input, options))
                .map(|first| self.begun_at((birth, seed), &[first, second, new], input, options)),
            None => None,
        };
        self.gate.misfits = [second, Some(new)];
        self.is_replaced = begun.is_some();
        begun
    }

    /// Tolerance of a velocity from two misfits this far apart: its noise, and the possible acceleration
    /// between them.
    fn tolerance_mps(&self, misfit: &Misfit, dt_s: f64, input: &InputModel) -> f64 {
        let sigma_m = position_sigma_m(&misfit.detection, misfit.agent_type, input);
        let noise_m = sigma_m.max(self.gate.residual_m2.sqrt());
        let accelerated_mps = ACCELERATION_MAX_MPS2[misfit.agent_type.index()] * dt_s;
        0.5 + accelerated_mps + SIGMAS * std::f64::consts::SQRT_2 * noise_m / dt_s
    }

    /// Whether an agent can have moved from one misfit to the next.
    fn connects(&self, before: &Misfit, new: &Misfit, options: &TrackerOptions) -> bool {
        let most_mps = options.speed_limits.of(new.agent_type);
        velocity_mps(before, new).is_some_and(|([x_mps, y_mps], _)| hypot(x_mps, y_mps) <= most_mps)
    }

    /// Whether two misfits move like the track.
    fn has_jumped(&self, before: &Misfit, new: &Misfit, input: &InputModel) -> bool {
        let Some((velocity_mps, dt_s)) = velocity_mps(before, new) else { return false };
        let own_mps = self.belief.motion().velocity_mps;
        let off_mps = hypot(velocity_mps[0] - own_mps[0], velocity_mps[1] - own_mps[1]);
        self.has_velocity
            && new.agent_type == self.class.current()
            && off_mps <= self.tolerance_mps(new, dt_s, input)
    }

    /// Whether three misfits form the path of an agent of their type.
    fn is_handed_on(
        &self,
        [first, second, third]: [&Misfit; 3],
        input: &InputModel,
        options: &TrackerOptions,
    ) -> bool {
        let Some((before_mps, before_s)) = velocity_mps(first, second) else { return false };
        let Some((after_mps, after_s)) = velocity_mps(second, third) else { return false };
        let tolerance_mps = self.tolerance_mps(third, before_s.min(after_s), input);
        let most_mps = options.speed_limits.of(third.agent_type);
        [before_mps, after_mps].iter().all(|[x, y]| hypot(*x, *y) <= most_mps)
            && hypot(after_mps[0] - before_mps[0], after_mps[1] - before_mps[1]) <= 2.0 * tolerance_mps
    }

    /// The estimate with the same motion at the position of a misfit.
    fn moved_to(&self, misfit: &Misfit, birth: (Birth, u64), input: &InputModel) -> Self {
        let found = misfit.found();
        let seen = observation(found.detection, found.agent_type, input);
        let filter = self.belief.filter().moved_to(seen.position_m, seen.position_variance);
        let mut moved = Self::new(birth, &found, input, true);
        moved.belief = crate::belief::Belief::new(filter);
        (moved.class, moved.front, moved.published.heading_rad) =
            (self.class, self.front, self.published.heading_rad);
        (moved.size, moved.whole) = (self.size, self.whole);
        (moved.has_velocity, moved.gate.residual_m2) = (self.has_velocity, self.gate.residual_m2);
        moved.gate.measured = SETTLED;
        moved
    }

    /// The estimate that starts and continues with the given misfits.
    fn begun_at(
        &self,
        (birth, seed): (Birth, u64),
        misfits: &[Misfit],
        input: &InputModel,
        options: &TrackerOptions,
    ) -> Self {
        let mut begun: Option<Self> = None;
        for misfit in misfits {
            let found = misfit.found();
            let Some(begun) = &mut begun else {
                begun = Some(Self::new((birth, seed), &found, input, true));
                continue;
            };
            let seen = observation(found.detection, found.agent_type, input);
            // A failure leaves the state unchanged, and the next measurement corrects it.
            let _ = begun.predict(found.own_ns, input);
            let _ = begun.update(&found, &mut [(1.0, seen)], input, options);
        }
        begun.unwrap_or_else(|| self.clone())
    }
}

/// The velocity between two misfits, and the time between them; `None` if no time has passed.
fn velocity_mps(before: &Misfit, after: &Misfit) -> Option<([f64; 2], f64)> {
    let dt_s = after.own_ns.saturating_sub(before.own_ns) as f64 / 1e9;
    let ([x, y], [from_x, from_y]) = (after.found().position_m(), before.found().position_m());
    (dt_s > 0.0).then(|| ([(x - from_x) / dt_s, (y - from_y) / dt_s], dt_s))
}
