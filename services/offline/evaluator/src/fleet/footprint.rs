//! Near-collisions: two agents that would touch if both kept their velocities, but do not.

use scene::AgentType;

/// No agent brakes harder: tyres have no more grip. A contact that needs more, and did not happen, is an error of
/// the recording's positions or sizes.
const BRAKING_MAX_MPS2: f32 = 9.8;
/// Distances and speeds below this count as zero.
const TINY: f32 = 1e-6;

/// The rectangle that an agent covers, and its velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Footprint {
    pub(crate) agent: u64,
    pub(crate) agent_type: AgentType,
    pub(crate) position_m: [f32; 2],
    pub(crate) velocity_mps: [f32; 2],
    pub(crate) heading_rad: f32,
    /// Extent along and across the heading.
    pub(crate) size_m: [f32; 2],
}

/// A contact that two agents avoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The other agent.
    pub with: u64,
    /// Seconds until the contact if both kept their velocities.
    pub after_s: f32,
    /// Deceleration that takes their relative speed away before the contact, m/s². It is small for agents that
    /// graze each other side by side, however near they are.
    pub deceleration_mps2: f32,
}

impl Footprint {
    fn axes(&self) -> [[f32; 2]; 2] {
        let (sin, cos) = self.heading_rad.sin_cos();
        [[cos, sin], [-sin, cos]]
    }

    /// Half of the extent along an axis.
    fn reach_m(&self, axis: [f32; 2]) -> f32 {
        let halves =
            self.axes().into_iter().zip(self.size_m).map(|(own, size_m)| 0.5 * size_m * dot(own, axis).abs());
        halves.sum()
    }

    /// The time from which and up to which the two rectangles overlap at constant velocity, s. The first may be
    /// in the past.
    fn overlap_s(&self, other: &Self) -> Option<[f32; 2]> {
        let apart_m = between(self.position_m, other.position_m);
        let closing_mps = between(self.velocity_mps, other.velocity_mps);
        let [mut enters_s, mut leaves_s] = [f32::NEG_INFINITY, f32::INFINITY];
        // Two rectangles overlap while their shadows overlap on each of the four axes.
        for axis in self.axes().into_iter().chain(other.axes()) {
            let (distance_m, speed_mps) = (dot(apart_m, axis), dot(closing_mps, axis));
            let reach_m = self.reach_m(axis) + other.reach_m(axis);
            if speed_mps.abs() < TINY {
                if distance_m.abs() >= reach_m {
                    return None;
                }
                continue;
            }
            let times_s = [-reach_m, reach_m].map(|border_m| (border_m - distance_m) / speed_mps);
            enters_s = enters_s.max(times_s[0].min(times_s[1]));
            leaves_s = leaves_s.min(times_s[0].max(times_s[1]));
        }
        (enters_s < leaves_s && leaves_s > 0.0).then_some([enters_s, leaves_s])
    }

    /// Whether the two rectangles overlap now.
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        self.overlap_s(other).is_some_and(|[enters_s, _]| enters_s <= 0.0)
    }

    /// The contact with another agent within `within_s` that braking can avoid. `None`, too, if they overlap
    /// already, which is an error of the recording's positions or sizes.
    pub(crate) fn contact(&self, other: &Self, within_s: f32) -> Option<Contact> {
        let [after_s, _] = self.overlap_s(other)?;
        let [vx, vy] = between(self.velocity_mps, other.velocity_mps);
        let deceleration_mps2 = vx.hypot(vy) / (2.0 * after_s);
        let is_avoidable = after_s > 0.0 && deceleration_mps2 <= BRAKING_MAX_MPS2;
        (is_avoidable && after_s <= within_s).then_some(Contact {
            with: other.agent,
            after_s,
            deceleration_mps2,
        })
    }
}

fn between(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [b[0] - a[0], b[1] - a[1]]
}

fn dot(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[0] + a[1] * b[1]
}

/// For each agent the contact that needs the hardest braking. Pairs that `do_touch` are left out: their boxes are
/// wrong. So are pairs of pedestrians, who walk close to one another.
pub(crate) fn contacts(
    agents: &[Footprint],
    within_s: f32,
    do_touch: impl Fn(u64, u64) -> bool,
) -> Vec<Option<Contact>> {
    let mut hardest: Vec<Option<Contact>> = vec![None; agents.len()];
    for (i, a) in agents.iter().enumerate() {
        for (j, b) in agents.iter().enumerate().skip(i + 1) {
            if [a, b].iter().all(|agent| agent.agent_type == AgentType::Pedestrian) {
                continue;
            }
            let Some(contact) = a.contact(b, within_s).filter(|_| !do_touch(a.agent, b.agent)) else {
                continue;
            };
            for (of, with) in [(i, b.agent), (j, a.agent)] {
                if hardest[of].is_none_or(|known| contact.deceleration_mps2 > known.deceleration_mps2) {
                    hardest[of] = Some(Contact { with, ..contact });
                }
            }
        }
    }
    hardest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn car(position_m: [f32; 2], speed_mps: f32, heading_rad: f32) -> Footprint {
        let (sin, cos) = heading_rad.sin_cos();
        Footprint {
            agent: position_m[0] as u64,
            agent_type: AgentType::Vehicle,
            position_m,
            velocity_mps: [speed_mps * cos, speed_mps * sin],
            heading_rad,
            size_m: [4.0, 2.0],
        }
    }

    #[test]
    fn a_car_reaches_the_bumper_of_the_standing_car_ahead() {
        // 24 m between the centres are 20 m between the bumpers.
        let found = car([0.0, 0.0], 10.0, 0.0).contact(&car([24.0, 0.0], 0.0, 0.0), 3.0);
        assert!(
            found.is_some_and(
                |of| (of.after_s - 2.0).abs() < 1e-4 && (of.deceleration_mps2 - 2.5).abs() < 1e-3
            ),
            "{found:?}"
        );
        assert_eq!(car([0.0, 0.0], 10.0, 0.0).contact(&car([24.0, 0.0], 0.0, 0.0), 1.9), None);
        assert_eq!(car([0.0, 0.0], 10.0, 0.0).contact(&car([24.0, 0.0], 10.0, 0.0), 3.0), None);
    }

    #[test]
    fn paths_that_cross_touch_only_if_both_are_there_at_once() {
        let crossing = |y_m: f32| {
            car([0.0, 0.0], 10.0, 0.0).contact(&car([20.0, y_m], 10.0, std::f32::consts::FRAC_PI_2), 5.0)
        };
        // The front of the first is at 2 m + 10 t, the side of the second at 19 m.
        assert!(crossing(-20.0).is_some_and(|of| (of.after_s - 1.7).abs() < 1e-4), "{:?}", crossing(-20.0));
        assert_eq!(crossing(-40.0), None);
        assert_eq!(crossing(10.0), None);
    }

    #[test]
    fn cars_in_the_next_lane_and_overlapping_boxes_are_no_near_collision() {
        assert_eq!(car([0.0, 0.0], 10.0, 0.0).contact(&car([24.0, 2.5], 0.0, 0.0), 3.0), None);
        assert_eq!(car([0.0, 0.0], 10.0, 0.0).contact(&car([3.0, 0.5], 0.0, 0.0), 3.0), None);
    }

    #[test]
    fn a_contact_that_no_brake_avoids_is_an_error_of_the_boxes() {
        // 5 m between the bumpers need 10 m/s², 6 m need 8.3 m/s².
        let behind = |gap_m: f32| car([0.0, 0.0], 10.0, 0.0).contact(&car([4.0 + gap_m, 0.0], 0.0, 0.0), 3.0);
        assert_eq!(behind(5.0), None);
        assert!(
            behind(6.0).is_some_and(|of| (of.deceleration_mps2 - 8.333).abs() < 1e-2),
            "{:?}",
            behind(6.0)
        );
    }

    #[test]
    fn each_agent_has_its_hardest_contact_and_pedestrians_have_none() {
        let walker = |x_m: f32, speed_mps: f32| Footprint {
            agent_type: AgentType::Pedestrian,
            size_m: [0.4, 0.4],
            ..car([x_m, 0.0], speed_mps, 0.0)
        };
        let agents = [car([0.0, 0.0], 10.0, 0.0), walker(15.0, 0.0), walker(17.0, -1.0)];
        let found = contacts(&agents, 3.0, |_, _| false);
        assert!(matches!(found[0], Some(of) if of.with == 17), "the faster one: {found:?}");
        assert!(
            matches!(found[1], Some(of) if of.with == 0 && (of.after_s - 1.28).abs() < 1e-3),
            "{found:?}"
        );
        let found = contacts(&agents, 3.0, |a, b| (a, b) == (0, 17));
        assert!(matches!(found[0], Some(of) if of.with == 15) && found[2].is_none(), "{found:?}");
        assert_eq!(contacts(&[walker(0.0, 1.0), walker(3.0, -1.0)], 3.0, |_, _| false), [None, None]);
    }
}
