//! A driver or cyclist: temper, position on the route, and the intelligent-driver model.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use wire::AgentType;

use super::layout::{Kind, Route};
use super::path::Pose;

/// Hardest braking, in an emergency.
pub(super) const BRAKING_MAX_MPS2: f32 = 7.0;
/// Longest counted wait for pedestrians: a little more than the time after which pedestrians give way.
const YIELDED_MAX_S: f32 = 7.0;
/// Hardest braking outside emergencies.
const EASING_MPS2: f32 = 2.0;

/// Parameters of a driver.
#[derive(Clone, Copy, Debug)]
pub(super) struct Temper {
    /// Desired speed as a share of the path's speed.
    pub(super) speed_share: f32,
    /// Largest desired speed.
    pub(super) speed_max_mps: f32,
    pub(super) acceleration_mps2: f32,
    pub(super) braking_mps2: f32,
    pub(super) headway_s: f32,
    /// Gap to a standing leader.
    pub(super) standstill_m: f32,
}

/// A vehicle or cyclist on its route.
#[derive(Clone, Debug)]
pub(super) struct RoadUser {
    pub(super) id: u64,
    pub(super) kind: Kind,
    /// Number of the route in the layout.
    pub(super) route: usize,
    /// Distance of the user's middle from the route's start.
    pub(super) along_m: f32,
    /// Constant distance to the left of the lane's middle.
    pub(super) aside_m: f32,
    pub(super) speed_mps: f32,
    pub(super) acceleration_mps2: f32,
    pub(super) length_m: f32,
    pub(super) width_m: f32,
    pub(super) temper: Temper,
    pub(super) turn_taking: TurnTaking,
    /// Whether pedestrians block the route.
    pub(super) yields: bool,
    /// Time for which pedestrians have kept the user waiting.
    pub(super) yielded_s: f32,
    /// Time for which the user has stood still.
    pub(super) stood_s: f32,
}

/// The state of a user in the order of entering the intersection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum TurnTaking {
    /// Too far away to claim a turn.
    Far,
    /// Waits for its turn since about this time. The earliest claim goes first.
    Waiting { claim_s: f64 },
    /// Has entered the intersection as number `order`. It gets its claim back if it loses its turn.
    Going { order: u64, claim_s: f64 },
}

impl RoadUser {
    /// A user at the start of its route.
    pub(super) fn new(id: u64, kind: Kind, route: usize, rng: &mut ChaCha8Rng) -> Self {
        let (length_m, width_m) = size_m(kind, rng);
        let temper = Temper::drawn(kind, rng);
        let aside_m = drawn(rng, 0.0, 0.12, 0.3);
        Self {
            id,
            kind,
            route,
            along_m: 0.0,
            aside_m,
            speed_mps: 0.0,
            acceleration_mps2: 0.0,
            length_m,
            width_m,
            temper,
            turn_taking: TurnTaking::Far,
            yields: false,
            yielded_s: 0.0,
            stood_s: 0.0,
        }
    }

    pub(super) fn agent_type(&self) -> AgentType {
        match self.kind {
            Kind::Vehicle => AgentType::Vehicle,
            Kind::Cyclist => AgentType::Cyclist,
        }
    }

    pub(super) fn front_m(&self) -> f32 {
        self.along_m + self.length_m / 2.0
    }

    pub(super) fn rear_m(&self) -> f32 {
        self.along_m - self.length_m / 2.0
    }

    pub(super) fn pose(&self, route: &Route) -> Pose {
        route.path.pose(self.along_m, self.aside_m)
    }

    /// The user's desired speed at its position.
    pub(super) fn wanted_mps(&self, route: &Route) -> f32 {
        (route.path.speed_mps(self.along_m) * self.temper.speed_share).min(self.temper.speed_max_mps)
    }

    /// Acceleration on a free road (intelligent-driver model).
    pub(super) fn free_mps2(&self, wanted_mps: f32) -> f32 {
        let share = self.speed_mps / wanted_mps.max(0.1);
        (self.temper.acceleration_mps2 * (1.0 - share.powi(4))).max(-EASING_MPS2)
    }

    /// Acceleration behind a leader `gap_m` ahead (intelligent-driver model).
    pub(super) fn following_mps2(&self, wanted_mps: f32, gap_m: f32, leader_mps: f32) -> f32 {
        let Temper { headway_s, standstill_m, .. } = self.temper;
        self.interaction_mps2(wanted_mps, gap_m, leader_mps, standstill_m, headway_s)
    }

    /// Acceleration towards a stop `gap_m` ahead. The user stops closer and with less reserve than behind a
    /// leader.
    pub(super) fn stopping_mps2(&self, wanted_mps: f32, gap_m: f32) -> f32 {
        self.interaction_mps2(wanted_mps, gap_m, 0.0, 0.3, 0.4)
    }

    fn interaction_mps2(
        &self,
        wanted_mps: f32,
        gap_m: f32,
        other_mps: f32,
        still_m: f32,
        time_s: f32,
    ) -> f32 {
        let Temper { acceleration_mps2: most, braking_mps2: comfortable, .. } = self.temper;
        let closing = self.speed_mps * (self.speed_mps - other_mps) / (2.0 * (most * comfortable).sqrt());
        let desired_m = still_m + (self.speed_mps * time_s + closing).max(0.0);
        let free = (self.speed_mps / wanted_mps.max(0.1)).powi(4).min(2.0);
        let mps2 = most * (1.0 - free - (desired_m / gap_m.max(0.1)).powi(2));
        mps2.max(-BRAKING_MAX_MPS2)
    }

    /// Shortest time in which the user covers a distance; 0 for distances behind it.
    pub(super) fn time_to_cover_s(&self, distance_m: f32, cruise_mps: f32) -> f32 {
        let distance_m = distance_m.max(0.0);
        let (speed, most) = (self.speed_mps, self.temper.acceleration_mps2);
        let cruise_mps = cruise_mps.max(speed);
        let until_cruise_m = (cruise_mps * cruise_mps - speed * speed) / (2.0 * most);
        if distance_m <= until_cruise_m {
            ((speed * speed + 2.0 * most * distance_m).sqrt() - speed) / most
        } else {
            (cruise_mps - speed) / most + (distance_m - until_cruise_m) / cruise_mps
        }
    }

    /// Counts the time for which pedestrians keep the user waiting. The count falls as fast as it rises.
    pub(super) fn note_yielding(&mut self, yields: bool, dt_s: f32) {
        let change = if yields && self.speed_mps < 0.5 { dt_s } else { -dt_s };
        self.yielded_s = (self.yielded_s + change).clamp(0.0, YIELDED_MAX_S);
        self.yields = yields;
    }

    /// Advances the user by one step. It never reverses.
    pub(super) fn advance(&mut self, acceleration_mps2: f32, dt_s: f32) {
        // Jerk is limited except in hard braking, so that vehicles do not pitch at every decision.
        let jerk_mps3 = if acceleration_mps2 < -3.0 { 60.0 } else { 8.0 };
        let change = (acceleration_mps2 - self.acceleration_mps2).clamp(-jerk_mps3 * dt_s, jerk_mps3 * dt_s);
        let wanted = self.acceleration_mps2 + change;
        let speed_mps = (self.speed_mps + wanted * dt_s).max(0.0);
        self.acceleration_mps2 = (speed_mps - self.speed_mps) / dt_s;
        self.along_m += 0.5 * (speed_mps + self.speed_mps) * dt_s;
        self.speed_mps = speed_mps;
        self.stood_s = if speed_mps < 0.1 { self.stood_s + dt_s } else { 0.0 };
    }
}

impl Temper {
    fn drawn(kind: Kind, rng: &mut ChaCha8Rng) -> Self {
        match kind {
            Kind::Vehicle => Self {
                speed_share: drawn(rng, 0.95, 0.08, 0.15),
                speed_max_mps: 13.0,
                acceleration_mps2: drawn(rng, 1.8, 0.2, 0.5),
                braking_mps2: drawn(rng, 2.0, 0.2, 0.5),
                headway_s: drawn(rng, 1.3, 0.2, 0.4),
                standstill_m: drawn(rng, 2.0, 0.3, 0.6),
            },
            Kind::Cyclist => Self {
                speed_share: drawn(rng, 0.95, 0.05, 0.1),
                speed_max_mps: drawn(rng, 4.6, 0.8, 1.6),
                acceleration_mps2: drawn(rng, 1.0, 0.1, 0.3),
                braking_mps2: drawn(rng, 1.8, 0.2, 0.4),
                headway_s: drawn(rng, 0.9, 0.1, 0.3),
                standstill_m: drawn(rng, 1.0, 0.2, 0.4),
            },
        }
    }
}

/// A normal draw that stays within `mean ± most`.
pub(super) fn drawn(rng: &mut ChaCha8Rng, mean: f32, sigma: f32, most: f32) -> f32 {
    let normal = Normal::new(mean, sigma).expect("sigma is positive");
    normal.sample(rng).clamp(mean - most, mean + most)
}

fn size_m(kind: Kind, rng: &mut ChaCha8Rng) -> (f32, f32) {
    match kind {
        Kind::Vehicle if rng.random_bool(0.12) => (drawn(rng, 5.6, 0.3, 0.5), drawn(rng, 2.0, 0.04, 0.08)),
        Kind::Vehicle => (drawn(rng, 4.4, 0.25, 0.6), drawn(rng, 1.82, 0.05, 0.12)),
        Kind::Cyclist => (drawn(rng, 1.8, 0.05, 0.1), drawn(rng, 0.6, 0.04, 0.08)),
    }
}
