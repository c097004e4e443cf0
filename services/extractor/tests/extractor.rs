//! The extractor with and without cache, with several workers and bad frames.

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
    let expected = Effort { patches_len: 24, relations_len: newest, edges_dropped: 0 };
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
    assert_eq!(fresh.extractor.effort().patches_len, 24 * 8, "a restart refills the window");
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
