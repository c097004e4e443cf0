//! The trainings of the shipped weights, by name.

use data::sets::{DataSet, Fold};
use nn::ModelConfig;

use crate::objective::Objective;
use crate::optimiser::OptimiserOptions;
use crate::options::{TrainOptions, onboard_config};

/// Names of the shipped weights:
///
/// * `eth`, `hotel`, `univ`, `zara1` and `zara2` leave out the scene of this name.
/// * `interaction` is trained at all sites; `interaction-without-FT` and `interaction-without-EP1` leave out
///   one.
/// * `onboard` is the pipeline's default; `onboard-free` is the same model, trained only on data that anybody
///   may use.
pub const RECIPES: [&str; 11] = [
    "eth",
    "hotel",
    "univ",
    "zara1",
    "zara2",
    "sdd",
    "interaction",
    "interaction-without-FT",
    "interaction-without-EP1",
    "onboard",
    "onboard-free",
];

/// The options of a recipe; `None` if the name is not in [`RECIPES`].
#[must_use]
pub fn recipe(name: &str) -> Option<TrainOptions> {
    let fold = Fold::ALL.into_iter().find(|fold| fold.name() == name);
    let options = match (name, fold) {
        (_, Some(fold)) => pedestrians(DataSet::EthUcyFold(fold)),
        ("sdd", _) => pedestrians(DataSet::SddTrajnet),
        ("interaction", _) => vehicles(None, 24_000),
        ("interaction-without-FT", _) => vehicles(Some("Roundabout_FT"), 6_000),
        ("interaction-without-EP1", _) => vehicles(Some("Intersection_EP1"), 6_000),
        ("onboard", _) => TrainOptions {
            model: ModelConfig { patch_ahead_m: 8.0, base_support: true, ..onboard_config() },
            ..TrainOptions::default()
        },
        ("onboard-free", _) => free(),
        _ => return None,
    };
    Some(TrainOptions {
        recipe: Some(name.to_owned()),
        out: format!("{name}.safetensors").into(),
        checkpoints: format!("checkpoints/{name}").into(),
        ..options
    })
}

/// Speed bins of vehicles if the training data include motorways.
const ROAD_SPEED_CUTS_MPS: [f32; 7] = [1.0, 3.5, 6.5, 10.0, 14.5, 20.0, 28.0];

/// All types: recordings of roads that anybody may use, and the generated intersection.
fn free() -> TrainOptions {
    let sets = || [DataSet::Ngsim, DataSet::Generated].map(|set| set.name().to_owned()).to_vec();
    TrainOptions {
        sets: sets(),
        validation_sets: sets(),
        set_weights: [(DataSet::Ngsim.name().to_owned(), 3.0)].into(),
        faster: 0.4,
        vehicle_speed_cuts_mps: Some(ROAD_SPEED_CUTS_MPS),
        scale_deviation: 0.3,
        base_scale_deviation: 0.3,
        steps: 6_000,
        site_map: 0.0,
        model: ModelConfig { patch_ahead_m: 8.0, base_support: true, ..onboard_config() },
        ..TrainOptions::default()
    }
}

/// Pedestrians at 0.4 s, eight steps to twelve, from positions only.
fn pedestrians(set: DataSet) -> TrainOptions {
    TrainOptions {
        sets: vec![set.name().to_owned()],
        validation_sets: vec![set.name().to_owned()],
        windows: usize::MAX,
        steps: 2000,
        validate_every: 500,
        validation_agents: 2000,
        batch_agents: 128,
        scene_agents: 16,
        neighbours: 6,
        clip_windows: 1,
        whole_history: true,
        short_history: 0.0,
        noisy_history: 0.0,
        differenced_history: 0.0,
        scale_deviation: 0.5,
        base_scale_deviation: 0.3,
        objective: objective(1.0, 6),
        optimiser: OptimiserOptions { average_decay: 0.998, ..OptimiserOptions::default() },
        model: pedestrian_config(),
        ..TrainOptions::default()
    }
}

/// The plus objective with this weight of vehicles and this number of candidates for the winner.
fn objective(of_vehicles: f64, len: usize) -> Objective {
    let mut objective = Objective::plus();
    if let Objective::Plus { vehicle, candidates, .. } = &mut objective {
        (*vehicle, *candidates) = (of_vehicles, len);
    }
    objective
}

fn pedestrian_config() -> ModelConfig {
    ModelConfig { context: false, edge_radius_m: 10.0, ..onboard_config() }
}

/// Vehicles at 0.5 s, four steps to ten, mostly with the recorded speed, at all sites or with one held out.
///
/// A model for a held-out site draws all other sites uniformly. It has no site map, because a patch ahead of
/// the agent helps only at sites seen in training.
fn vehicles(without: Option<&str>, steps: u64) -> TrainOptions {
    TrainOptions {
        sets: vec![DataSet::Interaction.name().to_owned()],
        validation_sets: vec![DataSet::Interaction.name().to_owned()],
        leave_out: without.into_iter().map(str::to_owned).collect(),
        windows: usize::MAX,
        steps,
        validate_every: 2000,
        validation_agents: 3000,
        batch_agents: 256,
        scene_agents: 16,
        whole_history: true,
        short_history: 0.0,
        noisy_history: 0.0,
        even_sites: if without.is_some() { 1.0 } else { 0.5 },
        without_map: if without.is_some() { 0.3 } else { 0.2 },
        site_map: 0.4,
        standing: 0.2,
        objective: objective(1.0, 8),
        optimiser: OptimiserOptions { average_decay: 0.998, ..OptimiserOptions::default() },
        model: ModelConfig {
            history_len: 4,
            horizon_len: 10,
            dt_s: 0.5,
            patch_ahead_m: if without.is_some() { 0.0 } else { 8.0 },
            ..onboard_config()
        },
        ..TrainOptions::default()
    }
}
