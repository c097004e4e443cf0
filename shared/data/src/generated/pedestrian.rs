//! A pedestrian: a route along pavements and crossings, and the social forces that change its path.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::layout::{ARM_M, CROSSING_M, KERB_M, to_world};
use super::path::Point;
use super::road_user::drawn;

/// Radius of a body.
pub(super) const BODY_M: f32 = 0.25;
/// Relaxation time towards the desired velocity.
const RELAXATION_S: f32 = 0.5;
/// Strength and reach of the repulsion between two pedestrians.
const REPULSION_MPS2: f32 = 4.5;
const REPULSION_REACH_M: f32 = 0.35;
/// Pedestrians farther away have no influence.
const NEIGHBOUR_M: f32 = 3.0;
/// Share of the repulsion that remains from behind.
const BEHIND_SHARE: f32 = 0.4;
/// Strength of the sidestep to the right when two pedestrians meet head-on.
const SIDESTEP_MPS2: f32 = 1.2;
const ACCELERATION_MAX_MPS2: f32 = 3.5;
/// Look-ahead distance along the route.
const LOOK_AHEAD_M: f32 = 2.5;
/// Distance at which a waypoint counts as reached.
const REACHED_M: f32 = 0.7;
/// Middle of the pavement, from the arm's axis.
const PAVEMENT_M: f32 = KERB_M + 2.0;
/// Waiting position before a crossing, from the arm's axis.
const WAITING_M: f32 = KERB_M + 1.0;

/// A point on a pedestrian's route.
#[derive(Clone, Copy, Debug)]
struct Waypoint {
    position_m: Point,
    /// The arm whose crossing leads to this point.
    crosses: Option<usize>,
}

/// A pedestrian on its route.
#[derive(Clone, Debug)]
pub(super) struct Pedestrian {
    pub(super) id: u64,
    pub(super) position_m: Point,
    pub(super) velocity_mps: Point,
    pub(super) wanted_mps: f32,
    way: Vec<Waypoint>,
    /// Index of the waypoint ahead.
    next: usize,
    /// Whether the pedestrian has stepped on the crossing that leads to the waypoint ahead.
    crossing: bool,
}

/// An end of a pavement: the arm and the side (+1 inbound, −1 outbound).
#[derive(Clone, Copy, Debug, PartialEq)]
struct PavementEnd {
    arm: usize,
    side: f32,
}

impl PavementEnd {
    fn drawn(rng: &mut ChaCha8Rng) -> Self {
        Self { arm: rng.random_range(0..4), side: if rng.random_bool(0.5) { 1.0 } else { -1.0 } }
    }

    /// The street corner at the pavement's inner end. Corner c is between arms c and c + 1.
    fn corner(self) -> usize {
        if self.side > 0.0 { self.arm } else { (self.arm + 3) % 4 }
    }
}

impl Pedestrian {
    /// A pedestrian at one end of a pavement with a route to another.
    pub(super) fn new(id: u64, rng: &mut ChaCha8Rng) -> Self {
        let from = PavementEnd::drawn(rng);
        let to = loop {
            let to = PavementEnd::drawn(rng);
            if to != from {
                break to;
            }
        };
        let way = way(from, to, rng);
        let wanted_mps = drawn(rng, 1.35, 0.2, 0.45);
        let start = way[0].position_m;
        let mut pedestrian =
            Self { id, position_m: start, velocity_mps: [0.0; 2], wanted_mps, way, next: 1, crossing: false };
        let [ex, ey] = pedestrian.direction();
        pedestrian.velocity_mps = [ex * wanted_mps, ey * wanted_mps];
        pedestrian
    }

    /// Whether the pedestrian is at the end of the route.
    pub(super) fn has_arrived(&self) -> bool {
        self.next == self.way.len()
    }

    /// The arm whose crossing the pedestrian is on.
    pub(super) fn on_crossing(&self) -> Option<usize> {
        self.ahead().crosses.filter(|_| self.crossing)
    }

    /// The arm whose crossing the pedestrian waits for.
    pub(super) fn waits_for(&self) -> Option<usize> {
        self.ahead().crosses.filter(|_| !self.crossing)
    }

    pub(super) fn step_on_crossing(&mut self) {
        self.crossing = true;
    }

    pub(super) fn speed_mps(&self) -> f32 {
        self.velocity_mps[0].hypot(self.velocity_mps[1])
    }

    fn ahead(&self) -> Waypoint {
        self.way[self.next.min(self.way.len() - 1)]
    }

    /// The desired direction: along the straight line to the waypoint ahead, and back to this line if the
    /// pedestrian is off it.
    pub(super) fn direction(&self) -> Point {
        let (from, to) = (self.way[self.next - 1].position_m, self.ahead().position_m);
        let along = unit([to[0] - from[0], to[1] - from[1]]);
        let length_m = (to[0] - from[0]).hypot(to[1] - from[1]);
        let done_m = dot([self.position_m[0] - from[0], self.position_m[1] - from[1]], along);
        let aim_m = (done_m + LOOK_AHEAD_M).min(length_m);
        let aim = [from[0] + along[0] * aim_m, from[1] + along[1] * aim_m];
        unit([aim[0] - self.position_m[0], aim[1] - self.position_m[1]])
    }

    /// Acceleration towards the desired velocity. The desired velocity is along the route. It is zero if the
    /// pedestrian `holds`. If the pedestrian waits at the kerb and was pushed away, the velocity points back
    /// to the kerb.
    pub(super) fn drive_mps2(&self, holds: bool) -> Point {
        let wanted = if self.waits_for().is_some() {
            let kerb = self.way[self.next - 1].position_m;
            let back = [kerb[0] - self.position_m[0], kerb[1] - self.position_m[1]];
            let slow = (self.wanted_mps / back[0].hypot(back[1]).max(1e-6)).min(1.0);
            back.map(|x| x * slow)
        } else {
            let wanted_mps = if holds { 0.0 } else { self.wanted_mps };
            self.direction().map(|e| e * wanted_mps)
        };
        [0, 1].map(|axis| (wanted[axis] - self.velocity_mps[axis]) / RELAXATION_S)
    }

    /// Acceleration away from another pedestrian: repulsion, and a step to the right when they meet head-on.
    pub(super) fn repulsion_mps2(&self, other: &Self) -> Point {
        let apart = [self.position_m[0] - other.position_m[0], self.position_m[1] - other.position_m[1]];
        let distance_m = apart[0].hypot(apart[1]);
        if distance_m > NEIGHBOUR_M {
            return [0.0; 2];
        }
        let away = unit(apart);
        let [ex, ey] = self.direction();
        let ahead = -dot(away, [ex, ey]);
        let share = BEHIND_SHARE + (1.0 - BEHIND_SHARE) * (1.0 + ahead) / 2.0;
        let push = share * REPULSION_MPS2 * ((2.0 * BODY_M - distance_m) / REPULSION_REACH_M).exp();
        let meets = dot(self.velocity_mps, other.velocity_mps) < 0.0 && ahead > 0.7;
        let sidestep = if meets { SIDESTEP_MPS2 * (-distance_m / NEIGHBOUR_M).exp() } else { 0.0 };
        [away[0] * push + ey * sidestep, away[1] * push - ex * sidestep]
    }

    /// Advances the pedestrian by one step.
    pub(super) fn advance(&mut self, acceleration_mps2: Point, dt_s: f32) {
        let size = acceleration_mps2[0].hypot(acceleration_mps2[1]);
        let scale = (ACCELERATION_MAX_MPS2 / size.max(1e-6)).min(1.0);
        let velocity = [0, 1].map(|axis| self.velocity_mps[axis] + acceleration_mps2[axis] * scale * dt_s);
        let speed_mps = velocity[0].hypot(velocity[1]);
        let slow = (1.25 * self.wanted_mps / speed_mps.max(1e-6)).min(1.0);
        self.velocity_mps = velocity.map(|v| v * slow);
        self.position_m = [0, 1].map(|axis| self.position_m[axis] + self.velocity_mps[axis] * dt_s);
        self.reach_waypoint();
    }

    fn reach_waypoint(&mut self) {
        if self.has_arrived() || self.waits_for().is_some() {
            return;
        }
        let (from, to) = (self.way[self.next - 1].position_m, self.ahead().position_m);
        let left = [to[0] - self.position_m[0], to[1] - self.position_m[1]];
        if dot(left, unit([to[0] - from[0], to[1] - from[1]])) < REACHED_M {
            self.next += 1;
            self.crossing = false;
        }
    }
}

/// The waypoints from one pavement end to another, around the corners and over the crossings between them.
fn way(from: PavementEnd, to: PavementEnd, rng: &mut ChaCha8Rng) -> Vec<Waypoint> {
    // Each pedestrian has its own lateral offset, so that pedestrians with the same route do not walk in
    // single file.
    let pavement_m = PAVEMENT_M + drawn(rng, 0.0, 0.6, 1.1);
    let along_m = f32::midpoint(CROSSING_M.start, CROSSING_M.end) + drawn(rng, 0.0, 0.8, 1.5);
    let walk = |arm: usize, x: f32, y: f32| Waypoint { position_m: to_world(arm, [x, y]), crosses: None };
    let mut way = vec![walk(from.arm, ARM_M, from.side * pavement_m)];
    way.push(walk(from.arm, along_m, from.side * pavement_m));
    let mut corner = from.corner();
    let left_turns = (to.corner() + 4 - corner) % 4;
    let leftwards = left_turns < 2 || left_turns == 2 && rng.random_bool(0.5);
    while corner != to.corner() {
        // Corners c and c + 1 are on the two sides of arm c + 1.
        let (arm, side) = if leftwards { ((corner + 1) % 4, -1.0) } else { (corner, 1.0) };
        way.push(walk(arm, along_m, side * WAITING_M));
        let across = walk(arm, along_m, -side * WAITING_M);
        way.push(Waypoint { crosses: Some(arm), ..across });
        corner = if leftwards { (corner + 1) % 4 } else { (corner + 3) % 4 };
    }
    way.push(walk(to.arm, along_m, to.side * pavement_m));
    way.push(walk(to.arm, ARM_M, to.side * pavement_m));
    way
}

fn unit([x, y]: Point) -> Point {
    let length = x.hypot(y).max(1e-6);
    [x / length, y / length]
}

fn dot(a: Point, b: Point) -> f32 {
    a[0] * b[0] + a[1] * b[1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn routes_cross_the_road_on_crossings_only() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for id in 0..200 {
            let pedestrian = Pedestrian::new(id, &mut rng);
            let outer = |p: Point| p[0].abs().max(p[1].abs());
            let (first, last) = (pedestrian.way[0], pedestrian.way[pedestrian.way.len() - 1]);
            assert!(outer(first.position_m) > ARM_M - 1.0 && outer(last.position_m) > ARM_M - 1.0);
            for pair in pedestrian.way.windows(2) {
                let [a, b] = [pair[0].position_m, pair[1].position_m];
                let on_road = (1..20).any(|i| {
                    let share = i as f32 / 20.0;
                    let x = a[0] + share * (b[0] - a[0]);
                    let y = a[1] + share * (b[1] - a[1]);
                    x.abs().min(y.abs()) < KERB_M
                });
                assert_eq!(on_road, pair[1].crosses.is_some(), "{a:?} to {b:?}");
            }
        }
    }

    #[test]
    fn a_lone_pedestrian_keeps_its_speed_and_arrives() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut pedestrian = Pedestrian::new(1, &mut rng);
        let mut steps = 0;
        while !pedestrian.has_arrived() {
            if pedestrian.waits_for().is_some() {
                pedestrian.step_on_crossing();
            }
            pedestrian.advance(pedestrian.drive_mps2(false), 0.04);
            steps += 1;
            assert!(steps < 10_000, "never arrives: {pedestrian:?}");
            assert!(pedestrian.speed_mps() < 1.26 * pedestrian.wanted_mps);
        }
    }

    #[test]
    fn pedestrians_that_meet_head_on_pass_each_other() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let template = Pedestrian::new(1, &mut rng);
        let pedestrian = |from: Point, to: Point| {
            let way = [from, to].map(|position_m| Waypoint { position_m, crosses: None }).to_vec();
            Pedestrian { position_m: from, velocity_mps: [0.0; 2], wanted_mps: 1.3, way, ..template.clone() }
        };
        let (mut a, mut b) = (pedestrian([0.0, 0.0], [12.0, 0.0]), pedestrian([12.0, 0.0], [0.0, 0.0]));
        let mut nearest_m = f32::MAX;
        for _ in 0..400 {
            if a.has_arrived() || b.has_arrived() {
                break;
            }
            let push = |w: &Pedestrian, other: &Pedestrian| {
                let (drive, away) = (w.drive_mps2(false), w.repulsion_mps2(other));
                [drive[0] + away[0], drive[1] + away[1]]
            };
            let (pa, pb) = (push(&a, &b), push(&b, &a));
            a.advance(pa, 0.04);
            b.advance(pb, 0.04);
            nearest_m =
                nearest_m.min((a.position_m[0] - b.position_m[0]).hypot(a.position_m[1] - b.position_m[1]));
        }
        assert!(a.has_arrived() || b.has_arrived(), "{a:?} {b:?}");
        assert!((0.4..1.5).contains(&nearest_m), "{nearest_m}");
    }
}
