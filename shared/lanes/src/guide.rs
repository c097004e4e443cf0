//! Forecasts along lanes: each path follows its nearest route at the path's own speed.

use std::sync::Arc;

use wire::{AgentType, HORIZON_MAX, MODES_MAX};

use crate::corridor::{Corridor, Scratch};
use crate::routes::{ROUTE_POINTS_MAX, ROUTE_STEP_M, ROUTES_MAX};
use crate::{LaneMap, Routes};

/// Positions of a forecast, step by step.
pub type GuidedPath = [[f32; 2]; HORIZON_MAX];

/// Time after which a path is entirely on its route. Before that the share grows linearly, because an agent's
/// own motion predicts the next second better than its lane does.
const WHOLLY_S: f32 = 5.0;
/// Mean distance between a path and its route at which the path follows the route with weight exp(−½).
const OFF_ROAD_M: f32 = 6.0;
/// A mode's vote for a route falls to exp(−½) if the route is this much farther than the nearest one.
const VOTE_M: f32 = 1.0;
/// The same for the best forecast.
const BEST_M: f32 = 1.5;
/// Distance by which routes extend beyond the longest forecast.
const BEYOND_M: f32 = 15.0;

/// Moves the forecasts of one agent after another onto its lanes. The scratch memory is allocated once.
#[derive(Clone, Debug)]
pub struct LaneGuide {
    map: Arc<LaneMap>,
    routes: Routes,
    corridors: Vec<Corridor>,
    scratch: Scratch,
    /// Share of the modes' probability that votes for each route.
    votes: [f32; ROUTES_MAX],
}

/// The properties of an agent that lanes need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guided {
    /// The type.
    pub agent_type: AgentType,
    /// The position in the world frame.
    pub position_m: [f32; 2],
    /// The heading.
    pub heading_rad: f32,
    /// The length of a step.
    pub step_s: f32,
}

/// The line that an agent would drive along a route.
#[derive(Clone, Copy, Debug)]
pub struct LaneLine<'a> {
    corridor: &'a Corridor,
    /// Mean distance from the path for which it was chosen.
    pub apart_m: f32,
}

impl LaneLine<'_> {
    /// Its points, and the length up to each.
    #[must_use]
    pub fn points(&self) -> (&[[f32; 2]], &[f32]) {
        self.corridor.points()
    }

    /// The speed that the line permits at each of its points: bends limit it.
    #[must_use]
    pub fn speeds_mps(&self) -> [f32; ROUTE_POINTS_MAX] {
        let mut speeds_mps = [f32::INFINITY; ROUTE_POINTS_MAX];
        self.corridor.speeds_mps(&mut speeds_mps);
        speeds_mps
    }

    /// Writes the points at increasing lengths. Beyond the end the line is straight.
    pub fn at(&self, lengths_m: &[f32], out: &mut [[f32; 2]]) {
        self.corridor.at(lengths_m, out);
    }
}

impl LaneGuide {
    /// A guide along the lanes of a map.
    #[must_use]
    pub fn new(map: Arc<LaneMap>) -> Self {
        let corridors = (0..ROUTES_MAX).map(|_| Corridor::with_room()).collect();
        let (routes, scratch) = (Routes::default(), Scratch::default());
        Self { map, routes, corridors, scratch, votes: [0.0; ROUTES_MAX] }
    }

    /// Moves the paths of an agent's modes and of its single best forecast onto its routes. Returns `false`
    /// and changes nothing if the agent is on no lane. Does not allocate.
    ///
    /// ```text
    /// mode m      p' = p + s_k g(D_mr) (c_r(ℓ_k) − p)        r the nearest route, ℓ_k the length of p up to k
    /// best        p' = p + s_k g(D_r) (Σ w_r c_r(ℓ_k) − p)   w_r ∝ π_r exp(−½ D_r²/1.5²)
    /// votes       π_r = Σ_m P_m exp(−½ (D_mr − D_m)²)        normalised to sum to 1 over r for each m
    /// ```
    ///
    /// * c_r is the line that the agent would drive along route r.
    /// * D is the mean distance between a path and a line at equal lengths. D_m is the distance of the
    ///   nearest route.
    /// * g(D) = exp(−½ D²/6²).
    /// * s_k = t_k / 5 s, at most 1.
    ///
    /// # Panics
    /// If there are more modes or longer paths than a payload can hold, or if the numbers of modes and
    /// probabilities differ.
    pub fn guide(
        &mut self,
        agent: &Guided,
        horizon_len: usize,
        modes: &mut [GuidedPath],
        probability: &[f32],
        best: &mut GuidedPath,
    ) -> bool {
        assert!(modes.len() <= MODES_MAX && horizon_len <= HORIZON_MAX, "{} modes", modes.len());
        assert_eq!(modes.len(), probability.len(), "a probability for each mode");
        let start_m = agent.position_m;
        let longest_m = modes.iter().chain([&*best]).fold(0.0_f32, |most, path| {
            most.max(lengths_m(start_m, &path[..horizon_len])[..horizon_len].last().copied().unwrap_or(0.0))
        });
        if !longest_m.is_finite() {
            return false;
        }
        let reach_m = (longest_m + BEYOND_M).min((ROUTE_POINTS_MAX - 2) as f32 * ROUTE_STEP_M);
        self.routes.find(&self.map, agent.agent_type, start_m, agent.heading_rad, reach_m);
        let route_count = self.routes.as_slice().len();
        if route_count == 0 {
            return false;
        }
        for (route, corridor) in self.routes.as_slice().iter().zip(&mut self.corridors) {
            corridor.draw(route, start_m, &mut self.scratch);
        }
        let shares: [f32; HORIZON_MAX] =
            std::array::from_fn(|step| ((step + 1) as f32 * agent.step_s / WHOLLY_S).min(1.0));
        self.votes = [0.0; ROUTES_MAX];
        for (mode, probability) in modes.iter_mut().zip(probability) {
            let (lines, apart_m) = self.lines(start_m, &mode[..horizon_len]);
            let nearest = nearest(&apart_m[..route_count]);
            let vote = |route: usize| (-0.5 * ((apart_m[route] - apart_m[nearest]) / VOTE_M).powi(2)).exp();
            let sum: f32 = (0..route_count).map(vote).sum();
            (0..route_count).for_each(|route| self.votes[route] += probability * vote(route) / sum);
            follow(&mut mode[..horizon_len], &lines[nearest], off_road(apart_m[nearest]), &shares);
        }
        let (lines, apart_m) = self.lines(start_m, &best[..horizon_len]);
        let nearest = nearest(&apart_m[..route_count]);
        let least = apart_m[nearest] * apart_m[nearest];
        let weight = |route: usize| {
            let farther = apart_m[route] * apart_m[route] - least;
            self.votes[route] * (-0.5 * farther / (BEST_M * BEST_M)).exp()
        };
        let sum: f32 = (0..route_count).map(weight).sum();
        let mut line = lines[nearest];
        if sum > f32::MIN_POSITIVE {
            for (step, point) in line.iter_mut().enumerate().take(horizon_len) {
                *point = [0, 1].map(|axis| {
                    (0..route_count).map(|route| weight(route) / sum * lines[route][step][axis]).sum()
                });
            }
        }
        follow(&mut best[..horizon_len], &line, off_road(apart_m[nearest]), &shares);
        true
    }

    /// The line nearest to a path of the agent that was [guided](LaneGuide::guide) last.
    #[must_use]
    pub fn nearest(&self, start_m: [f32; 2], path: &[[f32; 2]]) -> Option<LaneLine<'_>> {
        let route_count = self.routes.as_slice().len();
        let (_, apart_m) = self.lines(start_m, path);
        let place = (route_count > 0).then(|| nearest(&apart_m[..route_count]))?;
        Some(LaneLine { corridor: &self.corridors[place], apart_m: apart_m[place] })
    }

    /// The routes' lines at the lengths of a path, and the mean distance between each line and the path.
    fn lines(&self, start_m: [f32; 2], path: &[[f32; 2]]) -> ([GuidedPath; ROUTES_MAX], [f32; ROUTES_MAX]) {
        let lengths_m = lengths_m(start_m, path);
        let mut lines = [[[0.0; 2]; HORIZON_MAX]; ROUTES_MAX];
        let mut apart_m = [f32::INFINITY; ROUTES_MAX];
        let route_count = self.routes.as_slice().len();
        for ((corridor, line), apart_m) in
            self.corridors[..route_count].iter().zip(&mut lines).zip(&mut apart_m)
        {
            corridor.at(&lengths_m[..path.len()], line);
            let sum: f32 = path.iter().zip(&*line).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
            *apart_m = sum / path.len().max(1) as f32;
        }
        (lines, apart_m)
    }
}

/// The weight with which a path follows a route at this distance.
fn off_road(apart_m: f32) -> f32 {
    (-0.5 * (apart_m / OFF_ROAD_M).powi(2)).exp()
}

fn follow(path: &mut [[f32; 2]], line: &GuidedPath, part: f32, shares: &[f32; HORIZON_MAX]) {
    for ((point, on_line), share) in path.iter_mut().zip(line).zip(shares) {
        *point = [0, 1].map(|axis| point[axis] + share * part * (on_line[axis] - point[axis]));
    }
}

/// The place of the smallest distance, the first among equals.
fn nearest(apart_m: &[f32]) -> usize {
    let places = apart_m.iter().copied().enumerate();
    places.reduce(|least, other| if other.1 < least.1 { other } else { least }).map_or(0, |(place, _)| place)
}

/// Length of a path up to each of its points.
fn lengths_m(start_m: [f32; 2], path: &[[f32; 2]]) -> [f32; HORIZON_MAX] {
    let mut lengths_m = [0.0; HORIZON_MAX];
    let (mut from, mut sum_m) = (start_m, 0.0);
    for (point, length_m) in path.iter().zip(&mut lengths_m) {
        sum_m += (point[0] - from[0]).hypot(point[1] - from[1]);
        (*length_m, from) = (sum_m, *point);
    }
    lengths_m
}
