//! The intersection: lanes, crossings, pavements, and the conflicts of routes.
//!
//! Four arms meet at right angles in the origin: arm 0 points east (+x), 1 north, 2 west, 3 south. Traffic
//! keeps right. Each arm has, inbound and outbound, a lane for vehicles, a lane for cyclists and a pavement.
//! Across each arm, near its mouth, is a crossing for pedestrians. Vehicles wait before it. The east-west
//! road has priority.

use std::ops::Range;

use super::path::{Path, Point, curve};

/// Distance from the centre at which agents enter and leave.
pub(super) const ARM_M: f32 = 80.0;
/// Near and far edge of the crossings, from the centre.
pub(super) const CROSSING_M: Range<f32> = 8.5..12.5;
/// The kerb, from the arm's axis.
pub(super) const KERB_M: f32 = 5.4;
/// Distance from the centre at which road users wait for their turn.
const STOP_LINE_M: f32 = 13.3;
/// Paths are closer than the users' widths only within this square around the centre.
const CONFLICTS_WITHIN_M: f32 = 16.0;

/// The kind of road user that uses a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Vehicle,
    Cyclist,
}

impl Kind {
    pub(super) const ALL: [Self; 2] = [Self::Vehicle, Self::Cyclist];

    /// The lane's middle, from the arm's axis.
    const fn lane_m(self) -> f32 {
        match self {
            Self::Vehicle => 1.75,
            Self::Cyclist => 4.4,
        }
    }

    /// Half of the width that a user needs across its path.
    const fn clearance_m(self) -> f32 {
        match self {
            Self::Vehicle => 1.3,
            Self::Cyclist => 0.6,
        }
    }
}

/// A direction of travel over the intersection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Turn {
    Left,
    Straight,
    Right,
}

impl Turn {
    pub(super) const ALL: [Self; 3] = [Self::Left, Self::Straight, Self::Right];
}

/// The whole route of a road user. Important positions are distances from its start.
#[derive(Clone, Debug)]
pub(super) struct Route {
    pub(super) kind: Kind,
    pub(super) from_arm: usize,
    pub(super) to_arm: usize,
    pub(super) turn: Turn,
    pub(super) path: Path,
    /// Position at which the front waits for the user's turn.
    pub(super) stop_line_m: f32,
    /// The crossings that are passed, of the arm of origin and then of the arm of destination.
    pub(super) crossings: [Passage; 2],
}

/// The part of a route on a crossing.
#[derive(Clone, Debug)]
pub(super) struct Passage {
    pub(super) arm: usize,
    /// Distances along the route.
    pub(super) along_m: Range<f32>,
    /// Distances from the arm's axis that the route's middle line covers, positive on the inbound side.
    pub(super) across_m: Range<f32>,
}

/// How two routes (`mine` and `other`) share the road.
#[derive(Clone, Debug)]
pub(super) enum Relation {
    /// They never come close.
    Apart,
    /// They start in the same lane and share it up to this distance.
    SameStart { until_m: f32 },
    /// They end in the same lane and share it from these distances on.
    SameEnd { mine_m: f32, other_m: f32 },
    /// They cross between these distances.
    Cross { mine_m: Range<f32>, other_m: Range<f32> },
}

/// All routes and how they relate.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub(super) routes: Vec<Route>,
    relations: Vec<Relation>,
}

impl Layout {
    pub(super) fn new() -> Self {
        let mut routes = Vec::new();
        for kind in Kind::ALL {
            for from_arm in 0..4 {
                routes.extend(Turn::ALL.map(|turn| Route::new(kind, from_arm, turn)));
            }
        }
        let relations = routes.iter().flat_map(|a| routes.iter().map(|b| relation(a, b))).collect();
        Self { routes, relations }
    }

    /// How route `mine` shares the road with route `other`.
    pub(super) fn relation(&self, mine: usize, other: usize) -> &Relation {
        &self.relations[mine * self.routes.len() + other]
    }

    pub(super) fn route(kind: Kind, from_arm: usize, turn: Turn) -> usize {
        (kind as usize * 4 + from_arm) * Turn::ALL.len() + turn as usize
    }
}

impl Route {
    fn new(kind: Kind, from_arm: usize, turn: Turn) -> Self {
        let lane = kind.lane_m();
        // Start and end of the curve, from the centre. Right turns are tight and use the corner's whole
        // width.
        let mouth = if turn == Turn::Right { CROSSING_M.end - 0.5 } else { CROSSING_M.start };
        let inwards = [-1.0, 0.0];
        let (to_arm, mouth_out, end, outwards) = match turn {
            Turn::Left => (from_arm + 3, [-lane, -mouth], [-lane, -ARM_M], [0.0, -1.0]),
            Turn::Straight => (from_arm + 2, [-mouth, lane], [-ARM_M, lane], inwards),
            Turn::Right => (from_arm + 1, [lane, mouth], [lane, ARM_M], [0.0, 1.0]),
        };
        let mut line = vec![[ARM_M, lane]];
        match turn {
            Turn::Straight => line.push([mouth, lane]),
            Turn::Left | Turn::Right => line.extend(curve([mouth, lane], inwards, mouth_out, outwards)),
        }
        line.push(end);
        let line: Vec<Point> = line.into_iter().map(|point| to_world(from_arm, point)).collect();
        let path = Path::along(&line);
        let to_arm = to_arm % 4;
        let crossings = [passage(&path, from_arm, true), passage(&path, to_arm, false)];
        Self { kind, from_arm, to_arm, turn, stop_line_m: ARM_M - STOP_LINE_M, crossings, path }
    }
}

/// Transforms a point from an arm's own frame (x outwards along the arm) to the world frame.
pub(super) fn to_world(arm: usize, [x, y]: Point) -> Point {
    match arm % 4 {
        0 => [x, y],
        1 => [-y, x],
        2 => [-x, -y],
        _ => [y, -x],
    }
}

/// Transforms a point from the world frame to an arm's own frame.
pub(super) fn to_arm(arm: usize, point: Point) -> Point {
    to_world(4 - arm % 4, point)
}

fn passage(path: &Path, arm: usize, inwards: bool) -> Passage {
    let on_crossing = |point: Point| {
        let [x, y] = to_arm(arm, point);
        CROSSING_M.contains(&x) && y.abs() < KERB_M + 1.0 && (y > 0.0) == inwards
    };
    let on = path.samples().filter(|(_, point)| on_crossing(*point));
    let across = on.clone().map(|(_, point)| to_arm(arm, point)[1]);
    Passage { arm, along_m: hull(on.map(|(along, _)| along)), across_m: hull(across) }
}

fn hull(values: impl Iterator<Item = f32>) -> Range<f32> {
    values.fold(f32::INFINITY..f32::NEG_INFINITY, |range, x| range.start.min(x)..range.end.max(x))
}

fn relation(mine: &Route, other: &Route) -> Relation {
    let lanes_match = mine.kind == other.kind;
    let same_start = lanes_match && mine.from_arm == other.from_arm;
    if same_start && mine.turn == other.turn {
        return Relation::SameStart { until_m: f32::INFINITY };
    }
    let clearance_m = mine.kind.clearance_m() + other.kind.clearance_m();
    let (mine_m, other_m) =
        (near(&mine.path, &other.path, clearance_m), near(&other.path, &mine.path, clearance_m));
    if mine_m.is_empty() {
        Relation::Apart
    } else if same_start {
        Relation::SameStart { until_m: mine_m.end }
    } else if lanes_match && mine.to_arm == other.to_arm {
        Relation::SameEnd { mine_m: mine_m.start, other_m: other_m.start }
    } else {
        Relation::Cross { mine_m, other_m }
    }
}

/// The part of `path` near the centre that is within `clearance_m` of the other path.
fn near(path: &Path, other: &Path, clearance_m: f32) -> Range<f32> {
    let central = |(_, point): &(f32, Point)| point[0].abs().max(point[1].abs()) < CONFLICTS_WITHIN_M;
    let others: Vec<Point> = other.samples().filter(central).map(|(_, point)| point).collect();
    let close = |p: Point| others.iter().any(|q| (p[0] - q[0]).hypot(p[1] - q[1]) < clearance_m);
    hull(path.samples().filter(central).filter(|(_, point)| close(*point)).map(|(along, _)| along))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn relation_of(a: (Kind, usize, Turn), b: (Kind, usize, Turn)) -> Relation {
        let layout = Layout::new();
        let number = |(kind, arm, turn)| Layout::route(kind, arm, turn);
        layout.relation(number(a), number(b)).clone()
    }

    #[test]
    fn route_numbers_lead_to_their_arm() {
        let layout = Layout::new();
        for (i, route) in layout.routes.iter().enumerate() {
            assert_eq!(Layout::route(route.kind, route.from_arm, route.turn), i);
            let start = to_arm(route.from_arm, route.path.pose(0.0, 0.0).position_m);
            let end = to_arm(route.to_arm, route.path.pose(f32::MAX, 0.0).position_m);
            let lane = route.kind.lane_m();
            assert!((start[0] - ARM_M).abs() < 0.6 && (start[1] - lane).abs() < 0.01, "{start:?}");
            assert!((end[0] - ARM_M).abs() < 0.6 && (end[1] + lane).abs() < 0.01, "{end:?}");
            for passage in &route.crossings {
                assert!((passage.along_m.end - passage.along_m.start - 4.0).abs() < 1.2, "{passage:?}");
            }
        }
    }

    #[test]
    fn conflicting_routes_are_related() {
        use Kind::{Cyclist, Vehicle};
        use Turn::{Left, Right, Straight};
        let crosses = |a, b| matches!(relation_of(a, b), Relation::Cross { .. });
        let apart = |a, b| matches!(relation_of(a, b), Relation::Apart);
        assert!(crosses((Vehicle, 0, Straight), (Vehicle, 1, Straight)));
        assert!(crosses((Vehicle, 0, Left), (Vehicle, 2, Straight)), "left turn against oncoming traffic");
        assert!(crosses((Vehicle, 0, Right), (Cyclist, 0, Straight)), "right turn across the cycle lane");
        assert!(apart((Vehicle, 0, Straight), (Vehicle, 2, Straight)));
        assert!(apart((Vehicle, 0, Left), (Vehicle, 2, Left)), "opposite left turns pass each other");
        assert!(apart((Vehicle, 0, Straight), (Cyclist, 0, Straight)));
        let merge = relation_of((Vehicle, 0, Right), (Vehicle, 3, Straight));
        assert!(matches!(merge, Relation::SameEnd { .. }), "{merge:?}");
        let split = relation_of((Vehicle, 0, Right), (Vehicle, 0, Left));
        assert!(matches!(split, Relation::SameStart { until_m } if until_m < ARM_M), "{split:?}");
    }

    #[test]
    fn arm_frames_are_inverses_of_each_other() {
        for arm in 0..4 {
            assert_eq!(to_arm(arm, to_world(arm, [3.0, 1.0])), [3.0, 1.0]);
        }
        assert_eq!(to_world(1, [10.0, 0.0]), [0.0, 10.0], "arm 1 points north");
    }
}
