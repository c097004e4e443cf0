//! Forecasts along lanes.

use std::sync::Arc;

use lanes::{Coordinates, Guided, GuidedPath, LaneGuide, LaneMap, ROUTES_MAX, Routes};
use proptest::prelude::*;
use wire::{AgentType, HORIZON_MAX};

/// The point of a line at a length, with an offset to the left.
type Line = Box<dyn Fn(f64, f64) -> [f64; 2]>;

/// A road to the east, 4 m wide. At x = 40 it forks into a straight branch and a branch that bends left.
fn fork() -> LaneMap {
    let mut text = "<osm>".to_owned();
    let mut ways = String::new();
    let mut lanes = String::new();
    let bent = |s: f64, side: f64| {
        let angle = s / 20.0;
        [40.0 + (20.0 - side) * angle.sin(), 20.0 - (20.0 - side) * angle.cos()]
    };
    let lines: [(i64, Line, f64); 3] = [
        (1, Box::new(|s, side| [s, side]), 40.0),
        (2, Box::new(|s, side| [40.0 + s, side]), 60.0),
        (3, Box::new(bent), 31.4),
    ];
    // Consecutive lanelets share the nodes at their ends.
    let start = |lane: i64, side: usize| if lane == 1 { 100 + side as i64 } else { 200 + side as i64 };
    let mut nodes = std::collections::BTreeMap::new();
    for (lane, at, length_m) in &lines {
        for (side, across) in [2.0, -2.0].into_iter().enumerate() {
            let id = lane * 10 + side as i64;
            ways += &format!("<way id='{id}'>");
            for step in 0..=20_i64 {
                let node = match step {
                    0 => start(*lane, side),
                    20 if *lane == 1 => start(2, side),
                    _ => 10_000 * lane + 100 * side as i64 + step,
                };
                nodes.insert(node, at(length_m * step as f64 / 20.0, across));
                ways += &format!("<nd ref='{node}'/>");
            }
            ways += "</way>";
        }
        lanes += &format!(
            "<relation id='{lane}'><member type='way' role='left' ref='{}'/><member type='way' role='right' \
             ref='{}'/><tag k='type' v='lanelet'/></relation>",
            lane * 10,
            lane * 10 + 1
        );
    }
    for (id, [x, y]) in nodes {
        text += &format!("<node id='{id}'><tag k='local_x' v='{x}'/><tag k='local_y' v='{y}'/></node>");
    }
    text += &(ways + &lanes + "</osm>");
    LaneMap::parse("fork.osm", text.as_bytes(), Coordinates::Default).expect("a good map")
}

/// A path at a constant speed and turn rate.
fn path(start_m: [f32; 2], speed_mps: f32, turn_radps: f32) -> GuidedPath {
    let (mut position, mut heading) = (start_m, 0.0_f32);
    std::array::from_fn(|_| {
        heading += 0.4 * turn_radps;
        position =
            [position[0] + 0.4 * speed_mps * heading.cos(), position[1] + 0.4 * speed_mps * heading.sin()];
        position
    })
}

fn agent(position_m: [f32; 2]) -> Guided {
    Guided { agent_type: AgentType::Vehicle, position_m, heading_rad: 0.0, step_s: 0.4 }
}

fn length_m(start_m: [f32; 2], path: &GuidedPath) -> f32 {
    let from = std::iter::once(start_m).chain(path.iter().copied());
    from.zip(path).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum()
}

#[test]
fn both_branches_of_a_fork_are_routes() {
    let map = fork();
    let mut routes = Routes::default();
    routes.find(&map, AgentType::Vehicle, [20.0, 0.5], 0.0, 60.0);
    let ends: Vec<[f32; 2]> = routes.as_slice().iter().map(|route| route.points_m[60]).collect();
    assert_eq!(ends.len(), 2, "{ends:?}");
    assert!(ends.iter().any(|[x, y]| (x - 80.0).abs() < 1.0 && y.abs() < 0.5), "{ends:?}");
    assert!(ends.iter().any(|[x, y]| (x - 60.0).abs() < 1.5 && *y > 20.0), "{ends:?}");
    assert!((routes.as_slice()[0].offset_m - 0.5).abs() < 1e-4);
    for (agent_type, position_m, heading_rad) in [
        (AgentType::Pedestrian, [20.0, 0.5], 0.0),
        (AgentType::Vehicle, [20.0, 9.0], 0.0),
        (AgentType::Vehicle, [20.0, 0.0], 3.0),
    ] {
        routes.find(&map, agent_type, position_m, heading_rad, 60.0);
        assert!(routes.as_slice().is_empty(), "{agent_type:?} {position_m:?} {heading_rad}");
    }
}

#[test]
fn paths_bend_with_the_branch_they_are_nearest_to() {
    let mut guide = LaneGuide::new(Arc::new(fork()));
    let start_m = [36.0, 0.0];
    let [straight, left] = [path(start_m, 6.0, 0.0), path(start_m, 6.0, 0.2)];
    let mut modes = [straight, left];
    let mut best = left;
    assert!(guide.guide(&agent(start_m), HORIZON_MAX, &mut modes, &[0.5, 0.5], &mut best));
    let end = HORIZON_MAX - 1;
    assert!(modes[0][end][1].abs() < 0.6, "{:?}", modes[0][end]);
    let from_middle = |[x, y]: [f32; 2]| ((x - 40.0).hypot(y - 20.0) - 20.0).abs();
    assert!(from_middle(modes[1][end]) < 1.2, "{:?}", modes[1][end]);
    assert!(from_middle(modes[1][end]) < from_middle(left[end]), "{:?}", modes[1][end]);
    assert!((length_m(start_m, &modes[1]) - length_m(start_m, &left)).abs() < 1.5);
}

#[test]
fn an_agent_off_the_lanes_is_left_alone() {
    let mut guide = LaneGuide::new(Arc::new(fork()));
    let start_m = [20.0, 30.0];
    let mut modes = [path(start_m, 6.0, 0.1)];
    let mut best = modes[0];
    assert!(!guide.guide(&agent(start_m), HORIZON_MAX, &mut modes, &[1.0], &mut best));
    assert_eq!((modes[0], best), (path(start_m, 6.0, 0.1), path(start_m, 6.0, 0.1)));
}

proptest! {
    #[test]
    fn guided_paths_are_finite_and_the_same_each_time(
        x in -5.0_f32..60.0, y in -4.0_f32..4.0, heading in -1.0_f32..1.0, speed in 0.0_f32..30.0, turn in -1.0_f32..1.0,
    ) {
        let mut guide = LaneGuide::new(Arc::new(fork()));
        let start_m = [x, y];
        let agent = Guided { heading_rad: heading, ..agent(start_m) };
        let mut run = || {
            let mut modes = [path(start_m, speed, turn), path(start_m, speed, -turn)];
            let mut best = path(start_m, speed, 0.0);
            guide.guide(&agent, HORIZON_MAX, &mut modes, &[0.7, 0.3], &mut best);
            (modes, best)
        };
        let (first, second) = (run(), run());
        prop_assert_eq!(first, second);
        let all = first.0.as_flattened().iter().chain(&first.1).flatten();
        prop_assert!(all.clone().all(|x| x.is_finite() && x.abs() < 1e4));
    }

    #[test]
    fn routes_are_few_and_whole(x in -5.0_f32..60.0, y in -4.0_f32..4.0, reach_m in 0.0_f32..500.0) {
        let mut routes = Routes::default();
        routes.find(&fork(), AgentType::Vehicle, [x, y], 0.0, reach_m);
        prop_assert!(routes.as_slice().len() <= ROUTES_MAX);
        for route in routes.as_slice() {
            prop_assert!(route.points_m.len() == route.half_width_m.len());
            prop_assert!(route.points_m.windows(2).all(|p| (p[0][0] - p[1][0]).hypot(p[0][1] - p[1][1]) < 1.01));
        }
    }
}
