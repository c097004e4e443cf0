use std::fmt::Write;
use std::path::Path;

use nn::{BurnIn, Decoder, DecoderMemory, Draws, base};
use scene::AgentType;

use super::*;
use crate::batch::{Batch, BatchOptions};
use crate::net::context::Normalisation;
use crate::net::graph::encode;
use crate::net::layout::{TYPE_NAMES, layout};
use crate::net::tensors::TensorRole;
use crate::objective::Objective;
use crate::rollout::TypeForecast;
use crate::view;

/// Pedestrians that walk in circles at 1.2 m/s. Constant velocity has errors of metres.
fn circles(folder: &Path) {
    let mut rows = String::new();
    for frame in 0..60 {
        for id in 0..4 {
            let (radius, phase) = (2.0 + f64::from(id), f64::from(id));
            let angle = phase + 1.2 * 0.4 * f64::from(frame) / radius;
            let (x, y) = (radius * angle.cos() + 8.0 * f64::from(id), radius * angle.sin());
            writeln!(rows, "{}\t{id}\t{x:.4}\t{y:.4}", frame * 10).unwrap();
        }
    }
    for part in ["train", "val"] {
        let folder = folder.join("eth_ucy/zara1").join(part);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("circles.txt"), &rows).unwrap();
    }
}

/// A small model and a short run on [`circles`].
fn options(folder: &Path, steps: u64) -> TrainOptions {
    circles(folder);
    let mut options = TrainOptions {
        data: folder.to_owned(),
        sets: vec!["zara1".to_owned()],
        validation_sets: vec!["zara1".to_owned()],
        out: folder.join("weights.safetensors"),
        checkpoints: folder.join("checkpoints"),
        steps,
        batch_agents: 8,
        validate_every: 1000,
        validation_agents: 8,
        ..TrainOptions::default()
    };
    options.model.width = 2;
    options.model.modes = 4;
    options
}

#[test]
fn a_short_run_learns_circles_and_its_weights_run_onboard() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(folder.path(), 60);
    (options.model.base, options.model.base_latent, options.model.context) = (false, false, false);
    options.optimiser.warm_up_steps = 5;
    options.optimiser.average_decay = 0.9;
    let summary = train(&options).unwrap();
    let score = &summary.card.validation[0];
    assert!(score.single.ade_m < 0.7 * score.constant_velocity.ade_m, "{score:?}");
    let weights = nn::Weights::open(&options.out).unwrap();
    let card: ModelCard = serde_json::from_value(weights.card().unwrap().clone()).unwrap();
    assert_eq!((weights.config(), &card), (&options.model, &summary.card));
    Decoder::new(&weights).unwrap();
}

#[test]
fn a_resumed_run_repeats_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let options = TrainOptions { resume: true, without_map: 0.5, ..options(folder.path(), 10) };
    let progress = Progress::new(options.steps, 0);
    let run = Run::prepare(&options, &progress).unwrap();
    let (mut state, base) = run.begin(&progress).unwrap();
    let update = |state: &mut RunState, base: &BaseControl| {
        assert!(run.update(state, base).unwrap().1);
        state.progress.step += 1;
    };
    update(&mut state, &base);
    state.save(&options.checkpoints).unwrap();
    let (mut resumed, same_base) = run.begin(&progress).unwrap();
    assert_eq!(resumed.progress, state.progress);
    for _ in 0..2 {
        update(&mut state, &base);
        update(&mut resumed, &same_base);
    }
    assert_eq!(state.weights, resumed.weights);
    let other = TrainOptions { seed: 2, ..options };
    assert!(matches!(RunState::load(&other), Err(TrainError::Checkpoint { .. })));
    let file = other.checkpoints.join("checkpoint.safetensors");
    std::fs::write(&file, "cut off").unwrap();
    let refused = RunState::load(&other).err().unwrap();
    assert!(refused.to_string().starts_with(&format!("{}: safetensors: ", file.display())), "{refused}");
    assert!(std::error::Error::source(&refused).is_some());
}

/// The options of a run that begins with the weights of a first one.
fn second_after(first: &TrainOptions, folder: &Path) -> TrainOptions {
    TrainOptions {
        begin_with: vec![first.out.clone()],
        out: folder.join("second.safetensors"),
        checkpoints: folder.join("second"),
        seed: 2,
        ..first.clone()
    }
}

#[test]
fn a_run_begins_with_given_weights_of_the_same_model() {
    let folder = tempfile::tempdir().unwrap();
    let first = options(folder.path(), 1);
    train(&first).unwrap();
    let second = second_after(&first, folder.path());
    let progress = Progress::new(1, 0);
    let (state, _) = Run::prepare(&second, &progress).unwrap().begin(&progress).unwrap();
    let bytes = std::fs::read(&first.out).unwrap();
    assert_eq!(state.weights, Tensors::from_safetensors(&bytes, &layout(&second.model)).unwrap());
    let mut other = second.clone();
    other.model.modes = 5;
    let refused = train(&other).unwrap_err().to_string();
    assert!(refused.contains("weights.safetensors: its model is another"), "{refused}");
    std::fs::write(&first.out, "cut off").unwrap();
    let refused = train(&second).unwrap_err();
    assert!(matches!(refused, TrainError::BeginWith { .. }), "{refused}");
    assert!(refused.to_string().starts_with(&format!("begin_with {}: ", first.out.display())), "{refused}");
    assert!(std::error::Error::source(&refused).is_some());
}

#[test]
fn a_refitted_base_is_the_only_change_before_the_training() {
    let folder = tempfile::tempdir().unwrap();
    let first = options(folder.path(), 1);
    train(&first).unwrap();
    // Another seed gives other anchors.
    let second = second_after(&first, folder.path());
    let begun = |options: &TrainOptions| {
        let progress = Progress::new(1, 0);
        Run::prepare(options, &progress).unwrap().begin(&progress).unwrap().0.weights
    };
    let (kept, refitted) = (begun(&second), begun(&TrainOptions { refit_base: true, ..second.clone() }));
    for (name, tensor) in &kept.0 {
        // The data have no cyclists and vehicles, and pedestrians have no ridge. Files round speed cuts.
        let is_refitted = ["anchors", "speed_cuts"].iter().any(|of| *name == format!("base.pedestrian.{of}"));
        assert_eq!(tensor.values != refitted.get(name), is_refitted, "{name}");
    }
}

/// The learned tensors of a new run by name, and whether one update moves them.
fn moved_by_an_update(options: &TrainOptions) -> Vec<(String, bool)> {
    let progress = Progress::new(1, 0);
    let run = Run::prepare(options, &progress).unwrap();
    let (mut state, base) = run.begin(&progress).unwrap();
    let before = state.weights.clone();
    assert!(run.update(&mut state, &base).unwrap().1);
    let learned = before.0.iter().filter(|(_, tensor)| tensor.role == TensorRole::Learned);
    learned.map(|(name, tensor)| (name.clone(), tensor.values != state.weights.get(name))).collect()
}

#[test]
fn a_frozen_encoder_keeps_its_values() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = TrainOptions { without_map: 0.0, ..options(folder.path(), 1) };
    options.optimiser.frozen = ["fe.", "gdat."].map(str::to_owned).to_vec();
    for (name, is_moved) in moved_by_an_update(&options) {
        assert_eq!(is_moved, name.starts_with("decoder.pedestrian."), "{name}");
    }
}

/// The same file counts twice if it is given twice. The card lists the files and the data of all.
#[test]
fn the_mean_of_weights_is_written_without_a_training() {
    let folder = tempfile::tempdir().unwrap();
    let first = options(folder.path(), 1);
    train(&first).unwrap();
    let second = second_after(&first, folder.path());
    train(&second).unwrap();
    let mean = TrainOptions {
        begin_with: vec![first.out.clone(), second.out.clone(), second.out.clone(), second.out.clone()],
        out: folder.path().join("mean.safetensors"),
        steps: 0,
        ..second.clone()
    };
    let summary = train(&mean).unwrap();
    let names =
        ["weights", "second", "second", "second"].map(|name| PathBuf::from(format!("{name}.safetensors")));
    assert_eq!(summary.card.options.begin_with, names);
    assert_eq!((summary.card.step, summary.card.recordings.len()), (0, 1));
    let tensors = |options: &TrainOptions| {
        let bytes = std::fs::read(&options.out).unwrap();
        Tensors::from_safetensors(&bytes, &layout(&options.model)).unwrap()
    };
    let (first, second, mean) = (tensors(&first), tensors(&second), tensors(&mean));
    assert_ne!(first, second);
    for (name, tensor) in &mean.0 {
        for ((mean, first), second) in tensor.values.iter().zip(first.get(name)).zip(second.get(name)) {
            let expected = 0.25 * first + 0.75 * second;
            // Files hold 11 bits of a value, and fewer bits of subnormal values.
            assert!((mean - expected).abs() <= 6e-4 * expected.abs() + 1e-7, "{name}: {mean} {expected}");
        }
    }
}

/// The golden vectors have no learned points, mode head or base control, so this test compares both
/// implementations.
#[test]
fn forecasts_by_points_agree_with_the_onboard_decoder() {
    let folder = tempfile::tempdir().unwrap();
    let options = options(folder.path(), 1);
    let summary = train(&options).unwrap();
    assert_eq!(summary.steps, 1);
    let score = &summary.card.validation[0];
    // The base of pedestrians is constant velocity plus deviations from it.
    assert!(score.base_best_of_modes.ade_m < 0.5 * score.constant_velocity.ade_m, "{score:?}");
    let bytes = std::fs::read(&options.out).unwrap();
    let weights = nn::Weights::from_bytes(&bytes).unwrap();
    let config = &options.model;
    let tensors = Tensors::from_safetensors(&bytes, &layout(config)).unwrap();
    let control = BaseControl::load(&tensors, config).unwrap();

    let progress = Progress::new(1, 0);
    let run = Run::prepare(&options, &progress).unwrap();
    let map = run.training.samples.map(0, MapKind::Online);
    let scene = run.training.samples.scene(&run.training.samples.sets[0].windows[3]).unwrap();
    let view = view::plain(&scene, map, 4);
    let batch_options = BatchOptions { config, base: &control, neighbours_max: 8, with_future: false };
    let batch = Batch::new(std::slice::from_ref(&view), batch_options).unwrap();
    let encoded = encode(&tensors, config, &batch.graph, Normalisation::Running, false);
    let pedestrian = TYPE_NAMES.len() - 1;
    let forecast = TypeForecast::new(&tensors, config, &batch, &encoded, pedestrian).unwrap();
    let draw_count = config.modes + 1;
    let modes: Vec<usize> = view.agents.iter().flat_map(|_| 0..draw_count).collect();
    let ours = forecast.by_points(&modes, false).mean.values;

    let onboard = Decoder::new(&weights).unwrap();
    let decoder = onboard.of(AgentType::Pedestrian);
    let base = base::Base::read(&weights, AgentType::Pedestrian).unwrap();
    let (states, _) = batch.state.values.as_chunks::<6>();
    let encodings = &forecast.encoding.values;
    let mut memory = DecoderMemory::default();
    for (agent, states) in states.chunks_exact(config.history_len).enumerate() {
        let present: Vec<bool> = view.agents[agent].history.iter().map(Option::is_some).collect();
        let mut hidden = [[0.0; 128]];
        let burn_in = BurnIn { agents_len: 1, states, present: &present };
        decoder.burn_in(&burn_in, &mut memory, &mut hidden);
        let encoding: [f32; 64] = encodings[agent * 64..][..64].try_into().unwrap();
        let mut raw = vec![[0.0; 5]; draw_count * config.horizon_len];
        let features = base::BaseFeatures::new(states, |step| present[step], config);
        let mut of_base = vec![[0.0; 2]; base.control_count()];
        base.controls(&features, &mut of_base);
        decoder.forecast(&hidden, &[encoding], Draws::Points(&of_base), &mut memory, &mut raw);
        for (mode, steps) in raw.chunks_exact(config.horizon_len).enumerate() {
            let of_base = &of_base[mode * config.horizon_len..];
            let means =
                steps.iter().zip(of_base).flat_map(|(raw, base)| [raw[0] + base[0], raw[1] + base[1]]);
            let ours = &ours[(agent * draw_count + mode) * steps.len() * 2..];
            for (ours, theirs) in ours.iter().zip(means) {
                assert!((ours - theirs).abs() < 1e-4, "agent {agent}, mode {mode}: {ours} and {theirs}");
            }
        }
    }
}

#[test]
fn both_objectives_reach_every_learned_tensor_of_their_model() {
    let folder = tempfile::tempdir().unwrap();
    for objective in [Objective::plus(), Objective::paper()] {
        let mut options = TrainOptions { without_map: 0.0, objective, ..options(folder.path(), 1) };
        // A step that is large enough to change every tensor, however small its gradient.
        (options.optimiser.warm_up_steps, options.optimiser.learning_rate) = (1, 0.1);
        if matches!(options.objective, Objective::Paper { .. }) {
            options.model.latents = nn::Latents::Normal;
            (options.model.base, options.model.base_latent) = (false, false);
            (options.model.mode_head, options.model.best_latent) = (false, false);
        }
        let unused = |name: &str| {
            // The data have no cyclists and vehicles. Only the paper's objective encodes the future, and its
            // mean trajectories do not depend on the spread.
            let of_others = ["vehicle", "cyclist"].iter().any(|other| name.contains(other));
            of_others || (name.starts_with("encoder.") && options.model.base)
        };
        for (name, is_moved) in moved_by_an_update(&options) {
            assert!(is_moved || unused(&name), "{name} was not moved by {:?}", options.objective);
        }
    }
}

/// Trains every preset for one update and reads the weights with the onboard layers.
#[test]
fn every_preset_trains_a_model_that_runs_onboard() {
    let folder = tempfile::tempdir().unwrap();
    let small = options(folder.path(), 1);
    for name in crate::PRESETS {
        let mut options = small.clone().with_preset(name).unwrap();
        options.out = folder.path().join(format!("{name}.safetensors"));
        options.checkpoints = folder.path().join(name);
        (options.batch_agents, options.validation_agents) = (4, 4);
        if name != "paper" {
            options.model.width = 2;
        }
        let summary = train(&options).unwrap();
        let error = &summary.card.validation[0].single;
        assert!(error.ade_m.is_finite() && error.fde_m.is_finite(), "{name}: {error:?}");
        let weights = nn::Weights::open(&options.out).unwrap();
        assert_eq!(weights.config(), &options.model);
        nn::StateMlp::new(&weights).unwrap();
        nn::RelationMlp::new(&weights).unwrap();
        nn::Gdat::new(&weights).unwrap();
        Decoder::new(&weights).unwrap();
        if options.model.context {
            nn::ContextCnn::new(&weights).unwrap();
        }
    }
}

#[test]
fn contradictory_options_are_refused() {
    let mut options = TrainOptions { objective: Objective::paper(), ..TrainOptions::default() };
    assert!(matches!(options.check(), Err(TrainError::Options(_))));
    options.objective = Objective::plus();
    options.check().unwrap();
    options.model.base = false;
    assert!(options.check().unwrap_err().to_string().contains("model.base_latent"));
    options.model.base = true;
    options.sets = vec!["nowhere".to_owned()];
    let refused = train(&options).unwrap_err().to_string();
    assert!(refused.contains("nowhere") && refused.contains("kitti-labels"), "{refused}");
}
