//! Tests that no input of the network depends on later frames.

use std::path::Path;
use std::sync::{Arc, LazyLock};

use data::{Format, Recording};
use nn::ModelConfig;
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::base::{Augmentation, BaseControl};
use crate::options::onboard_config;
use crate::samples::{Agent, Ground, MapKind, Scene, Selection, cut};
use crate::spool::{Spool, Spooling};
use crate::tests::recordings::{Scenery, frame_rate, written};
use crate::view;

/// A base control fitted to other data.
static BASE: LazyLock<BaseControl> = LazyLock::new(|| {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let recording = read(&Scenery::random(frame_rate(Format::Csv), &mut random), Format::Csv);
    let config = onboard_config();
    let (scenes, _, _) = cut_all(&recording, selection(false), &config);
    let twins = Augmentation { noise: false, differenced: 0.0, scale_deviation: 0.0, faster: 0.0 };
    let counted = |agent_type| {
        let agents = scenes.iter().flat_map(|scene| &scene.agents);
        agents.filter(move |agent| agent.counts && agent.agent_type == agent_type).cloned().map(Ok)
    };
    BaseControl::fit(&config, None, counted, twins, None, 1).unwrap()
});

fn read(scenery: &Scenery, format: Format) -> Recording {
    let folder = tempfile::tempdir().unwrap();
    let path = scenery.write(format, folder.path());
    data::open(&path, Some(format)).unwrap_or_else(|error| panic!("{format}: {error}"))
}

/// Scenes and ground of a recording, and the spool of its patches.
fn cut_all(
    recording: &Recording,
    selection: Selection<'_>,
    config: &ModelConfig,
) -> (Vec<Scene>, Ground, Spool) {
    let folder = tempfile::tempdir().unwrap();
    let mut spooling = Spooling::create(folder.path()).unwrap();
    let (scenes, ground) = cut(recording, selection, config, &mut spooling).unwrap();
    (scenes.collect(), ground, spooling.finish().unwrap())
}

fn selection(from_positions: bool) -> Selection<'static> {
    Selection { from_positions, ..Selection::of_tests(Path::new(""), &[]) }
}

/// Inputs and targets in the windows of a recording up to a time.
struct Shown {
    /// By name, to the bit.
    inputs: Vec<(&'static str, Vec<u32>)>,
    /// The inputs that are not matrices, as text.
    words: String,
    truth: Vec<u32>,
}

impl Shown {
    fn until(recording: &Recording, now_ns: i64, from_positions: bool) -> Self {
        let config = onboard_config();
        let selection = selection(from_positions);
        let step_ns = config.step_ns() as i64;
        let options = data::WindowOptions {
            from_positions,
            ..data::WindowOptions::new(config.history_len, config.horizon_len, step_ns)
        };
        let windows = data::windows(recording, &options);
        let window_count = windows.partition_point(|window| window.stamp_ns <= now_ns);
        let (mut scenes, ground, spool) = cut_all(recording, selection, &config);
        scenes.truncate(window_count);
        // The future may determine which agents have a target, and so the order of a batch. Here all agents
        // have one.
        scenes
            .iter_mut()
            .flat_map(|scene| &mut scene.agents)
            .for_each(|agent| Arc::make_mut(agent).counts = true);
        let map = ground.view(&spool, 0, MapKind::Online);
        let views: Vec<SceneView<'_>> =
            scenes.iter().map(|scene| view::plain(scene, map, usize::MAX)).collect();
        let options = BatchOptions { config: &config, base: &BASE, neighbours_max: 8, with_future: false };
        let batch = Batch::new(&views, options).unwrap();
        // Neither lines nor poses are inputs. Lines depend on other contents of the file, and a pose between
        // two poses is interpolated.
        let without = |frame: &data::Frame| data::Frame {
            lines: data::Lines::default(),
            ego: data::Ego::default(),
            ..frame.clone()
        };
        let shown = recording.frames.iter().take_while(|frame| frame.stamp_ns <= now_ns);
        let frames: Vec<_> = shown.map(without).collect();
        let words = format!("{frames:?}\n{}", agents(&scenes));
        Self { inputs: inputs(&batch), words, truth: bits(&batch.truth.values) }
    }
}

/// All attributes of the agents except their futures, as text.
fn agents(scenes: &[Scene]) -> String {
    let agents = scenes.iter().flat_map(|scene| &scene.agents);
    agents
        .map(|agent| {
            let Agent { id, agent_type, length_m, history, .. } = &**agent;
            format!("{id} {agent_type:?} {length_m:?} {history:?}\n")
        })
        .collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

fn inputs(batch: &Batch<'_>) -> Vec<(&'static str, Vec<u32>)> {
    let graph = &batch.graph;
    let start = |start: &Start| {
        let [vx, vy] = start.velocity_mps;
        [vx, vy, start.heading_rad, start.speed_mps, start.slip_rad, start.rear_axle_m].map(f32::to_bits)
    };
    vec![
        ("state of the rows", bits(&graph.state.values)),
        ("rows of the steps", graph.steps.clone()),
        ("relations", bits(&graph.relation.values)),
        ("relations of the edges", graph.relation_of_edge.clone()),
        ("receivers", graph.edges.receiver.clone()),
        ("senders", graph.edges.sender.clone()),
        ("map patches", bits(&graph.patches.values)),
        ("patches of the rows", graph.patch_of_row.clone()),
        ("state of the agents", bits(&batch.state.values)),
        ("presence", bits(&batch.present.values)),
        ("starts", batch.starts.iter().flat_map(start).collect()),
        ("ridge", batch.base.iter().flat_map(|base| bits(&base.ridge)).collect()),
        ("anchors", batch.base.iter().flat_map(|base| bits(base.anchors)).collect()),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn inputs_do_not_depend_on_later_frames(
        seed in any::<u64>(),
        now_s in 0.5_f64..6.0,
        from_positions in any::<bool>(),
    ) {
        for format in written() {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let scenery = Scenery::random(frame_rate(format), &mut random);
            let now = (now_s * frame_rate(format)) as usize;
            let other = scenery.with_another_future(now, &mut random);
            let now_ns = ((now as f64 + 0.5) / frame_rate(format) * 1e9) as i64;
            let [recorded, perturbed] = [&scenery, &other].map(|scenery| read(scenery, format));
            prop_assert_ne!(&recorded.frames, &perturbed.frames);
            let [shown, other] =
                [&recorded, &perturbed].map(|recording| Shown::until(recording, now_ns, from_positions));
            prop_assert!(shown.words == other.words, "{}: frames, types, sizes or histories differ", format);
            for ((name, values), (_, others)) in shown.inputs.iter().zip(&other.inputs) {
                prop_assert!(values == others, "{format}: {name} differ");
            }
            // A detector reports no identities, so its recordings have no windows.
            if format == Format::KittiDetections {
                prop_assert!(shown.truth.is_empty());
            } else {
                prop_assert!(shown.truth != other.truth, "{format}: the futures are the same");
            }
        }
    }
}
