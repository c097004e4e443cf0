//! Properties of the forecaster on generated traffic with all agent types.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use crate::support::weights;
use data::{GeneratedScene, Recording, SceneOptions};
use evaluator::{Agent, Candidate, Cut, Forecaster, MapInput, Method, Scene};
use nn::{Latents, VehicleMotion, Weights};
use scene::AgentType;

/// Scenes of generated traffic, cut for a model.
fn scenes(forecaster: &Forecaster) -> Vec<Scene> {
    let options = SceneOptions {
        agents: 12,
        seed: 5,
        identities: true,
        miss_probability: 0.0,
        clutter_mean: 0.0,
        occlusion: false,
        ..SceneOptions::default()
    };
    let recording = GeneratedScene::new(options).unwrap().recording(160);
    let scenes = Cut::of(forecaster.config()).scenes(&recording);
    scenes.into_iter().filter(|scene| scene.complete().len() > 3).collect()
}

/// Forecasts of all complete agents, without a map.
fn forecast(forecaster: &Forecaster, scene: &Scene) -> Vec<Candidate> {
    together(forecaster, std::slice::from_ref(scene), 1).remove(0)
}

/// The same for several scenes of a recording.
fn together(forecaster: &Forecaster, scenes: &[Scene], threads: usize) -> Vec<Vec<Candidate>> {
    let variants = forecaster.variants(&Recording::default(), scenes, MapInput::None, threads, None);
    variants.into_iter().map(|scene| scene.into_iter().map(|(_, [network, ..])| network).collect()).collect()
}

fn onboard() -> Forecaster {
    Forecaster::new(Weights::onboard(), 1).unwrap()
}

#[test]
fn forecasts_do_not_depend_on_the_future() {
    let forecaster = onboard();
    let scene = &scenes(&forecaster)[0];
    let mut other = scene.clone();
    for position in other.agents.iter_mut().flat_map(|agent| agent.future.iter_mut().flatten()) {
        *position = [-position[1], 3.0 * position[0]];
    }
    assert_eq!(forecast(&forecaster, scene), forecast(&forecaster, &other));
}

#[test]
fn forecasts_depend_on_neither_past_scenes_nor_threads() {
    let forecaster = onboard();
    let scenes = &scenes(&forecaster)[..4];
    for threads in [1, 3] {
        for (scene, together) in scenes.iter().zip(together(&forecaster, scenes, threads)) {
            assert_eq!(together, forecast(&forecaster, scene));
        }
    }
}

#[test]
fn a_moved_and_turned_scene_has_the_moved_and_turned_forecast() {
    let forecaster = onboard();
    let scene = &scenes(&forecaster)[1];
    let (sin, cos) = 0.7_f32.sin_cos();
    let turn = |[x, y]: [f32; 2]| [cos * x - sin * y, sin * x + cos * y];
    let place = |p: [f32; 2]| {
        let [x, y] = turn(p);
        [x + 30.0, y - 12.0]
    };
    let mut moved = scene.clone();
    for state in moved.agents.iter_mut().flat_map(|agent| agent.history.iter_mut().flatten()) {
        state.position_m = place(state.position_m);
        state.velocity_mps = turn(state.velocity_mps);
        state.heading_rad += 0.7;
    }
    let (before, after) = (forecast(&forecaster, scene), forecast(&forecaster, &moved));
    for (before, after) in before.iter().zip(&after) {
        for (a, b) in before.modes.iter().flatten().zip(after.modes.iter().flatten()) {
            let [x, y] = place(*a);
            assert!((x - b[0]).hypot(y - b[1]) < 0.02, "{:?} became {b:?}", place(*a));
        }
    }
}

#[test]
fn a_network_with_zero_output_leaves_the_base_control() {
    let silent = |name: &str, _: &mut Vec<usize>, values: &mut Vec<f32>| {
        if name.contains(".head.") {
            values.fill(0.0);
        }
    };
    let weights = Weights::from_bytes(&weights::changed(silent, |_| ())).unwrap();
    let forecaster = Forecaster::new(weights, 1).unwrap();
    let scenes = &scenes(&forecaster)[..1];
    let variants = forecaster.variants(&Recording::default(), scenes, MapInput::None, 1, None).concat();
    assert!(!variants.is_empty());
    for (_, variants) in variants {
        let [network, base] = [Method::Network, Method::Base].map(|method| &variants[method.index()]);
        assert_eq!((&network.modes, &network.single), (&base.modes, &base.single));
    }
}

#[test]
fn displacement_vehicles_keep_velocity_at_zero_output() {
    let silent = |name: &str, _: &mut Vec<usize>, values: &mut Vec<f32>| {
        if name.contains(".head.") {
            values.fill(0.0);
        }
    };
    let bytes = weights::changed(silent, |config| {
        config.vehicle_motion = VehicleMotion::Displacement;
        (config.base, config.base_latent) = (false, false);
    });
    let forecaster = Forecaster::new(Weights::from_bytes(&bytes).unwrap(), 1).unwrap();
    let scenes = scenes(&forecaster);
    let scene =
        scenes.iter().find(|scene| scene.agents.iter().any(|a| a.agent_type == AgentType::Vehicle)).unwrap();
    for (agent, forecast) in scene.complete().into_iter().zip(forecast(&forecaster, scene)) {
        let now = scene.agents[agent].newest().unwrap();
        for (step, position) in forecast.single.unwrap().iter().enumerate() {
            let passed_s = (step + 1) as f32 * forecaster.config().dt_s as f32;
            for axis in 0..2 {
                let expected = now.position_m[axis] + now.velocity_mps[axis] * passed_s;
                assert!((position[axis] - expected).abs() < 1e-3, "{position:?} after {passed_s} s");
            }
        }
    }
}

#[test]
fn covariances_grow_and_probabilities_sum_to_one() {
    let forecaster = onboard();
    for forecast in forecast(&forecaster, &scenes(&forecaster)[2]) {
        assert!((forecast.probability.unwrap().iter().sum::<f32>() - 1.0).abs() < 1e-4);
        for covariance in &forecast.covariance {
            assert!(covariance.iter().all(|[xx, xy, yy]| *xx > 0.0 && xx * yy - xy * xy > 0.0));
            let spread = |[xx, _, yy]: [f32; 3]| xx + yy;
            assert!(spread(covariance[covariance.len() - 1]) > spread(covariance[0]));
        }
    }
}

#[test]
fn normal_latents_are_drawn_by_seed_and_agent() {
    let bytes = weights::changed(
        |_, _, _| (),
        |config| {
            config.latents = Latents::Normal;
            config.mode_head = false;
            config.base_latent = false;
        },
    );
    let with_seed = |seed| Forecaster::new(Weights::from_bytes(&bytes).unwrap(), seed).unwrap();
    let scene = &scenes(&with_seed(1))[0];
    let forecasts = forecast(&with_seed(1), scene);
    assert_eq!(forecasts, forecast(&with_seed(1), scene));
    assert_ne!(forecasts, forecast(&with_seed(2), scene));
    for forecast in forecasts {
        let probability = forecast.probability.unwrap();
        assert_eq!(forecast.modes.len(), probability.len());
        assert!(probability.iter().all(|p| (p - 0.05).abs() < 1e-6));
        assert_ne!(forecast.modes[0], forecast.modes[1]);
    }
}

#[test]
fn agents_are_forecast_from_their_second_step_on() {
    let forecaster = onboard();
    let mut scene = scenes(&forecaster)[0].clone();
    let complete = scene.complete();
    for (&place, step_count) in complete.iter().zip([1, 2]) {
        let history = &mut scene.agents[place].history;
        let unseen_count = history.len() - step_count;
        history[..unseen_count].fill(None);
    }
    let payload = &forecaster.payloads(&Recording::default(), &[scene])[0];
    let is_forecast = |place: usize| {
        let track = payload.places.iter().position(|&other| other == place).unwrap();
        payload.tracks[track].forecastable == 1
    };
    assert_eq!([0, 1, 2].map(|agent| is_forecast(complete[agent])), [false, true, true]);
}

#[test]
fn missing_velocities_are_differences_within_the_scene() {
    let forecaster = onboard();
    let recorded = &scenes(&forecaster)[3];
    let pedestrian = |agent: &&Agent| agent.agent_type == AgentType::Pedestrian && agent.is_complete();
    for agent in recorded.agents.iter().filter(pedestrian) {
        let states: Vec<_> = agent.history.iter().flatten().collect();
        assert_eq!(states[0].velocity_mps, states[1].velocity_mps, "the first step copies the second");
        let dt_s = forecaster.config().dt_s as f32;
        let step = (states[2].position_m[0] - states[1].position_m[0]) / dt_s;
        assert!((states[2].velocity_mps[0] - step).abs() < 1e-5);
    }
}

/// The trainer can make models with a longer horizon than a payload holds. They can't be shipped, so they are
/// refused.
#[test]
fn a_longer_horizon_than_a_payloads_is_refused() {
    let longer = |model: &mut nn::ModelConfig| {
        (model.horizon_len, model.base, model.base_latent) = (wire::HORIZON_MAX + 2, false, false);
    };
    let weights = Weights::from_bytes(&weights::changed(|_, _, _| (), longer)).unwrap();
    let refused = Forecaster::new(weights, 1).err().unwrap().to_string();
    assert!(refused.contains("horizon_len"), "{refused}");
}
