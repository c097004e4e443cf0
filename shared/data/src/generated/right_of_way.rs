//! Priority at the intersection: gap acceptance without signals.
//!
//! A road user that comes near claims its turn. Claims of users that have to yield (from the side road, or to
//! turn left) count some seconds later. So the main road goes first, and every wait ends.
//!
//! A user enters when it can pass behind all users that entered before it and well ahead of all users with an
//! earlier claim. Users are numbered in the order in which they enter. If two routes cross, the user with the
//! later number gives way, so waits never form a cycle.

use super::layout::{Layout, Relation, Route, Turn};
use super::road_user::{RoadUser, TurnTaking};

/// Users claim their turn at this distance before the stop line.
const CLAIM_WITHIN_M: f32 = 35.0;
/// Distance before the stop line at which users decide to enter, or more if they need more to stop.
const DECIDE_WITHIN_M: f32 = 8.0;
/// Minimum time by which a user passes behind another.
const BEHIND_S: f32 = 0.3;
/// Minimum time that an accepted gap leaves before the arrival of another user.
const AHEAD_S: f32 = 1.2;
/// Length of a shared exit lane that must be free before the next user enters it.
const MERGE_M: f32 = 7.0;
/// A user that has stood on the intersection for this long no longer waits for users that have not entered.
const PATIENCE_S: f32 = 10.0;

/// Time that is added to the claims of a route.
fn deference_s(route: &Route) -> f64 {
    let side_road: f64 = if route.from_arm % 2 == 1 { 5.0 } else { 0.0 };
    side_road + if route.turn == Turn::Left { 3.0 } else { 0.0 }
}

/// Gives claims to users that have come near, and lets users enter that may. `going_count` counts all users
/// that ever entered.
pub(super) fn take_turns(users: &mut [RoadUser], layout: &Layout, now_s: f64, going_count: &mut u64) {
    give_up_turns(users, layout);
    claim(users, layout, now_s);
    for i in 0..users.len() {
        let TurnTaking::Waiting { claim_s } = users[i].turn_taking else { continue };
        if may_go(i, claim_s, users, layout) {
            users[i].turn_taking = TurnTaking::Going { order: *going_count, claim_s };
            *going_count += 1;
        }
    }
}

/// Withdraws the turn of users that pedestrians stop before the stop line, and of users behind them in their
/// lane. Other users can then go first.
fn give_up_turns(users: &mut [RoadUser], layout: &Layout) {
    for i in 0..users.len() {
        let user = &users[i];
        let before_line = user.front_m() < layout.routes[user.route].stop_line_m + 0.5;
        let TurnTaking::Going { claim_s, .. } = user.turn_taking else { continue };
        if !before_line {
            continue;
        }
        let held = user.yields && user.stood_s > 0.5;
        let waits = |other: &RoadUser| matches!(other.turn_taking, TurnTaking::Waiting { .. });
        let behind_waiting =
            users.iter().any(|u| same_lane(u, user, layout) && u.along_m > user.along_m && waits(u));
        if held || behind_waiting {
            users[i].turn_taking = TurnTaking::Waiting { claim_s };
        }
    }
}

fn claim(users: &mut [RoadUser], layout: &Layout, now_s: f64) {
    for user in users.iter_mut() {
        let route = &layout.routes[user.route];
        let near = user.front_m() > route.stop_line_m - CLAIM_WITHIN_M;
        if user.turn_taking == TurnTaking::Far && near {
            user.turn_taking = TurnTaking::Waiting { claim_s: now_s + deference_s(route) };
        }
    }
    // Users don't overtake, so a claim never counts before the claim of the user ahead.
    for i in 0..users.len() {
        let TurnTaking::Waiting { claim_s } = users[i].turn_taking else { continue };
        let ahead = users.iter().filter(|u| same_lane(u, &users[i], layout) && u.along_m > users[i].along_m);
        let claim_s = ahead.fold(claim_s, |latest, u| match u.turn_taking {
            TurnTaking::Waiting { claim_s } => latest.max(claim_s + 1e-3),
            TurnTaking::Far | TurnTaking::Going { .. } => latest,
        });
        users[i].turn_taking = TurnTaking::Waiting { claim_s };
    }
}

fn same_lane(a: &RoadUser, b: &RoadUser, layout: &Layout) -> bool {
    a.kind == b.kind && layout.routes[a.route].from_arm == layout.routes[b.route].from_arm
}

fn may_go(i: usize, claim_s: f64, users: &[RoadUser], layout: &Layout) -> bool {
    let user = &users[i];
    let route = &layout.routes[user.route];
    let to_line_m = route.stop_line_m - user.front_m();
    let needs_m = user.speed_mps * user.speed_mps / (2.0 * user.temper.braking_mps2) + DECIDE_WITHIN_M;
    if user.yields || to_line_m > needs_m {
        return false;
    }
    // Equal claims are ordered by id, so one of them is always first.
    let later = |others_s: f64, other: &RoadUser| (others_s, other.id) > (claim_s, user.id);
    users.iter().enumerate().filter(|(j, _)| *j != i).all(|(_, other)| match other.turn_taking {
        TurnTaking::Far => true,
        TurnTaking::Waiting { claim_s } if same_lane(other, user, layout) => later(claim_s, other),
        TurnTaking::Waiting { claim_s } => later(claim_s, other) || clears_ahead_of(user, other, layout),
        TurnTaking::Going { .. } => passes_behind(user, other, layout),
    })
}

/// The parts of both routes that only one user at a time may use: start and end of mine, start and end of the
/// other's.
fn contested(user: &RoadUser, other: &RoadUser, layout: &Layout) -> Option<[f32; 4]> {
    match layout.relation(user.route, other.route) {
        Relation::Apart | Relation::SameStart { .. } => None,
        Relation::Cross { mine_m, other_m } => Some([mine_m.start, mine_m.end, other_m.start, other_m.end]),
        Relation::SameEnd { mine_m, other_m } => {
            Some([*mine_m, mine_m + MERGE_M, *other_m, other_m + MERGE_M])
        }
    }
}

/// Whether `user` would have crossed well before `other`, which has the earlier claim, can arrive.
fn clears_ahead_of(user: &RoadUser, other: &RoadUser, layout: &Layout) -> bool {
    let Some([_, end, others_start, _]) = contested(user, other, layout) else { return true };
    let held = other.yields && other.speed_mps < 0.5;
    let route = &layout.routes[user.route];
    let mine_s = user.time_to_cover_s(end - user.rear_m(), cruise_mps(user, route));
    let others_s = other.time_to_cover_s(others_start - other.front_m(), other.temper.speed_max_mps);
    held || mine_s + AHEAD_S < others_s
}

/// Whether `user` would reach the contested part only after `other`, which has entered, has left it.
fn passes_behind(user: &RoadUser, other: &RoadUser, layout: &Layout) -> bool {
    let Some([start, _, _, others_end]) = contested(user, other, layout) else { return true };
    let left_m = others_end - other.rear_m();
    if left_m <= 0.0 {
        return true;
    }
    if other.speed_mps < 1.0 && other.acceleration_mps2 < 0.3 {
        return false;
    }
    let others_s = other.time_to_cover_s(left_m, cruise_mps(other, &layout.routes[other.route]));
    user.time_to_cover_s(start - user.front_m(), user.temper.speed_max_mps) > others_s + BEHIND_S
}

/// The speed at which a user crosses the intersection.
fn cruise_mps(user: &RoadUser, route: &Route) -> f32 {
    let curve: f32 = if route.turn == Turn::Straight { 10.0 } else { 4.5 };
    curve.min(user.temper.speed_max_mps)
}

/// The largest acceleration of user `i` that the other road users allow: behind a leader, before its turn,
/// and while giving way.
pub(super) fn among_users_mps2(i: usize, users: &[RoadUser], layout: &Layout) -> f32 {
    let user = &users[i];
    let route = &layout.routes[user.route];
    let wanted_mps = user.wanted_mps(route);
    let mut least = user.free_mps2(wanted_mps);
    let order = match user.turn_taking {
        TurnTaking::Going { order, .. } => Some(order),
        TurnTaking::Far | TurnTaking::Waiting { .. } => {
            least = least.min(user.stopping_mps2(wanted_mps, route.stop_line_m - user.front_m()));
            None
        }
    };
    for (j, other) in users.iter().enumerate() {
        if j == i {
            continue;
        }
        let behind = |gap_m: f32| user.following_mps2(wanted_mps, gap_m, other.speed_mps);
        match layout.relation(user.route, other.route) {
            Relation::Apart => {}
            Relation::SameStart { until_m } => {
                if other.along_m > user.along_m && other.rear_m() < *until_m {
                    least = least.min(behind(other.rear_m() - user.front_m()));
                }
            }
            Relation::SameEnd { mine_m, other_m } => {
                // Distances are compared as the remaining distances to the end of the shared lane.
                let gap_m = (other.rear_m() - other_m) - (user.front_m() - mine_m);
                let first = precedes(other, order) || other.rear_m() > *other_m;
                if first && other.along_m - other_m > user.along_m - mine_m {
                    least = least.min(behind(gap_m));
                } else if first && user.front_m() < *mine_m {
                    least = least.min(user.stopping_mps2(wanted_mps, mine_m - user.front_m()));
                }
            }
            Relation::Cross { mine_m, other_m } => {
                let inside = other.front_m() > other_m.start && other.rear_m() < other_m.end;
                let due = precedes(other, order) && other.rear_m() < other_m.end && user.stood_s < PATIENCE_S;
                if (inside || due) && order.is_some() && user.front_m() < mine_m.start + 0.5 {
                    least = least.min(user.stopping_mps2(wanted_mps, mine_m.start - 0.5 - user.front_m()));
                }
            }
        }
    }
    least
}

/// Whether `other` entered before the user with this order.
fn precedes(other: &RoadUser, order: Option<u64>) -> bool {
    match (other.turn_taking, order) {
        (TurnTaking::Going { order: others, .. }, Some(order)) => others < order,
        _ => false,
    }
}
