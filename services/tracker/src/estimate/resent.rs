//! Detections that the detector sent again.

use super::Estimate;
use super::reports::Reported;
use crate::observation::Found;

/// Slower agents may be measured at the same position again.
const MOVING_MIN_MPS: f64 = 0.3;

impl Estimate {
    /// Holds the mean turn until the next measurement, because the detection was sent again.
    pub const fn hold_turn(&mut self) {
        self.held.is_held = true;
    }

    /// Whether a detection repeats the last one although the agent moves.
    #[must_use]
    pub fn is_resent(&self, found: &Found<'_>) -> bool {
        if Reported::new(found.detection) != self.reports.last {
            return false;
        }
        let own_mps = self.has_velocity.then(|| self.belief.motion().speed_mps.abs());
        let speed_mps = match (own_mps, found.speed_mps()) {
            (Some(own_mps), Some(reported_mps)) => Some(own_mps.max(reported_mps)),
            (own_mps, reported_mps) => own_mps.or(reported_mps),
        };
        self.reports.is_resent(found.own_ns, self.class.current(), speed_mps)
    }

    /// The bits of the last reported position, if the agent may move or its next measurement is not due yet.
    #[must_use]
    pub fn resent_from(&self) -> Option<[u32; 2]> {
        let age_ns = self.stamp_ns.saturating_sub(self.reports.fresh_ns).max(0).unsigned_abs();
        let early = self.reports.is_early(age_ns).then(|| self.reports.last.place());
        early.or_else(|| self.moving_from())
    }

    /// The bits of the last reported position, if the agent may move.
    #[must_use]
    pub fn moving_from(&self) -> Option<[u32; 2]> {
        let is_moving = !self.has_velocity || self.belief.motion().speed_mps.abs() > MOVING_MIN_MPS;
        is_moving.then(|| self.reports.last.place())
    }

    /// The bits of the agent's only position, if all its detections have the same one.
    #[must_use]
    pub fn standing_at(&self) -> Option<[u32; 2]> {
        self.reports.stands.then(|| self.reports.last.place())
    }
}
