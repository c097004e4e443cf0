//! All agents of the scene, and one step of time.

use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::layout::{Kind, Layout, Turn};
use super::path::{Point, Pose};
use super::pedestrian::{BODY_M, Pedestrian};
use super::right_of_way::{among_users_mps2, take_turns};
use super::road_user::{BRAKING_MAX_MPS2, RoadUser};
use super::yielding::{avoid, for_pedestrians_mps2, may_step_out};

/// Maximum number of vehicles in the lanes before queues fill them.
const VEHICLES_MAX: usize = 22;
/// Maximum number of cyclists in the lanes.
const CYCLISTS_MAX: usize = 14;
/// Length of free lane that an entering user needs.
const ENTRY_GAP_M: f32 = 9.0;
/// Number of entrances that are tried for one user per step.
const ENTRY_TRIES: usize = 8;

/// Target numbers of agents, by kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Population {
    pub(super) agents: usize,
    pub(super) vehicles: usize,
    pub(super) cyclists: usize,
}

impl Population {
    /// Splits the agents by share. Agents beyond the lanes' capacity become pedestrians.
    pub(super) fn split(agents: usize, vehicle_share: f32, cyclist_share: f32) -> Self {
        let part = |share: f32| (agents as f32 * share).round() as usize;
        let vehicles = part(vehicle_share).min(VEHICLES_MAX);
        let cyclists = part(cyclist_share).min(CYCLISTS_MAX).min(agents - vehicles);
        Self { agents, vehicles, cyclists }
    }
}

/// The moving scene without a sensor.
#[derive(Clone, Debug)]
pub(super) struct Traffic {
    pub(super) users: Vec<RoadUser>,
    pub(super) pedestrians: Vec<Pedestrian>,
    layout: Layout,
    population: Population,
    rng: ChaCha8Rng,
    now_s: f64,
    /// Number of users that ever entered the intersection.
    going_count: u64,
    /// Number of agents that ever entered the scene, which is also the last id.
    entered_count: u64,
    /// Scratch: the accelerations of this step.
    user_mps2: Vec<f32>,
    pedestrian_mps2: Vec<Point>,
    poses: Vec<Pose>,
}

impl Traffic {
    pub(super) fn new(population: Population, seed: u64) -> Self {
        Self {
            users: Vec::new(),
            pedestrians: Vec::new(),
            layout: Layout::new(),
            population,
            rng: ChaCha8Rng::seed_from_u64(seed),
            now_s: 0.0,
            going_count: 0,
            entered_count: 0,
            user_mps2: Vec::new(),
            pedestrian_mps2: Vec::new(),
            poses: Vec::new(),
        }
    }

    pub(super) fn pose(&self, user: &RoadUser) -> Pose {
        user.pose(&self.layout.routes[user.route])
    }

    /// Advances all agents by `dt_s`. Agents at the end of their routes leave, and others enter instead.
    pub(super) fn step(&mut self, dt_s: f32) {
        self.now_s += f64::from(dt_s);
        take_turns(&mut self.users, &self.layout, self.now_s, &mut self.going_count);
        self.step_out();
        self.decide(dt_s);
        for (user, &mps2) in self.users.iter_mut().zip(&self.user_mps2) {
            user.advance(mps2, dt_s);
        }
        for (pedestrian, &mps2) in self.pedestrians.iter_mut().zip(&self.pedestrian_mps2) {
            pedestrian.advance(mps2, dt_s);
        }
        let routes = &self.layout.routes;
        self.users.retain(|user| user.along_m < routes[user.route].path.length_m());
        self.pedestrians.retain(|pedestrian| !pedestrian.has_arrived());
        self.fill();
    }

    fn step_out(&mut self) {
        let free = [0, 1, 2, 3].map(|arm| may_step_out(arm, &self.users, &self.layout));
        for pedestrian in &mut self.pedestrians {
            if pedestrian.waits_for().is_some_and(|arm| free[arm]) {
                pedestrian.step_on_crossing();
            }
        }
    }

    /// Each agent chooses an acceleration from the present state of all others.
    fn decide(&mut self, dt_s: f32) {
        self.poses.clear();
        self.poses.extend(self.users.iter().map(|user| user.pose(&self.layout.routes[user.route])));
        self.user_mps2.clear();
        for i in 0..self.users.len() {
            let among_users = among_users_mps2(i, &self.users, &self.layout);
            let for_pedestrians = for_pedestrians_mps2(&self.users[i], &self.pedestrians, &self.layout);
            let user = &mut self.users[i];
            let yields = for_pedestrians.is_some_and(|mps2| mps2 < 0.5);
            user.note_yielding(yields, dt_s);
            let mps2 = among_users.min(for_pedestrians.unwrap_or(f32::INFINITY));
            self.user_mps2.push(mps2.max(-BRAKING_MAX_MPS2));
        }
        self.pedestrian_mps2.clear();
        for i in 0..self.pedestrians.len() {
            let mps2 = self.pedestrian_acceleration(i);
            self.pedestrian_mps2.push(mps2);
        }
    }

    fn pedestrian_acceleration(&self, i: usize) -> Point {
        let pedestrian = &self.pedestrians[i];
        let mut sum = [0.0; 2];
        let mut holds = false;
        if pedestrian.on_crossing().is_some() {
            let near =
                self.users.iter().zip(&self.poses).filter_map(|(user, pose)| avoid(pedestrian, user, *pose));
            for avoidance in near {
                holds |= avoidance.holds;
                sum = added(sum, avoidance.acceleration_mps2);
            }
        }
        let others = self.pedestrians.iter().enumerate().filter(|(j, _)| *j != i);
        sum = others.fold(sum, |sum, (_, other)| added(sum, pedestrian.repulsion_mps2(other)));
        added(sum, pedestrian.drive_mps2(holds))
    }

    /// Lets agents enter until the target numbers are reached, if the entrances are free.
    fn fill(&mut self) {
        for (kind, wanted) in
            [(Kind::Vehicle, self.population.vehicles), (Kind::Cyclist, self.population.cyclists)]
        {
            let mut len = self.users.iter().filter(|user| user.kind == kind).count();
            while len < wanted && self.len() < self.population.agents && self.enter_user(kind) {
                len += 1;
            }
        }
        let pedestrians_min = self.population.agents - self.population.vehicles - self.population.cyclists;
        while self.len() < self.population.agents
            && self.pedestrians.len() < pedestrians_min
            && self.enter_pedestrian()
        {}
    }

    fn len(&self) -> usize {
        self.users.len() + self.pedestrians.len()
    }

    fn enter_user(&mut self, kind: Kind) -> bool {
        for _ in 0..ENTRY_TRIES {
            let from_arm = self.rng.random_range(0..4);
            let turn = Turn::ALL[self.rng.random_range(0..Turn::ALL.len())];
            let route = Layout::route(kind, from_arm, turn);
            let mut user = RoadUser::new(self.entered_count + 1, kind, route, &mut self.rng);
            let lane = |other: &&RoadUser| {
                other.kind == kind && self.layout.routes[other.route].from_arm == from_arm
            };
            let last = self.users.iter().filter(lane).min_by(|a, b| a.along_m.total_cmp(&b.along_m));
            let gap_m = last.map_or(f32::INFINITY, |other| other.rear_m() - user.front_m());
            if gap_m > ENTRY_GAP_M {
                let reserve_m = gap_m - ENTRY_GAP_M + 3.0;
                let leader_mps = last.map_or(0.0, |other| other.speed_mps);
                let safe_mps = (leader_mps.powi(2) + 2.0 * 1.5 * reserve_m).sqrt();
                user.speed_mps = user.wanted_mps(&self.layout.routes[route]).min(safe_mps);
                self.users.push(user);
                self.entered_count += 1;
                return true;
            }
        }
        false
    }

    fn enter_pedestrian(&mut self) -> bool {
        for _ in 0..ENTRY_TRIES {
            let pedestrian = Pedestrian::new(self.entered_count + 1, &mut self.rng);
            let [x, y] = pedestrian.position_m;
            let near = |p: Point| (p[0] - x).hypot(p[1] - y) < 4.0 * BODY_M;
            if !self.pedestrians.iter().any(|other| near(other.position_m)) {
                self.pedestrians.push(pedestrian);
                self.entered_count += 1;
                return true;
            }
        }
        false
    }
}

fn added(a: Point, b: Point) -> Point {
    [a[0] + b[0], a[1] + b[1]]
}
