//! Tests of the extractor with and without cache, with several workers and with bad frames.

use crate::support::scene;
use extractor::Effort;
use scene::Scene;
use wire::{AgentFeatures, Edge, Features, Rejected};

fn copy(features: &Features<'_>) -> (Vec<AgentFeatures>, Vec<Edge>, Vec<[f32; 16]>) {
    (features.agents.to_vec(), features.edges.to_vec(), features.attributes.to_vec())
}

#[test]
fn a_steady_tick_computes_the_newest_step_alone() {
    let mut scene = Scene::new(24, 1);
    for tick in 0..40 {
        scene.tick(tick);
    }
    let features = scene.tick(40);
    let newest = features.edges.iter().filter(|edge| edge.step == 7).count();
    let expected = Effort { patch_count: 24, relation_count: newest, edges_dropped: 0 };
    assert!(newest > 24, "agents have neighbours");
    assert_eq!(scene.extractor.effort(), expected);
}

#[test]
fn the_cache_and_a_restart_change_no_bit() {
    let mut old = Scene::new(24, 1);
    for tick in 0..60 {
        old.tick(tick);
    }
    let mut fresh = Scene::new(24, 1);
    assert_eq!(copy(&old.tick(60)), copy(&fresh.tick(60)));
    assert_eq!(fresh.extractor.effort().patch_count, 24 * 8, "a restart refills the window");
}

#[test]
fn the_number_of_workers_changes_no_bit() {
    let mut scenes = [1, 2, 4].map(|workers| Scene::new(24, workers));
    for tick in 0..8 {
        let [one, two, four] = scenes.each_mut().map(|scene| copy(&scene.tick(tick)));
        assert_eq!(one, two, "tick {tick}");
        assert_eq!(one, four, "tick {tick}");
    }
}

/// Moves the second half of the agents far away from the first half.
fn part(context: &mut wire::ContextMut<'_>) {
    let half = context.tracks.len() / 2;
    for track in &mut context.tracks[half..] {
        track.x_m += 300.0;
        track.history.iter_mut().for_each(|state| state.x_m += 300.0);
    }
}

#[test]
fn what_the_served_depend_on_has_the_same_bits_and_nothing_else_is_computed() {
    let (mut whole, mut partial) = (Scene::new(24, 1), Scene::new(24, 2));
    for tick in 0..30 {
        let header = whole.header(tick);
        whole.localise(&header, part);
        partial.localise(&header, part);
        let expected = copy(&whole.extract(&header).unwrap());
        // Every seventh tick has time for all agents. It computes the embeddings that earlier ticks left out.
        if tick % 7 == 6 {
            assert_eq!(copy(&partial.extract(&header).unwrap()), expected, "tick {tick}");
            continue;
        }
        let (agents, edges, attributes) = copy(&partial.extract_most(&header, 5).unwrap());
        let served: Vec<usize> = (0..24).filter(|&i| agents[i].shed == 0).collect();
        assert_eq!(served.len(), 5, "tick {tick}");
        assert!(
            agents
                .iter()
                .all(|agent| (1..=24).contains(&agent.turn) && (agent.turn <= 5) == (agent.shed == 0))
        );
        for (edge, attribute) in edges.iter().zip(&attributes) {
            let place = expected.1.iter().position(|other| other == edge).unwrap();
            assert_eq!(attribute, &expected.2[place]);
            let ends = [edge.receiver, edge.sender].map(usize::from);
            let step = usize::from(edge.step);
            assert!(ends.into_iter().all(|end| agents[end].node[step] == expected.0[end].node[step]));
        }
        let is_served = |edge: &&Edge| served.contains(&usize::from(edge.receiver));
        assert!(
            edges.iter().filter(is_served).eq(expected.1.iter().filter(is_served)),
            "all that they receive"
        );
        if served.iter().all(|&i| i < 12) {
            assert!(agents[12..].iter().all(|agent| agent.node == [[0.0; 64]; 8]), "out of sight");
        }
    }
}

#[test]
fn absent_steps_have_neither_edges_nor_attributes() {
    let mut scene = Scene::new(6, 1);
    let header = scene.header(0);
    scene.localise(&header, |context| context.tracks[2].history[3] = wire::HistoryState::default());
    let features = scene.extract(&header).unwrap();
    assert_eq!(features.agents[2].present, 0b1111_0111);
    assert_eq!(features.agents[2].node[3], [0.0; 64]);
    assert!(!features.edges.iter().any(|e| e.step == 3 && (e.receiver == 2 || e.sender == 2)));
    let own = |e: &&Edge| e.receiver == e.sender;
    assert_eq!(features.edges.iter().filter(own).count(), 6 * 8 - 1);
}

#[test]
fn a_crowd_keeps_its_nearest_neighbours() {
    let mut scene = Scene::new(128, 2);
    let header = scene.header(0);
    scene.localise(&header, |context| {
        for (i, track) in context.tracks.iter_mut().enumerate() {
            track.id = 1_000 + i as u64;
            for state in &mut track.history[..8] {
                (state.x_m, state.y_m) = (i as f32 * 0.05, 0.0);
            }
        }
    });
    let features = scene.extract(&header).unwrap();
    assert_eq!(features.edges.len(), wire::EDGES_MAX);
    let of_first: Vec<u16> =
        features.edges.iter().filter(|e| e.step == 0 && e.receiver == 0).map(|e| e.sender).collect();
    assert_eq!(of_first, (0..32).collect::<Vec<u16>>());
    assert_eq!(scene.extractor.effort().edges_dropped, 128 * 128 * 8 - wire::EDGES_MAX);
}

#[test]
fn a_refused_frame_leaves_no_trace() {
    let (mut clean, mut spoilt) = (Scene::new(9, 1), Scene::new(9, 1));
    for tick in 0..3 {
        clean.tick(tick);
        spoilt.tick(tick);
    }
    let header = spoilt.header(3);
    spoilt.localise(&header, |context| context.patches[5] = f32::NAN);
    assert_eq!(spoilt.extract(&header).unwrap_err(), Rejected::NotFinite { field: "context patches" });
    spoilt.localise(&header, |context| context.tracks[1].history[2].vx_mps = f32::INFINITY);
    assert_eq!(spoilt.extract(&header).unwrap_err(), Rejected::NotFinite { field: "history" });
    spoilt.localise(&header, |context| context.tracks[1].id = context.tracks[0].id);
    assert!(matches!(spoilt.extract(&header).unwrap_err(), Rejected::Twice { field: "track", .. }));
    spoilt.localise(&header, |_| {});
    let mut other = header;
    other.step_ns += 1;
    assert!(matches!(spoilt.extract(&other).unwrap_err(), Rejected::Mismatch { field: "step_ns", .. }));
    let old = spoilt.header(2);
    assert!(matches!(spoilt.extract(&old).unwrap_err(), Rejected::NotNewer { .. }));
    assert_eq!(copy(&clean.tick(3)), copy(&spoilt.tick(3)));
    assert_eq!(clean.extractor.effort(), spoilt.extractor.effort());
}
