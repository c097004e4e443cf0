//! Properties of any scene: invariance, causality, and agreement between maps.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use proptest::prelude::*;
use scene::{
    AgentType, ContextMap, EdgeRule, FeatureScales, FileError, MapBuilder, ONLINE_SIDE, OnlineMap,
    PatchOptions, State, Vertex, agent_frame, relation_features, state_features, states_from_positions,
    turn_rates,
};

const PATCH: PatchOptions = PatchOptions { side: 16, cell_m: 2.0, ahead_m: 0.0 };

fn states(len: usize) -> impl Strategy<Value = Vec<State>> {
    let state = ([-40.0_f32..40.0, -40.0_f32..40.0], [-9.0_f32..9.0, -9.0_f32..9.0], -3.1_f32..3.1);
    let state = state.prop_map(|(position_m, velocity_mps, heading_rad)| State {
        position_m,
        velocity_mps,
        heading_rad,
    });
    prop::collection::vec(state, len)
}

/// The state in a world that is turned about its origin and then shifted.
fn moved(state: &State, turn_rad: f32, shift_m: [f32; 2]) -> State {
    let (sin, cos) = turn_rad.sin_cos();
    let turn = |[x, y]: [f32; 2]| [cos * x - sin * y, sin * x + cos * y];
    let [x, y] = turn(state.position_m);
    State {
        position_m: [x + shift_m[0], y + shift_m[1]],
        velocity_mps: turn(state.velocity_mps),
        heading_rad: state.heading_rad + turn_rad,
    }
}

fn assert_near(found: &[f32], expected: &[f32], tolerance: f32) -> Result<(), TestCaseError> {
    for (f, e) in found.iter().zip(expected) {
        prop_assert!((f - e).abs() <= tolerance, "{:?} and {:?}", found, expected);
    }
    Ok(())
}

fn all_state_features(history: &[Option<State>]) -> Vec<f32> {
    let frame = agent_frame(history).unwrap();
    let scales = FeatureScales { position: 0.1, velocity: 0.2 };
    history.iter().flatten().flat_map(|state| state_features(&frame, state, scales)).collect()
}

proptest! {
    #[test]
    fn features_are_invariant_to_moving_and_turning_the_scene(
        states in states(8), turn_rad in -3.0_f32..3.0, shift_m in [-500.0_f32..500.0, -500.0_f32..500.0],
        at_rest in any::<bool>(),
    ) {
        let mut history: Vec<_> = states.into_iter().map(Some).collect();
        if at_rest {
            history[7].as_mut().unwrap().velocity_mps = [0.0; 2];
        }
        let away: Vec<_> = history.iter().map(|s| s.map(|s| moved(&s, turn_rad, shift_m))).collect();
        assert_near(&all_state_features(&away), &all_state_features(&history), 2e-4)?;
        let pair = |states: &[Option<State>]| {
            relation_features(&states[0].unwrap(), &states[1].unwrap(), FeatureScales::default())
        };
        assert_near(&pair(&away), &pair(&history), 2e-3)?;
        let itself = relation_features(&away[0].unwrap(), &away[0].unwrap(), FeatureScales::default());
        prop_assert_eq!(itself, [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn no_future_row_reaches_a_model_input(
        rows in prop::collection::vec(prop::option::weighted(0.8, [-40.0_f32..40.0, -40.0_f32..40.0]), 20),
        row in 8_usize..20, other in prop::option::of([-40.0_f32..40.0, -40.0_f32..40.0]),
    ) {
        let observe = |rows: &[Option<[f32; 2]>]| {
            let mut states = vec![None; rows.len()];
            states_from_positions(rows, 8, 0.4, &mut states);
            states.truncate(8);
            states
        };
        let mut changed = rows.clone();
        changed[row] = other;
        let (before, after) = (observe(&rows), observe(&changed));
        prop_assert_eq!(&before, &after);
        prop_assert_eq!(before, observe(&rows[..8]));
    }

    #[test]
    fn the_graph_holds_just_the_pairs_within_reach(
        agents in prop::collection::vec(prop::option::weighted(0.9, ([-30.0_f32..30.0, -30.0_f32..30.0], any::<bool>())), 0..40),
        most in 1_usize..8,
    ) {
        let vertices: Vec<_> = agents.into_iter().map(|agent| agent.map(|(position_m, walks)| Vertex {
            position_m,
            agent_type: if walks { AgentType::Pedestrian } else { AgentType::Cyclist },
        })).collect();
        let rule = EdgeRule { radius_m: 30.0, pedestrian_radius_m: 10.0, neighbours_max: usize::MAX };
        let mut edges = Vec::new();
        rule.append(3, &vertices, &mut edges);
        prop_assert!(edges.is_sorted());
        let distance = |a: &Vertex, b: &Vertex| (a.position_m[0] - b.position_m[0]).hypot(a.position_m[1] - b.position_m[1]);
        for (i, a) in vertices.iter().enumerate() {
            for (j, b) in vertices.iter().enumerate() {
                let both = a.zip(*b);
                let near = both.is_some_and(|(a, b)| {
                    let walk = a.agent_type == AgentType::Pedestrian && b.agent_type == AgentType::Pedestrian;
                    distance(&a, &b) <= if walk { 10.0 } else { 30.0 }
                });
                let found = edges.iter().any(|e| (usize::from(e.receiver), usize::from(e.sender)) == (i, j));
                prop_assert_eq!(found, near, "{} {}", i, j);
            }
        }

        let mut fewer = Vec::new();
        EdgeRule { neighbours_max: most, ..rule }.append(3, &vertices, &mut fewer);
        prop_assert!(fewer.is_sorted() && fewer.iter().all(|e| edges.contains(e)));
        for receiver in 0..vertices.len() as u16 {
            let of = |edges: &[wire::Edge]| edges.iter().filter(|e| e.receiver == receiver).map(|e| e.sender).collect::<Vec<_>>();
            let (kept, whole) = (of(&fewer), of(&edges));
            prop_assert_eq!(kept.len(), whole.len().min(most));
            prop_assert!(whole.is_empty() || kept.contains(&receiver), "the self edge stays");
            let reach = |sender: &u16| distance(&vertices[usize::from(receiver)].unwrap(), &vertices[usize::from(*sender)].unwrap());
            let farthest = kept.iter().map(reach).fold(0.0, f32::max);
            prop_assert!(whole.iter().filter(|s| !kept.contains(s)).all(|s| reach(s) >= farthest));
        }
    }

    #[test]
    fn online_and_offline_maps_of_the_same_visits_agree(
        visits in prop::collection::vec(([-30.0_f32..30.0, -30.0_f32..30.0], [-9.0_f32..9.0, -9.0_f32..9.0]), 1..300),
        states in states(3),
    ) {
        let mut builder = MapBuilder::new([-40.0, -40.0], 80, 80).unwrap();
        let mut online = OnlineMap::new();
        for visit in &visits {
            prop_assert!(builder.visit(visit.0, visit.1));
            online.observe([0.0, 0.0], std::iter::once(*visit));
        }
        let offline = builder.build();
        prop_assert!((offline.density().sum::<f32>() - 1.0).abs() < 1e-4);
        for state in &states {
            let (mut a, mut b) = (vec![0.0; PATCH.len()], vec![0.0; PATCH.len()]);
            offline.patch(state, PATCH, &mut a);
            online.patch(state, PATCH, &mut b);
            assert_near(&a, &b, 2e-4)?;
        }
    }
}

#[test]
fn an_agent_that_stops_takes_the_mean_direction_of_its_history() {
    let at = |velocity_mps, heading_rad| Some(State { position_m: [1.0, 2.0], velocity_mps, heading_rad });
    let walking = [at([0.0, 1.0], 1.0), None, at([0.0, 0.5], 0.3)];
    assert_eq!(agent_frame(&walking).unwrap().heading_rad, 0.3, "moving: the heading of the last step");
    let stopped = [at([0.0, 1.0], 1.0), at([0.0, 0.5], 1.0), at([0.0, 0.0], 0.3)];
    assert!((agent_frame(&stopped).unwrap().heading_rad - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
    let standing = [at([0.0, 0.05], 1.0), at([0.0, 0.0], 0.3)];
    assert_eq!(agent_frame(&standing).unwrap().heading_rad, 0.3, "never moved: the heading it has");
    assert_eq!(agent_frame(&[None, None]), None);
}

#[test]
fn velocities_are_backward_differences_across_gaps_too() {
    let mut states = [None; 5];
    let rows = [None, Some([0.0, 0.0]), Some([0.0, 0.8]), None, Some([1.6, 0.8])];
    states_from_positions(&rows, 5, 0.4, &mut states);
    let velocity = |step: usize| states[step].unwrap().velocity_mps;
    assert_eq!((velocity(1), velocity(2), velocity(4)), ([0.0, 2.0], [0.0, 2.0], [2.0, 0.0]));
    assert_eq!(states[4].unwrap().heading_rad, 0.0);
    assert_eq!((states[0], states[3]), (None, None));

    // At rest the last heading remains. An agent that never moved has heading 0.
    let rows = [Some([0.0, 0.0]), Some([0.0, 0.4]), Some([0.0, 0.41]), None, None];
    states_from_positions(&rows, 5, 0.4, &mut states);
    assert_eq!(states[2].unwrap().heading_rad, std::f32::consts::FRAC_PI_2);
    states_from_positions(&[Some([3.0, 3.0]), None, None, None, None], 5, 0.4, &mut states);
    assert_eq!(states[0], Some(State { position_m: [3.0, 3.0], ..State::default() }));
}

#[test]
fn turn_rates_take_the_short_way_round_and_skip_gaps() {
    let heading = |heading_rad| Some(State { heading_rad, ..State::default() });
    let near = |found: [f32; 2], expected: [f32; 2]| {
        assert!((found[0] - expected[0]).abs() < 1e-5 && (found[1] - expected[1]).abs() < 1e-5, "{found:?}");
    };
    near(turn_rates(&[heading(0.1), heading(0.2), heading(0.4)], 0.5), [0.4, 0.2]);
    let pi = std::f32::consts::PI;
    near(turn_rates(&[heading(pi - 0.1), heading(0.1 - pi)], 0.4), [0.5, 0.0]);
    near(turn_rates(&[heading(0.1), None, heading(0.4)], 0.5), [0.0, 0.0]);
    near(turn_rates(&[heading(0.1)], 0.5), [0.0, 0.0]);
}

proptest! {
    #[test]
    fn a_patch_ahead_is_the_patch_of_an_agent_there(state in states(1), ahead_m in -20.0_f32..20.0) {
        let state = state[0];
        let (sin, cos) = state.heading_rad.sin_cos();
        let [x, y] = state.position_m;
        let there = State { position_m: [x + ahead_m * cos, y + ahead_m * sin], ..state };
        let map = small_map();
        let mut online = OnlineMap::new();
        online.observe([0.0; 2], (0..50).map(|i| ([(i % 9) as f32, (i % 7) as f32], [1.0, i as f32 * 0.1])));
        let cut = |state: &State, ahead_m: f32| {
            let options = PatchOptions { ahead_m, ..PATCH };
            let mut patches = vec![0.0; 2 * options.len()];
            let (fixed, observed) = patches.split_at_mut(options.len());
            map.patch(state, options, fixed);
            online.patch(state, options, observed);
            patches
        };
        assert_near(&cut(&state, ahead_m), &cut(&there, 0.0), 2e-3)?;
    }
}

#[test]
fn an_online_map_moves_with_the_ego_and_clears_the_rest() {
    let mut map = OnlineMap::new();
    let visit = |x: f32| ([x, 0.5], [2.0, 0.0]);
    let brightest = |map: &OnlineMap, x: f32| {
        let state = State { position_m: [x, 0.5], ..State::default() };
        let dense = PatchOptions { cell_m: 1.0, ..PATCH };
        let mut out = vec![0.0; dense.len()];
        map.patch(&state, dense, &mut out);
        out[..256].iter().fold(0.0_f32, |most, v| most.max(*v))
    };
    for tick in 0..3_000 {
        let x = tick as f32 * 0.8;
        map.observe([x, 0.0], [visit(x), visit(x + 600.0)].into_iter());
        assert!(brightest(&map, x) > 0.0, "the window holds the ego's surroundings at {x} m");
    }
    assert_eq!(brightest(&map, 10.0), 0.0, "left behind");
    // Only the window's visits count: a fresh map of only these visits is identical.
    let mut fresh = OnlineMap::new();
    let (x, brink) = (2_999.0 * 0.8, brink(&map, 2_999.0 * 0.8));
    let held = (0..3_000).map(|tick| tick as f32 * 0.8).filter(|seen| *seen >= brink);
    fresh.observe([brink + ONLINE_SIDE as f32 / 2.0, 0.0], held.map(visit));
    assert_eq!(brightest(&map, x), brightest(&fresh, x));
}

/// The first metre along x that the map still contains, found with patches.
fn brink(map: &OnlineMap, ego_x_m: f32) -> f32 {
    let fine = PatchOptions { side: 1, cell_m: 1.0, ahead_m: 0.0 };
    let held = |x: &f32| {
        let mut out = [0.0; 3];
        map.patch(&State { position_m: [x + 0.5, 0.5], ..State::default() }, fine, &mut out);
        out[0] > 0.0
    };
    (0..=ego_x_m as i32).map(|x| x as f32).find(held).unwrap()
}

fn small_map() -> ContextMap {
    let mut builder = MapBuilder::new([-3.5, 2.0], 5, 7).unwrap();
    for i in 0..50 {
        builder.visit([(i % 9) as f32 - 3.5, 2.0 + (i % 6) as f32], [i as f32 * 0.1, -1.0]);
    }
    builder.build()
}

#[test]
fn a_map_is_read_as_written_and_its_files_are_equal() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a.map"), folder.path().join("b.map"));
    let map = small_map();
    map.save(&a).unwrap();
    map.save(&b).unwrap();
    assert_eq!(ContextMap::load(&a).unwrap(), map);
    assert_eq!(std::fs::read(&a).unwrap(), std::fs::read(&b).unwrap());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing partial is left");
}

#[test]
fn broken_map_files_are_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.map");
    let refused = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        ContextMap::load(&path).unwrap_err()
    };
    small_map().save(&path).unwrap();
    let whole = std::fs::read(&path).unwrap();
    assert!(matches!(refused(&whole[..whole.len() - 1]), FileError::Format { .. }));
    assert!(matches!(refused(b"x,y\n1,2\n"), FileError::Format { .. }));
    assert!(matches!(refused(&[]), FileError::Format { .. }));

    let mut not_finite = whole.clone();
    let last = not_finite.len() - 4;
    not_finite[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    let reason = refused(&not_finite).to_string();
    assert!(reason.contains("broken.map") && reason.contains("NaN"), "{reason}");

    let other = whole.windows(8).position(|w| w == b"[2,5,7],").unwrap();
    let mut reshaped = whole.clone();
    reshaped[other..other + 8].copy_from_slice(b"[2,7,5],");
    let reason = refused(&reshaped).to_string();
    assert!(reason.contains("map.velocity") && reason.contains("[2, 7, 5]"), "{reason}");

    let missing = folder.path().join("none.map");
    assert!(matches!(ContextMap::load(&missing), Err(FileError::Io { .. })));
    assert!(MapBuilder::new([0.0; 2], usize::MAX, 2).is_none());
}

#[test]
fn visits_outside_a_map_are_dropped_before_the_sum() {
    let mut builder = MapBuilder::new([0.0, 0.0], 2, 3).unwrap();
    assert!(builder.visit([2.5, 1.5], [1.0, 0.0]));
    for outside in [[3.0, 1.0], [-0.1, 1.0], [1.0, 2.0], [1.0, -0.1], [f32::NAN, 0.0]] {
        assert!(!builder.visit(outside, [9.0, 9.0]), "{outside:?}");
    }
    let map = builder.build();
    assert_eq!(map.density().collect::<Vec<_>>(), [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    assert_eq!(map.velocity_mps().last(), Some([1.0, 0.0]));
}
