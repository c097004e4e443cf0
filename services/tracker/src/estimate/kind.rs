//! The filter of an agent: its kind, and which end is the front.

use filters::{Filter, Kind, Unknown};
use wire::AgentType;

use super::Estimate;
use crate::steady::Steady;

/// Standard deviations of the quantities that the first detection does not measure, by type.
pub(super) const UNKNOWN: [Unknown; 3] = [
    Unknown { speed_mps: 10.0, slip_rad: 0.05 },
    Unknown { speed_mps: 5.0, slip_rad: 0.05 },
    Unknown { speed_mps: 2.0, slip_rad: 0.05 },
];
/// The course sets an unknown heading once its standard deviation is this small, from the speed below on.
const COURSE_SIGMA_MAX_RAD: f64 = 0.3;
const COURSE_SPEED_MIN_MPS: f64 = 0.5;

/// The filter of a type.
pub(super) const fn kind(agent_type: AgentType) -> Kind {
    match agent_type {
        AgentType::Pedestrian => Kind::ConstantVelocity,
        AgentType::Vehicle | AgentType::Cyclist => Kind::Bicycle,
    }
}

impl Estimate {
    /// Decides on the heading and the front, after an update.
    pub(super) fn resolve_front(&mut self) {
        let agent_type = self.class.current();
        if kind(agent_type) == Kind::Bicycle
            && matches!(self.belief.filter(), Filter::ConstantVelocity(_))
            && self.belief.motion().speed_mps > COURSE_SPEED_MIN_MPS
            && self.belief.filter().course_sigma_rad() < COURSE_SIGMA_MAX_RAD
        {
            self.belief.convert_to(Kind::Bicycle, &UNKNOWN[agent_type.index()]);
        }
        if let Filter::Bicycle(state) = self.belief.filter() {
            let sigma_mps = state.covariance[(3, 3)].max(0.0).sqrt();
            self.front.observe_motion(state.mean[3], sigma_mps, self.was_ready);
            if self.front.take_flip(self.was_ready) {
                self.belief.reverse();
                self.steady = Steady::new(self.belief.filter());
                self.front_ns = self.stamp_ns;
            }
        }
    }
}
