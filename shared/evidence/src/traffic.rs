//! The vehicle ahead: which one it is, and how it holds back the agent behind it.

use wire::{AGENTS_MAX, HORIZON_MAX};

use crate::paths::{COURSE_MIN_MPS, MotionNow, decayed, gained_mps};

/// Distance between the bumpers of standing vehicles.
const STANDING_GAP_M: f32 = 2.0;
/// Time gap that drivers keep.
const TIME_GAP_S: f32 = 1.2;
/// Scale of the reaction to a gap that is too small.
const REACTION_MPS2: f32 = 1.5;
/// Comfortable deceleration.
const COMFORTABLE_MPS2: f32 = 2.0;
/// Largest deceleration.
const BRAKING_MAX_MPS2: f32 = 5.0;
/// Smallest gap in a quotient.
const GAP_MIN_M: f32 = 0.5;
/// Room that an agent leaves beside a vehicle that it passes.
const BESIDE_M: f32 = 0.3;
/// Cosine of the largest angle between the agent's path and the course of a leader that moves.
const ALONG_COS: f32 = 0.7;
/// Below this speed a leader has no course, so that it is in the way in any direction.
const STANDS_MPS: f32 = 0.5;
/// Distance beyond the end of the horizon in which leaders are searched.
const BEYOND_M: f32 = 20.0;
/// Points of a path on which leaders are searched.
const LINE_POINTS: usize = 33;
/// Parts of a step in which the speed is constant.
const PARTS: usize = 4;

/// An agent that others may follow.
#[derive(Clone, Copy, Debug)]
pub struct RoadUser {
    /// Number of the track.
    pub id: u64,
    /// Its motion.
    pub motion: MotionNow,
    /// Its heading.
    pub heading_rad: f32,
    /// Length and width.
    pub size_m: [f32; 2],
}

/// All agents of a tick.
#[derive(Clone, Debug)]
pub struct Traffic(Vec<RoadUser>);

/// The vehicle ahead on a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leader {
    /// Distance between the bumpers.
    pub gap_m: f32,
    /// Its speed along the path.
    pub speed_mps: f32,
    /// Its acceleration along the path.
    pub acceleration_mps2: f32,
}

/// A path in space: points with the length up to each of them.
#[derive(Clone, Copy, Debug)]
pub struct Line<'a> {
    /// Points.
    pub points_m: &'a [[f32; 2]],
    /// Length up to each point.
    pub along_m: &'a [f32],
}

impl Default for Traffic {
    fn default() -> Self {
        Self(Vec::with_capacity(AGENTS_MAX))
    }
}

impl Traffic {
    /// Removes all agents.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Adds an agent. Agents beyond [`AGENTS_MAX`] are left out.
    pub fn push(&mut self, user: RoadUser) {
        if self.0.len() < AGENTS_MAX {
            self.0.push(user);
        }
    }

    /// The agent that was added at this place.
    ///
    /// # Panics
    /// If there is none.
    #[must_use]
    pub fn of(&self, place: usize) -> &RoadUser {
        &self.0[place]
    }

    /// The vehicle ahead of an agent on the path of its decaying turn. An agent without a course has none.
    #[must_use]
    pub fn leader_on_turn(&self, follower: &RoadUser, horizon_s: f32) -> Option<Leader> {
        let speed_mps = follower.motion.speed_mps();
        if speed_mps <= COURSE_MIN_MPS {
            return None;
        }
        let (points_m, along_m) = follower.motion.turn_line(speed_mps * horizon_s + BEYOND_M);
        self.leader(follower, Line { points_m: &points_m, along_m: &along_m })
    }

    /// The nearest agent in the way of an agent on this line.
    #[must_use]
    pub fn leader(&self, follower: &RoadUser, line: Line<'_>) -> Option<Leader> {
        let reach_m = *line.along_m.last()?;
        let course = follower.motion.course(follower.heading_rad);
        let ahead = |user: &&RoadUser| {
            let [x, y] = [0, 1].map(|axis| user.motion.position_m[axis] - follower.motion.position_m[axis]);
            user.id != follower.id && x * course[0] + y * course[1] > 0.0 && x.hypot(y) < reach_m
        };
        let in_the_way = self.0.iter().filter(ahead).filter_map(|user| {
            let (along_m, beside_m, tangent) = line.nearest(user.motion.position_m)?;
            let cos = |[x, y]: [f32; 2]| x * tangent[0] + y * tangent[1];
            let (sin_heading, cos_heading) = user.heading_rad.sin_cos();
            let [along, across] =
                [[cos_heading, sin_heading], [-sin_heading, cos_heading]].map(|of| cos(of).abs());
            // Half of the leader's extent along and across the path.
            let [long_m, wide_m] = user.size_m.map(|size_m| 0.5 * size_m);
            let half_along_m = long_m * along + wide_m * across;
            let half_across_m = wide_m * along + long_m * across;
            let along_mps = cos(user.motion.velocity_mps);
            let speed_mps = user.motion.speed_mps();
            if beside_m > half_across_m + 0.5 * follower.size_m[1] + BESIDE_M
                || (speed_mps > STANDS_MPS && along_mps < ALONG_COS * speed_mps)
            {
                return None;
            }
            Some(Leader {
                gap_m: along_m - half_along_m - 0.5 * follower.size_m[0],
                speed_mps: along_mps.max(0.0),
                acceleration_mps2: user.motion.acceleration_mps2,
            })
        });
        in_the_way.min_by(|a, b| a.gap_m.total_cmp(&b.gap_m))
    }
}

impl Line<'_> {
    /// The length up to the nearest point of the line, the distance from it, and the direction there. `None` if
    /// the nearest point is an end of the line.
    fn nearest(&self, [x, y]: [f32; 2]) -> Option<(f32, f32, [f32; 2])> {
        let mut nearest: Option<(f32, f32, [f32; 2])> = None;
        for (segment, along_m) in self.points_m.windows(2).zip(self.along_m) {
            let [a, b] = [segment[0], segment[1]];
            let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
            let length_m = dx.hypot(dy);
            if length_m < 1e-3 {
                continue;
            }
            let tangent = [dx / length_m, dy / length_m];
            let [from_x, from_y] = [x - a[0], y - a[1]];
            let part_m = from_x * tangent[0] + from_y * tangent[1];
            let clipped_m = part_m.clamp(0.0, length_m);
            let beside_m = (from_x - clipped_m * tangent[0]).hypot(from_y - clipped_m * tangent[1]);
            if nearest.is_none_or(|(_, least_m, _)| beside_m < least_m) {
                nearest = Some((along_m + clipped_m, beside_m, tangent));
            }
        }
        nearest
    }
}

impl MotionNow {
    /// The distance gone at each step with a decaying acceleration, held back by the vehicle ahead and by
    /// `most_mps`, the speed that the path permits at a distance.
    ///
    /// ```text
    /// dv/dt = min(a e^(−t/τ), −b ((s*/s)² − 1) if s* > s)      s* = s₀ + v T + v (v − v_l) / (2 √(b c))
    /// ```
    ///
    /// s is the gap, v_l the leader's speed, and T the time gap: the usual one, or the present one if that is
    /// smaller. So a vehicle that follows closely at the leader's speed keeps its gap. This is the interaction
    /// of the [intelligent driver model](https://doi.org/10.1103/PhysRevE.62.1805).
    pub fn progress(
        &self,
        dt_s: f32,
        leader: Option<&Leader>,
        most_mps: impl Fn(f32) -> f32,
        out: &mut [f32],
    ) {
        let part_s = dt_s / PARTS as f32;
        let now_mps = self.speed_mps();
        let (mut speed_mps, mut gone_m) = (now_mps, 0.0_f32);
        let time_gap_s = leader.map_or(TIME_GAP_S, |leader| {
            ((leader.gap_m - STANDING_GAP_M) / now_mps.max(1.0)).clamp(0.0, TIME_GAP_S)
        });
        let mut leader_gone_m = 0.0;
        for (step, out) in out.iter_mut().enumerate() {
            for part in 0..PARTS {
                let middle_s = ((step * PARTS + part) as f32 + 0.5) * part_s;
                let mut acceleration = decayed(self.acceleration_mps2, middle_s);
                if let Some(leader) = leader {
                    let leader_mps = leader.speed_at(middle_s);
                    let gap_m = (leader.gap_m + leader_gone_m - gone_m).max(GAP_MIN_M);
                    leader_gone_m += leader_mps * part_s;
                    let closing = speed_mps * (speed_mps - leader_mps)
                        / (2.0 * (REACTION_MPS2 * COMFORTABLE_MPS2).sqrt());
                    let wanted_m = STANDING_GAP_M.min(leader.gap_m.max(GAP_MIN_M))
                        + (speed_mps * time_gap_s + closing).max(0.0);
                    if wanted_m > gap_m {
                        acceleration = acceleration.min(-REACTION_MPS2 * ((wanted_m / gap_m).powi(2) - 1.0));
                    }
                }
                let next_mps = speed_mps + acceleration.max(-BRAKING_MAX_MPS2) * part_s;
                let most_mps = most_mps(gone_m).max(speed_mps - COMFORTABLE_MPS2 * part_s);
                let next_mps = next_mps.min(most_mps).max(0.0);
                gone_m += 0.5 * (speed_mps + next_mps) * part_s;
                speed_mps = next_mps;
            }
            *out = gone_m;
        }
    }

    /// Points along the path of a decaying turn up to a length, and the length up to each.
    fn turn_line(&self, reach_m: f32) -> ([[f32; 2]; LINE_POINTS], [f32; LINE_POINTS]) {
        let along_m = std::array::from_fn(|place| reach_m * place as f32 / (LINE_POINTS - 1) as f32);
        let mut points_m = [self.position_m; LINE_POINTS];
        self.along_turn(&along_m, &mut points_m);
        (points_m, along_m)
    }

    /// Positions on the path of a decaying turn after increasing distances. The path does not depend on the
    /// speed at which the agent takes it.
    pub fn along_turn(&self, gone_m: &[f32], out: &mut [[f32; 2]]) {
        let [mut x, mut y] = self.position_m;
        let speed_mps = self.speed_mps();
        if speed_mps <= COURSE_MIN_MPS {
            out.fill(self.position_m);
            return;
        }
        let [cos_now, sin_now] = self.course(0.0);
        let mut from_m = 0.0;
        for (&to_m, out) in gone_m.iter().zip(out) {
            let part_m = (to_m - from_m) / PARTS as f32;
            for part in 0..PARTS {
                let middle_m = from_m + (part as f32 + 0.5) * part_m;
                let (sin, cos) = self.turned_rad(middle_m / speed_mps).sin_cos();
                x += (cos_now * cos - sin_now * sin) * part_m;
                y += (cos_now * sin + sin_now * cos) * part_m;
            }
            from_m = to_m;
            *out = [x, y];
        }
    }

    /// The path of a decaying turn with a decaying acceleration, behind the vehicle ahead.
    pub fn following(&self, dt_s: f32, leader: Option<&Leader>, out: &mut [[f32; 2]]) {
        let mut gone_m = [0.0; HORIZON_MAX];
        let gone_m = &mut gone_m[..out.len()];
        self.progress(dt_s, leader, |_| f32::INFINITY, gone_m);
        self.along_turn(gone_m, out);
    }
}

impl Leader {
    /// Its speed at a time: a decaying acceleration, down to rest.
    fn speed_at(&self, time_s: f32) -> f32 {
        (self.speed_mps + gained_mps(self.acceleration_mps2, time_s)).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f32 = 0.4;

    fn car(id: u64, position_m: [f32; 2], velocity_mps: [f32; 2]) -> RoadUser {
        let motion = MotionNow::since(position_m, velocity_mps, None);
        RoadUser { id, motion, heading_rad: 0.0, size_m: [4.0, 2.0] }
    }

    fn traffic(users: &[RoadUser]) -> Traffic {
        let mut traffic = Traffic::default();
        users.iter().for_each(|user| traffic.push(*user));
        traffic
    }

    fn end(follower: &RoadUser, leader: Option<&Leader>) -> [f32; 2] {
        let mut path = [[0.0; 2]; 12];
        follower.motion.following(DT_S, leader, &mut path);
        path[11]
    }

    #[test]
    fn the_leader_is_the_nearest_agent_on_the_way() {
        let own = car(1, [0.0; 2], [10.0, 0.0]);
        let users = [
            own,
            car(2, [40.0, 0.5], [8.0, 0.0]),
            car(3, [25.0, 0.0], [9.0, 0.0]),
            car(4, [15.0, 3.5], [9.0, 0.0]),
            car(5, [20.0, 0.0], [-10.0, 0.0]),
            car(6, [-10.0, 0.0], [12.0, 0.0]),
        ];
        let leader = traffic(&users).leader_on_turn(&own, 4.8).expect("a leader");
        assert!((leader.gap_m - 21.0).abs() < 1e-3 && leader.speed_mps == 9.0, "{leader:?}");
        assert_eq!(traffic(&users[3..]).leader_on_turn(&own, 4.8), None);
    }

    #[test]
    fn a_turn_has_the_leader_of_the_turn() {
        let mut own = car(1, [0.0; 2], [8.0, 0.0]);
        own.motion.turn_rate_radps = 0.4;
        let mut on_the_turn = [[0.0; 2]; 1];
        own.motion.along_turn(&[20.0], &mut on_the_turn);
        let [ahead, aside] = [car(2, [20.0, 0.0], [0.0; 2]), car(3, on_the_turn[0], [0.0; 2])];
        let leader = traffic(&[ahead, aside]).leader_on_turn(&own, 4.8).expect("a leader");
        assert!((leader.gap_m - 16.0).abs() < 1.0, "{leader:?}");
        assert_eq!(traffic(&[ahead]).leader_on_turn(&own, 4.8), None);
    }

    #[test]
    fn nobody_drives_through_a_standing_vehicle() {
        let own = car(1, [0.0; 2], [10.0, 0.0]);
        for gap_m in [15.0, 25.0, 35.0] {
            let [x, _] = end(&own, Some(&Leader { gap_m, speed_mps: 0.0, acceleration_mps2: 0.0 }));
            assert!((0.5 * gap_m..gap_m).contains(&x), "{x} of {gap_m} m");
        }
    }

    #[test]
    fn a_vehicle_that_follows_at_the_same_speed_goes_on() {
        let own = car(1, [0.0; 2], [20.0, 0.0]);
        for gap_m in [8.0, 20.0, 60.0] {
            let [x, _] = end(&own, Some(&Leader { gap_m, speed_mps: 20.0, acceleration_mps2: 0.0 }));
            assert!((x - 96.0).abs() < 0.5, "{x} behind {gap_m} m");
        }
    }

    #[test]
    fn without_a_leader_turn_and_acceleration_are_one_path() {
        let before = ([7.2, -0.8], 0.8);
        let motion = MotionNow::since([0.0; 2], [8.0, 0.0], Some(before));
        let (mut turning, mut accelerating, mut both) = ([[0.0; 2]; 12], [[0.0; 2]; 12], [[0.0; 2]; 12]);
        motion.turning(DT_S, &mut turning);
        motion.accelerating(DT_S, &mut accelerating);
        motion.following(DT_S, None, &mut both);
        assert!(both[11][1] > turning[11][1] && both[11][0] > turning[11][0], "{both:?} {turning:?}");
        let length_m = |path: &[[f32; 2]; 12]| {
            path.windows(2).map(|pair| (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1])).sum::<f32>()
        };
        assert!((length_m(&both) - length_m(&accelerating)).abs() < 0.1);
        // A standing agent stays.
        let standing = MotionNow::since([1.0, 2.0], [0.1, 0.0], None);
        standing.following(DT_S, None, &mut both);
        assert_eq!(both, [[1.0, 2.0]; 12]);
    }

    #[test]
    fn speeds_that_a_path_permits_are_kept() {
        let motion = MotionNow::since([0.0; 2], [12.0, 0.0], None);
        let mut gone_m = [0.0; 12];
        motion.progress(DT_S, None, |gone_m| if gone_m > 10.0 { 5.0 } else { f32::INFINITY }, &mut gone_m);
        let last_mps = (gone_m[11] - gone_m[10]) / DT_S;
        assert!((last_mps - 5.0).abs() < 0.1, "{gone_m:?}");
    }
}
