use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use scene::{AgentType, State};

use super::*;
use crate::agent_view::SceneView;
use crate::base::BaseControl;
use crate::batch::BatchOptions;
use crate::net::layout::{initial, layout};
use crate::net::tensors::TensorRole;
use crate::options::onboard_config;
use crate::samples::Agent;
use crate::view;

/// Width of the differences.
const STEP: f32 = 2e-3;
/// Relative size of a tensor's gradient below which it disappears in the rounding of the differences.
const SILENT: f32 = 3e-4;

/// A turning vehicle, a cyclist and two pedestrians, one of which appears late.
fn agents(config: &ModelConfig) -> Vec<Arc<Agent>> {
    let types = [AgentType::Vehicle, AgentType::Cyclist, AgentType::Pedestrian, AgentType::Pedestrian];
    let agent = |(number, agent_type): (usize, AgentType)| {
        let speed = [6.0, 4.0, 1.2, 0.9][number];
        let turn = [0.08, -0.1, 0.2, 0.02][number];
        let state = |step: usize| {
            let at = step as f32 * config.dt_s as f32;
            let heading_rad = turn * at + number as f32;
            State {
                position_m: [
                    2.0 * number as f32 + speed * at * heading_rad.cos(),
                    speed * at * heading_rad.sin(),
                ],
                velocity_mps: [speed * heading_rad.cos(), speed * heading_rad.sin()],
                heading_rad,
            }
        };
        let steps = config.history_len + config.horizon_len;
        let states: Vec<Option<State>> =
            (0..steps).map(|step| (number != 3 || step >= 3).then(|| state(step))).collect();
        Arc::new(Agent {
            id: number as u64,
            agent_type,
            length_m: Some(4.0),
            history: states[..config.history_len].to_vec(),
            future: states[config.history_len..].to_vec(),
            patches: vec![None; steps],
            counts: true,
        })
    };
    types.into_iter().enumerate().map(agent).collect()
}

fn scene(agents: &[Arc<Agent>]) -> SceneView<'static> {
    let views = agents.iter().map(|agent| view::shown(agent, agent.history.len(), false).unwrap());
    SceneView { agents: views.collect(), map: None, mirrored: false }
}

/// Compares the derivative of the whole loss along the gradient of each tensor with central differences.
fn check(objective: &Objective, config: &ModelConfig) {
    let agents = agents(config);
    let scenes = [scene(&agents)];
    let base = BaseControl::zero(config);
    let options = BatchOptions {
        config,
        base: &base,
        neighbours_max: 8,
        with_future: matches!(objective, Objective::Paper { .. }),
    };
    let batch = Batch::new(&scenes, options).unwrap();
    let mut weights = initial(config, 3);
    base.store(&mut weights);
    let differentiated = |weights: &Tensors| {
        let draws = Draws::new(objective, config, &batch, &mut ChaCha8Rng::seed_from_u64(5));
        let learned = Learned { encoder: true, context: true };
        differentiate(objective, config, weights, &batch, (4, 0.5), &draws, learned)
    };
    let gradients = differentiated(&weights).gradients;
    let total = gradients.0.values().flat_map(|(_, values)| values).map(|g| g * g).sum::<f32>().sqrt();
    let mut checked = 0;
    let mut learned = layout(config);
    learned.retain(|entry| entry.role == TensorRole::Learned);
    for entry in &learned {
        let gradient = &gradients.0[&entry.name].1;
        let norm = gradient.iter().map(|g| g * g).sum::<f32>().sqrt();
        if norm < SILENT * total {
            continue;
        }
        // A steep loss has a larger curvature.
        let step = STEP / norm.max(1.0);
        let moved = |sign: f32| {
            let mut weights = weights.clone();
            let values = &mut weights.0.get_mut(&entry.name).unwrap().values;
            values.iter_mut().zip(gradient).for_each(|(value, g)| *value += sign * step * g / norm);
            objective.weigh(differentiated(&weights).parts)
        };
        let slope = (moved(1.0) - moved(-1.0)) / (2.0 * f64::from(step));
        let error = (slope - f64::from(norm)).abs();
        assert!(
            error < 0.05 * f64::from(norm) + 4e-3,
            "{}: {norm} by the backward pass, {slope}",
            entry.name
        );
        checked += 1;
    }
    let least = learned.len() * 2 / 5;
    assert!(checked >= least, "only {checked} tensors have a gradient that differences can show");
}

#[test]
fn gradients_of_the_plus_objective_agree_with_differences() {
    let config =
        ModelConfig { modes: 4, base: false, base_latent: false, context: false, ..onboard_config() };
    let objective = Objective::Plus {
        random_mode: 0.0,
        single: 0.3,
        probability: 0.05,
        spread: 0.05,
        vehicle: 1.0,
        candidates: 4,
        last_step: 0.5,
    };
    check(&objective, &config);
    let ablated = ModelConfig {
        attention: nn::Attention::Equal,
        node_types: nn::NodeTypes::Same,
        vehicle_motion: nn::VehicleMotion::Displacement,
        ..config.clone()
    };
    check(&objective, &ablated);
    check(&objective, &ModelConfig { node_types: nn::NodeTypes::Same, ..config });
}

#[test]
fn gradients_of_the_paper_objective_agree_with_differences() {
    let config = ModelConfig {
        latents: nn::Latents::Normal,
        mode_head: false,
        best_latent: false,
        base: false,
        base_latent: false,
        context: false,
        ..onboard_config()
    };
    // At full weight, the squared displacement of a vehicle has too much curvature for differences.
    let objective = Objective::Paper { gamma: 0.1, alpha: 0.1, beta: 1.0, sigma: 1.0 };
    check(&objective, &config);
}
