//! Physical limits of motion: a forecast beyond them is impossible, not just unlikely.

use scene::{AgentType, State};

use crate::Point;
use crate::steering::{BicycleLimits, Steering};

/// The limits of an agent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limits {
    /// A kinematic bicycle: it moves along its heading, up to its slip.
    Bicycle(BicycleLimits),
    /// A point, which can accelerate in any direction.
    Point(PointLimits),
}

/// The limits of cyclists and pedestrians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointLimits {
    /// Largest speed.
    pub speed_mps: f32,
    /// Largest change of the velocity per second.
    pub acceleration_mps2: f32,
    /// Smallest radius of a curve; 0 if the agent can turn on the spot.
    pub turn_radius_m: f32,
}

impl Limits {
    /// The limits of an agent type. A vehicle has the limits of a very short one, which turns most tightly.
    #[must_use]
    pub const fn of(agent_type: AgentType) -> Self {
        match agent_type {
            AgentType::Vehicle => Self::vehicle(0.65),
            AgentType::Cyclist => {
                Self::Point(PointLimits { speed_mps: 25.0, acceleration_mps2: 8.0, turn_radius_m: 1.0 })
            }
            AgentType::Pedestrian => {
                Self::Point(PointLimits { speed_mps: 12.0, acceleration_mps2: 12.0, turn_radius_m: 0.0 })
            }
        }
    }

    /// The limits of a vehicle whose rear axle is `rear_axle_m` behind its centre. They equal the default
    /// saturation of the model's controls. \[model §4\]
    #[must_use]
    pub const fn vehicle(rear_axle_m: f32) -> Self {
        let (acceleration_mps2, slip_rad, slip_rate_radps) = (6.0, 0.5, 1.0);
        Self::Bicycle(BicycleLimits { acceleration_mps2, slip_rad, slip_rate_radps, rear_axle_m })
    }

    /// Whether a trajectory of steps `dt_s` apart, starting from `now`, violates the limits.
    ///
    /// A violation is proven by the positions:
    ///
    /// * Bicycle: over one step or several, no accelerations within the limit give these step lengths, or no
    ///   slip angles give these changes of course. A rollout of a bicycle within its limits never violates
    ///   them, even with rounding.
    /// * Point: a finite difference is too large. Curves count from 1 m/s, because below that rounding
    ///   decides the course.
    #[must_use]
    pub fn violated_by(&self, now: &State, trajectory: &[Point], dt_s: f32) -> bool {
        match self {
            Self::Bicycle(limits) => {
                let mut steering = Steering::new(limits, now, dt_s);
                trajectory.iter().any(|next| !steering.reaches(*next))
            }
            Self::Point(limits) => {
                let mut position = now.position_m;
                let mut velocity = now.velocity_mps;
                trajectory.iter().any(|next| {
                    let moved = [(next[0] - position[0]) / dt_s, (next[1] - position[1]) / dt_s];
                    let violated = limits.violated_between(velocity, moved, dt_s);
                    (position, velocity) = (*next, moved);
                    violated
                })
            }
        }
    }
}

impl PointLimits {
    fn violated_between(&self, before: [f32; 2], after: [f32; 2], dt_s: f32) -> bool {
        let speed_mps = after[0].hypot(after[1]);
        let acceleration_mps2 = (after[0] - before[0]).hypot(after[1] - before[1]) / dt_s;
        let cross = before[0] * after[1] - before[1] * after[0];
        let dot = before[0] * after[0] + before[1] * after[1];
        let turned_rad = cross.atan2(dot).abs();
        let turning = speed_mps.min(before[0].hypot(before[1])) > 1.0;
        let tight = turning && speed_mps * dt_s < turned_rad * self.turn_radius_m;
        speed_mps > self.speed_mps || acceleration_mps2 > self.acceleration_mps2 || tight
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: State = State { position_m: [0.0; 2], velocity_mps: [10.0, 0.0], heading_rad: 0.0 };

    fn violated(agent_type: AgentType, speed_mps: f32, trajectory: &[Point]) -> bool {
        let now = State { velocity_mps: [speed_mps, 0.0], ..NOW };
        Limits::of(agent_type).violated_by(&now, trajectory, 0.5)
    }

    #[test]
    fn constant_velocity_is_within_all_limits() {
        for agent_type in [AgentType::Vehicle, AgentType::Cyclist, AgentType::Pedestrian] {
            assert!(!violated(agent_type, 10.0, &[[5.0, 0.0], [10.0, 0.0]]));
        }
    }

    #[test]
    fn a_jump_violates_the_acceleration_of_all_types() {
        for agent_type in [AgentType::Vehicle, AgentType::Cyclist, AgentType::Pedestrian] {
            assert!(violated(agent_type, 10.0, &[[5.0, 0.0], [13.5, 0.0]]));
            assert!(violated(agent_type, 10.0, &[[-5.0, 0.0]]));
        }
    }

    #[test]
    fn only_pedestrians_turn_on_the_spot() {
        let corner = [[0.0, 0.6]];
        assert!(violated(AgentType::Vehicle, 1.2, &corner));
        assert!(violated(AgentType::Cyclist, 1.2, &corner));
        assert!(!violated(AgentType::Pedestrian, 1.2, &corner));
    }

    #[test]
    fn speed_limit_holds_for_cyclists_only() {
        assert!(violated(AgentType::Cyclist, 24.0, &[[13.0, 0.0]]));
        assert!(!violated(AgentType::Vehicle, 24.0, &[[12.5, 0.0]]));
    }
}
