//! Yielding between pedestrians and road users at crossings.
//!
//! Pedestrians have priority. A waiting pedestrian steps out as soon as every approaching road user stands or
//! can still stop. Road users stop before a crossing while a pedestrian is in the strip that they need, or is
//! about to reach it. Pedestrians at the kerb let a driver pass that has waited long, so an endless stream of
//! pedestrians can't block the road.

use super::layout::{Layout, Passage, to_arm};
use super::path::{Point, Pose};
use super::pedestrian::{BODY_M, Pedestrian};
use super::road_user::RoadUser;

/// Braking that a pedestrian expects from road users.
const EXPECTED_BRAKING_MPS2: f32 = 1.6;
/// Waiting time of a driver after which pedestrians at the kerb give way.
const COURTESY_S: f32 = 4.0;
/// Distance before a crossing at which road users stop.
const STOP_BEFORE_M: f32 = 0.8;
/// Lateral clearance of road users to a pedestrian.
const SIDE_ROOM_M: f32 = 0.8;
/// Road users give way to pedestrians that reach their strip within this time.
const FORESIGHT_MAX_S: f32 = 4.5;

/// Whether a pedestrian may step on the crossing of that arm.
pub(super) fn may_step_out(arm: usize, users: &[RoadUser], layout: &Layout) -> bool {
    users.iter().all(|user| {
        layout.routes[user.route].crossings.iter().filter(|p| p.arm == arm).all(|passage| {
            let gap_m = passage.along_m.start - STOP_BEFORE_M - user.front_m();
            let passed = user.rear_m() > passage.along_m.end + 0.3;
            let lets_go = user.yielded_s > COURTESY_S && gap_m < 3.0;
            let stops = user.speed_mps < 0.3 && gap_m > -STOP_BEFORE_M;
            let can_stop =
                gap_m > user.speed_mps.powi(2) / (2.0 * EXPECTED_BRAKING_MPS2) + 0.3 * user.speed_mps;
            passed || (!lets_go && (stops || can_stop))
        })
    })
}

/// The largest acceleration of a road user that pedestrians on crossings allow; `None` if no pedestrian is in
/// the way.
pub(super) fn for_pedestrians_mps2(
    user: &RoadUser,
    pedestrians: &[Pedestrian],
    layout: &Layout,
) -> Option<f32> {
    let route = &layout.routes[user.route];
    let pose = user.pose(route);
    let wanted_mps = user.wanted_mps(route);
    let stop = |gap_m: f32| user.stopping_mps2(wanted_mps, gap_m);
    let crossing = pedestrians.iter().filter_map(|w| w.on_crossing().map(|arm| (arm, w)));
    crossing
        .flat_map(|(arm, pedestrian)| {
            let near = route.crossings.iter().filter(move |p| p.arm == arm);
            let gap = near.filter_map(|p| gap_before(p, user, pedestrian)).reduce(f32::min);
            [gap, gap_to(pedestrian, user, pose)].into_iter().flatten()
        })
        .map(stop)
        .reduce(f32::min)
}

/// The gap to the stop before a crossing, if pedestrian and user would need the strip at about the same time.
fn gap_before(passage: &Passage, user: &RoadUser, pedestrian: &Pedestrian) -> Option<f32> {
    let gap_m = passage.along_m.start - STOP_BEFORE_M - user.front_m();
    let braking_m = user.speed_mps.powi(2) / 2.0 + 12.0;
    if gap_m < -STOP_BEFORE_M - 0.3 || gap_m > braking_m {
        return None;
    }
    let half_m = user.width_m / 2.0 + SIDE_ROOM_M;
    let strip = [passage.across_m.start - half_m, passage.across_m.end + half_m];
    let at_m = to_arm(passage.arm, pedestrian.position_m)[1];
    let towards = to_arm(passage.arm, pedestrian.direction())[1].signum();
    let (first, last) = if towards > 0.0 { (strip[0], strip[1]) } else { (strip[1], strip[0]) };
    let speed_mps = pedestrian.speed_mps().max(0.7 * pedestrian.wanted_mps);
    let (enters_s, leaves_s) = ((first - at_m) * towards / speed_mps, (last - at_m) * towards / speed_mps);
    let cruise_mps = user.speed_mps.max(4.0);
    let arrives_s = user.time_to_cover_s(gap_m + STOP_BEFORE_M, cruise_mps);
    let clears_s = user.time_to_cover_s(passage.along_m.end - user.rear_m(), cruise_mps);
    let meets =
        leaves_s > 0.0 && enters_s < (clears_s + 0.7).min(FORESIGHT_MAX_S) && arrives_s < leaves_s + 0.7;
    meets.then_some(gap_m)
}

/// The gap to a pedestrian directly in front of the user.
fn gap_to(pedestrian: &Pedestrian, user: &RoadUser, pose: Pose) -> Option<f32> {
    let [ahead_m, aside_m] = in_frame_of(pose, pedestrian.position_m);
    let gap_m = ahead_m - user.length_m / 2.0;
    let before = (0.0..8.0).contains(&gap_m) && aside_m.abs() < user.width_m / 2.0 + 0.45;
    before.then_some(gap_m - 0.8)
}

/// The reaction of a pedestrian to a road user nearby.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Avoidance {
    /// Whether the pedestrian stops for the road user.
    pub(super) holds: bool,
    /// Acceleration away from the road user's body, and around it if it stands in the way.
    pub(super) acceleration_mps2: Point,
}

/// The reaction of a pedestrian on a crossing to a road user; `None` if the road user is far away.
pub(super) fn avoid(pedestrian: &Pedestrian, user: &RoadUser, pose: Pose) -> Option<Avoidance> {
    let [ahead_m, aside_m] = in_frame_of(pose, pedestrian.position_m);
    let (half_length_m, half_width_m) = (user.length_m / 2.0, user.width_m / 2.0);
    let reach_m = 1.5 + user.speed_mps * 1.2;
    if ahead_m.abs() > half_length_m + reach_m || aside_m.abs() > half_width_m + 2.0 {
        return None;
    }
    let (sin, cos) = pose.heading_rad.sin_cos();
    let to_world = |[x, y]: Point| [cos * x - sin * y, sin * x + cos * y];
    let direction = pedestrian.direction();
    let towards = [cos * direction[0] + sin * direction[1], cos * direction[1] - sin * direction[0]];
    let approaches = towards[1] * aside_m < 0.0;
    let in_its_way = ahead_m > -half_length_m - 0.3 && ahead_m < half_length_m + reach_m - 1.0;
    let holds = user.speed_mps > 0.3
        && approaches
        && in_its_way
        && (half_width_m + BODY_M..half_width_m + 1.4).contains(&aside_m.abs());
    // The acceleration is away from the nearest point of the body.
    let nearest = [ahead_m.clamp(-half_length_m, half_length_m), aside_m.clamp(-half_width_m, half_width_m)];
    let apart = [ahead_m - nearest[0], aside_m - nearest[1]];
    let distance_m = apart[0].hypot(apart[1]).max(1e-3);
    let push = 4.0 * ((BODY_M + 0.1 - distance_m) / 0.25).exp().min(4.0);
    // A pedestrian passes a standing body at its nearer end.
    let blocked =
        approaches && distance_m < 1.2 && user.speed_mps <= 0.3 && ahead_m.abs() < half_length_m + 0.3;
    let around = if blocked { 2.5 * ahead_m.signum() } else { 0.0 };
    let push = [apart[0] / distance_m * push + around, apart[1] / distance_m * push];
    Some(Avoidance { holds, acceleration_mps2: to_world(push) })
}

/// Coordinates of a point in the frame of a pose: ahead, and to the left.
fn in_frame_of(pose: Pose, point: Point) -> Point {
    let (sin, cos) = pose.heading_rad.sin_cos();
    let [x, y] = [point[0] - pose.position_m[0], point[1] - pose.position_m[1]];
    [cos * x + sin * y, cos * y - sin * x]
}
