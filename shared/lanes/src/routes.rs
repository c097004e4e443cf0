//! Routes of an agent along the lanes that it can reach.

use wire::AgentType;

use crate::{Lane, LaneMap};

/// Maximum number of routes of an agent.
pub const ROUTES_MAX: usize = 16;
/// Maximum number of points of a route.
pub const ROUTE_POINTS_MAX: usize = 200;
/// Distance between the points along a route.
pub const ROUTE_STEP_M: f32 = 1.0;
/// Maximum number of lanes that match one agent.
const STARTS_MAX: usize = 12;
/// Maximum number of lanes of a route.
const ROUTE_LANES_MAX: usize = 48;
/// Maximum number of lanes examined in the cells around an agent.
const NEAR_MAX: usize = 256;
/// Reach of this search.
const NEAR_M: f32 = 6.0;
/// Distance beyond the bounds of a lane up to which an agent is still on the lane.
const BESIDE_M: f32 = 1.0;
/// Largest angle between an agent's heading and its lane.
const ANGLE_MAX_RAD: f32 = 1.0;
/// Routes that are never farther apart than this count as one.
const SAME_M: f32 = 1.0;

/// A path along lanes that starts beside the agent.
#[derive(Clone, Debug, Default)]
pub struct Route {
    /// Points [`ROUTE_STEP_M`] apart. The route is straight beyond the end of the map.
    pub points_m: Vec<[f32; 2]>,
    /// Half of the width at each point.
    pub half_width_m: Vec<f32>,
    /// Offset of the agent to the left of the first point.
    pub offset_m: f32,
    /// Heading of the agent relative to the route, positive to the left.
    pub turn_rad: f32,
    /// Places of the lanes that the route passes through.
    pub lanes: Vec<u32>,
}

/// The routes of one agent after another, with scratch memory allocated once.
#[derive(Clone, Debug)]
pub struct Routes {
    routes: Vec<Route>,
    len: usize,
    near: Vec<u32>,
    starts: Vec<Start>,
    stack: Vec<(u32, u32)>,
    lanes: Vec<u32>,
}

/// A lane that an agent is on.
#[derive(Clone, Copy, Debug)]
struct Start {
    lane: u32,
    along_m: f32,
    offset_m: f32,
    turn_rad: f32,
    cost: f32,
}

impl Default for Routes {
    fn default() -> Self {
        let route = || Route {
            points_m: Vec::with_capacity(ROUTE_POINTS_MAX),
            half_width_m: Vec::with_capacity(ROUTE_POINTS_MAX),
            lanes: Vec::with_capacity(ROUTE_LANES_MAX),
            ..Route::default()
        };
        Self {
            routes: (0..ROUTES_MAX).map(|_| route()).collect(),
            len: 0,
            near: Vec::with_capacity(NEAR_MAX),
            starts: Vec::with_capacity(3 * NEAR_MAX),
            stack: Vec::with_capacity(4 * ROUTE_LANES_MAX),
            lanes: Vec::with_capacity(ROUTE_LANES_MAX),
        }
    }
}

impl Routes {
    /// The most recently found routes, best matching lanes first.
    pub fn as_slice(&self) -> &[Route] {
        &self.routes[..self.len]
    }

    /// Finds up to [`ROUTES_MAX`] routes of an agent over `reach_m`. Does not allocate.
    pub fn find(
        &mut self,
        map: &LaneMap,
        agent_type: AgentType,
        position_m: [f32; 2],
        heading_rad: f32,
        reach_m: f32,
    ) {
        self.len = 0;
        let point_count = ((reach_m / ROUTE_STEP_M).ceil() as usize + 2).clamp(2, ROUTE_POINTS_MAX);
        map.near(position_m, NEAR_M, &mut self.near);
        self.match_lanes(map, agent_type, position_m, heading_rad);
        for place in 0..self.starts.len() {
            self.follow(map, self.starts[place], point_count);
        }
    }

    /// Finds the lanes that the agent is on and the lanes that it may change to, best first.
    fn match_lanes(&mut self, map: &LaneMap, agent_type: AgentType, position_m: [f32; 2], heading_rad: f32) {
        let Self { near, starts, .. } = self;
        starts.clear();
        let lanes = map.lanes();
        for &lane in &*near {
            let Some(start) = Start::on(lanes, lane, agent_type, position_m, heading_rad) else { continue };
            starts.push(start);
        }
        let on_count = starts.len();
        for place in 0..on_count {
            for neighbour in lanes[starts[place].lane as usize].neighbours.into_iter().flatten() {
                if starts.iter().any(|start| start.lane == neighbour) || starts.len() == starts.capacity() {
                    continue;
                }
                let there = Start::on_neighbour(lanes, neighbour, agent_type, position_m, heading_rad);
                starts.extend(there);
            }
        }
        starts.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.lane.cmp(&b.lane)));
        starts.truncate(STARTS_MAX);
    }

    /// Adds the routes that begin on a lane.
    fn follow(&mut self, map: &LaneMap, start: Start, point_count: usize) {
        let lanes = map.lanes();
        let reach_m = point_count as f32 * ROUTE_STEP_M;
        self.stack.clear();
        self.stack.push((start.lane, 0));
        self.lanes.clear();
        // Depth first. `lanes` is the current branch.
        while let Some((lane, depth)) = self.stack.pop() {
            if self.len == ROUTES_MAX {
                return;
            }
            self.lanes.truncate(depth as usize);
            self.lanes.push(lane);
            let length_m: f32 = self.lanes.iter().map(|&lane| lanes[lane as usize].length_m()).sum();
            let next = &lanes[lane as usize].successors;
            let is_whole = length_m - start.along_m >= reach_m || self.lanes.len() == ROUTE_LANES_MAX;
            if is_whole || next.is_empty() || self.stack.len() + next.len() > self.stack.capacity() {
                self.add(lanes, start, point_count);
            } else {
                self.stack.extend(next.iter().rev().map(|&next| (next, depth + 1)));
            }
        }
    }

    /// Adds the route through `lanes`, unless a similar one exists.
    fn add(&mut self, lanes: &[Lane], start: Start, point_count: usize) {
        let (routes, route) = self.routes.split_at_mut(self.len);
        let route = &mut route[0];
        (route.offset_m, route.turn_rad) = (start.offset_m, start.turn_rad);
        route.lanes.clear();
        route.lanes.extend_from_slice(&self.lanes);
        route.draw(lanes, start.along_m, point_count);
        let apart = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let is_same = |other: &Route| {
            let pairs = other.points_m.iter().zip(&route.points_m).step_by(4);
            pairs.fold(0.0_f32, |most, (a, b)| most.max(apart(*a, *b))) <= SAME_M
        };
        if !routes.iter().any(is_same) {
            self.len += 1;
        }
    }
}

impl Route {
    /// Writes the points along the route's lanes.
    fn draw(&mut self, lanes: &[Lane], from_m: f32, point_count: usize) {
        let Self { points_m, half_width_m, lanes: through, .. } = self;
        points_m.clear();
        half_width_m.clear();
        // `passed_m` is the total length of the previous lanes.
        let (mut passed_m, mut direction, mut half_m) = (-from_m, [1.0, 0.0], 0.0);
        for &lane in &*through {
            let lane = &lanes[lane as usize];
            let segments = lane.centre_m.windows(2).zip(lane.along_m.windows(2));
            for ((segment, along_m), half_widths_m) in segments.zip(lane.half_width_m.windows(2)) {
                let length_m = (along_m[1] - along_m[0]).max(1e-6);
                direction = [0, 1].map(|axis| (segment[1][axis] - segment[0][axis]) / length_m);
                while points_m.len() < point_count {
                    let wanted_m = points_m.len() as f32 * ROUTE_STEP_M - passed_m - along_m[0];
                    if wanted_m > length_m {
                        break;
                    }
                    points_m.push([0, 1].map(|axis| segment[0][axis] + wanted_m * direction[axis]));
                    let part = wanted_m / length_m;
                    half_m = half_widths_m[0] + part * (half_widths_m[1] - half_widths_m[0]);
                    half_width_m.push(half_m);
                }
            }
            passed_m += lane.length_m();
        }
        while points_m.len() < point_count {
            let beyond_m = points_m.len() as f32 * ROUTE_STEP_M - passed_m;
            let end = through.last().and_then(|&lane| lanes[lane as usize].centre_m.last());
            let end = end.copied().unwrap_or_default();
            points_m.push([0, 1].map(|axis| end[axis] + beyond_m * direction[axis]));
            half_width_m.push(half_m);
        }
    }
}

impl Start {
    /// Places the agent on a lane; `None` if the agent is not on it.
    fn on(
        lanes: &[Lane],
        place: u32,
        agent_type: AgentType,
        position_m: [f32; 2],
        heading_rad: f32,
    ) -> Option<Self> {
        let (start, half_width_m, is_beyond) = Self::measure(lanes, place, position_m, heading_rad)?;
        let lane = &lanes[place as usize];
        let is_on = !is_beyond
            && lane.users.contain(agent_type)
            && start.offset_m.abs() <= half_width_m + BESIDE_M
            && start.turn_rad.abs() <= ANGLE_MAX_RAD;
        is_on.then_some(start)
    }

    /// Places the agent on the lane beside its own.
    fn on_neighbour(
        lanes: &[Lane],
        place: u32,
        agent_type: AgentType,
        position_m: [f32; 2],
        heading_rad: f32,
    ) -> Option<Self> {
        let (start, ..) = Self::measure(lanes, place, position_m, heading_rad)?;
        lanes[place as usize].users.contain(agent_type).then_some(start)
    }

    /// The nearest point of a lane's middle, the half width there, and whether the agent is beyond the lane's
    /// ends.
    fn measure(
        lanes: &[Lane],
        place: u32,
        position_m: [f32; 2],
        heading_rad: f32,
    ) -> Option<(Self, f32, bool)> {
        let lane = &lanes[place as usize];
        let mut best: Option<(f32, usize, f32)> = None;
        for (number, segment) in lane.centre_m.windows(2).enumerate() {
            let along = [0, 1].map(|axis| segment[1][axis] - segment[0][axis]);
            let from = [0, 1].map(|axis| position_m[axis] - segment[0][axis]);
            let square = along[0] * along[0] + along[1] * along[1];
            let share = (from[0] * along[0] + from[1] * along[1]) / square;
            let clipped = share.clamp(0.0, 1.0);
            let apart = [0, 1].map(|axis| from[axis] - clipped * along[axis]);
            let apart = apart[0] * apart[0] + apart[1] * apart[1];
            if best.is_none_or(|(least, ..)| apart < least) {
                best = Some((apart, number, share));
            }
        }
        let (_, number, share) = best?;
        let [a, b] = [lane.centre_m[number], lane.centre_m[number + 1]];
        let length_m = lane.along_m[number + 1] - lane.along_m[number];
        let along = [0, 1].map(|axis| (b[axis] - a[axis]) / length_m.max(1e-6));
        let from = [0, 1].map(|axis| position_m[axis] - a[axis]);
        let offset_m = along[0] * from[1] - along[1] * from[0];
        let turn_rad = scene::turn(along[1].atan2(along[0]), heading_rad);
        let is_beyond = (share < 0.0 && number == 0) || (share > 1.0 && number + 2 == lane.centre_m.len());
        let along_m = lane.along_m[number] + share.clamp(0.0, 1.0) * length_m;
        let cost = offset_m * offset_m + (turn_rad / 0.25) * (turn_rad / 0.25);
        let start = Self { lane: place, along_m, offset_m, turn_rad, cost };
        Some((start, lane.half_width_m[number], is_beyond))
    }
}
