use scene::{AgentType, State};

use crate::Point;

/// What agents of a type can physically do; a forecast beyond it is impossible, not just unlikely.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest speed.
    pub speed_mps: f32,
    /// Largest change of the velocity per second.
    pub acceleration_mps2: f32,
    /// Smallest radius of a curve; 0 where an agent can turn on the spot.
    pub turn_radius_m: f32,
}

impl Limits {
    /// The limits of an agent type: tyre grip and steering lock for vehicles, sprinters for people.
    #[must_use]
    pub const fn of(agent_type: AgentType) -> Self {
        match agent_type {
            AgentType::Vehicle => Self { speed_mps: 70.0, acceleration_mps2: 10.0, turn_radius_m: 3.0 },
            AgentType::Cyclist => Self { speed_mps: 25.0, acceleration_mps2: 8.0, turn_radius_m: 1.0 },
            AgentType::Pedestrian => Self { speed_mps: 12.0, acceleration_mps2: 12.0, turn_radius_m: 0.0 },
        }
    }

    /// Whether a trajectory of steps `dt_s` apart that starts from `now` leaves the limits.
    ///
    /// Speeds, accelerations and curvatures are finite differences of the positions; the first acceleration is that
    /// from the velocity of `now`. Curves count from 1 m/s up, below which rounding decides the course.
    #[must_use]
    pub fn broken_by(&self, now: &State, trajectory: &[Point], dt_s: f32) -> bool {
        let mut position = now.position_m;
        let mut velocity = now.velocity_mps;
        trajectory.iter().any(|next| {
            let moved = [(next[0] - position[0]) / dt_s, (next[1] - position[1]) / dt_s];
            let broken = self.broken_between(velocity, moved, dt_s);
            (position, velocity) = (*next, moved);
            broken
        })
    }

    fn broken_between(&self, before: [f32; 2], after: [f32; 2], dt_s: f32) -> bool {
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

    fn broken(trajectory: &[Point]) -> bool {
        Limits::of(AgentType::Vehicle).broken_by(&NOW, trajectory, 0.5)
    }

    #[test]
    fn going_on_and_braking_hard_are_possible() {
        assert!(!broken(&[[5.0, 0.0], [10.0, 0.0]]));
        assert!(!broken(&[[2.6, 0.0], [3.0, 0.0]]), "9.6 and 8.8 m/s²");
    }

    #[test]
    fn a_jump_breaks_the_acceleration() {
        assert!(broken(&[[5.0, 0.0], [13.0, 0.0]]));
        assert!(broken(&[[-5.0, 0.0]]));
    }

    #[test]
    fn a_car_cannot_turn_on_the_spot_but_a_pedestrian_can() {
        let slow = State { velocity_mps: [1.2, 0.0], ..NOW };
        let corner = [[0.0, 0.6]];
        assert!(Limits::of(AgentType::Vehicle).broken_by(&slow, &corner, 0.5));
        assert!(!Limits::of(AgentType::Pedestrian).broken_by(&slow, &corner, 0.5));
    }

    #[test]
    fn speed_alone_breaks_it_too() {
        let fast = State { velocity_mps: [24.0, 0.0], ..NOW };
        let trajectory = [[13.0, 0.0]];
        assert!(Limits::of(AgentType::Cyclist).broken_by(&fast, &trajectory, 0.5));
        assert!(!Limits::of(AgentType::Vehicle).broken_by(&fast, &trajectory, 0.5));
    }
}
