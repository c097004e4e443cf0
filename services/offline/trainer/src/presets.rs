//! Named changes of a training: the paper's model, sizes, and ablations.
//!
//! A *preset* changes the model and the loss of a recipe, or of the defaults, and leaves the data unchanged.
//! A preset only sets values of [`TrainOptions`]. Presets can be chained: `paper` and then `T` is the
//! ablation T of the paper's model.

use nn::{
    Attention, Displacement, Integrator, Latents, ModelConfig, NodeTypes, Stem, Temporal, VehicleMotion,
};

use crate::objective::Objective;
use crate::options::{TrainOptions, onboard_config};

/// An edge radius so small that only self edges remain, m.
const ALONE_M: f32 = 1e-3;

/// Names of the presets.
///
/// * `paper` is the model as printed, `plus` the default of training.
/// * `compact` and `full` are sizes of the context CNN.
/// * `T`, `T+C-ATT`, `T+C` and `T+C+K` are the paper's ablations: trajectories only; with context but equal
///   attention; with context; and with the kinematic layer, which is the whole model. The first three move
///   vehicles by displacements.
/// * `same-node` uses the same networks for all types, `equal-attention` weighs all neighbours and steps
///   equally, `no-attention` leaves out the neighbours, and `literal` reads the paper's temporal attention
///   literally.
/// * `no-map`, `site-map` and `online-map` train without context, with the map of the training recordings,
///   and with the map of earlier observations.
/// * `centred-patch` centres the patch at the agent instead of ahead of it.
pub const PRESETS: [&str; 16] = [
    "paper",
    "plus",
    "compact",
    "full",
    "T",
    "T+C-ATT",
    "T+C",
    "T+C+K",
    "same-node",
    "equal-attention",
    "no-attention",
    "literal",
    "no-map",
    "site-map",
    "online-map",
    "centred-patch",
];

impl TrainOptions {
    /// These options changed by a preset, with files and recipe named after both; `None` if the name is not
    /// in [`PRESETS`].
    #[must_use]
    pub fn with_preset(mut self, name: &str) -> Option<Self> {
        match name {
            "paper" => paper(&mut self),
            "plus" => plus(&mut self),
            "compact" => size(&mut self.model, 16, Stem::Compact, 16),
            "full" => size(&mut self.model, 64, Stem::Imagenet, 32),
            _ => self.ablate(name)?,
        }
        Some(self.named_after(name))
    }

    /// Changes the options by an ablation; `None` for an unknown name.
    fn ablate(&mut self, name: &str) -> Option<()> {
        let model = &mut self.model;
        match name {
            "T" => (model.vehicle_motion, model.context) = (VehicleMotion::Displacement, false),
            "T+C-ATT" => {
                (model.vehicle_motion, model.context) = (VehicleMotion::Displacement, true);
                model.attention = Attention::Equal;
            }
            "T+C" => (model.vehicle_motion, model.context) = (VehicleMotion::Displacement, true),
            "T+C+K" => (model.vehicle_motion, model.context) = (VehicleMotion::Bicycle, true),
            "same-node" => model.node_types = NodeTypes::Same,
            "equal-attention" => model.attention = Attention::Equal,
            "no-attention" => (model.edge_radius_m, model.pedestrian_edge_radius_m) = (ALONE_M, None),
            "literal" => model.temporal = Temporal::Literal,
            "no-map" => model.context = false,
            "site-map" => {
                model.context = true;
                (self.without_map, self.site_map) = (0.0, 1.0);
            }
            "online-map" => {
                model.context = true;
                (self.without_map, self.site_map) = (0.0, 0.0);
            }
            "centred-patch" => model.patch_ahead_m = 0.0,
            _ => return None,
        }
        Some(())
    }

    fn named_after(mut self, preset: &str) -> Self {
        let name = self.recipe.map_or_else(|| preset.to_owned(), |recipe| format!("{recipe}-{preset}"));
        self.out = format!("{name}.safetensors").into();
        self.checkpoints = format!("checkpoints/{name}").into();
        self.recipe = Some(name);
        self
    }
}

/// The model and the training as printed.
fn paper(options: &mut TrainOptions) {
    size(&mut options.model, 64, Stem::Imagenet, 32);
    options.model = ModelConfig {
        patch_cell_m: 1.0,
        patch_ahead_m: 0.0,
        edge_in_message: false,
        distance_scale: false,
        position_scale: 1.0,
        velocity_scale: 1.0,
        integrator: Integrator::Euler,
        slip_limit_rad: None,
        initial_slip: false,
        displacement: Displacement::Absolute,
        latents: Latents::Normal,
        mode_head: false,
        best_latent: false,
        base: false,
        base_latent: false,
        context: true,
        ..options.model.clone()
    };
    options.objective = Objective::paper();
    options.optimiser.learning_rate = 1e-3;
    options.batch_agents = 64;
    (options.without_map, options.site_map) = (0.0, 1.0);
    (options.short_history, options.noisy_history, options.differenced_history) = (0.0, 0.0, 0.0);
    options.scale_deviation = 0.0;
}

/// The default model with the same steps, radii and context.
fn plus(options: &mut TrainOptions) {
    let model = &options.model;
    options.model = ModelConfig {
        edge_radius_m: model.edge_radius_m,
        pedestrian_edge_radius_m: model.pedestrian_edge_radius_m,
        history_len: model.history_len,
        horizon_len: model.horizon_len,
        dt_s: model.dt_s,
        context: model.context,
        default_length_m: model.default_length_m,
        ..onboard_config()
    };
    if matches!(options.objective, Objective::Paper { .. }) {
        options.objective = Objective::plus();
    }
}

/// Changes the size of the context CNN and of its patches, which still cover the same ground.
fn size(model: &mut ModelConfig, width: usize, stem: Stem, patch_size: usize) {
    model.patch_cell_m *= model.patch_size as f32 / patch_size as f32;
    (model.width, model.stem, model.patch_size) = (width, stem, patch_size);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{RECIPES, recipe};

    #[test]
    fn every_preset_of_every_recipe_can_be_trained() {
        for (recipe_name, name) in RECIPES.into_iter().flat_map(|r| PRESETS.map(|preset| (r, preset))) {
            let options = recipe(recipe_name).unwrap();
            let changed = options.clone().with_preset(name).unwrap();
            changed.check().unwrap();
            assert_eq!(changed.recipe, Some(format!("{recipe_name}-{name}")));
            assert_ne!((&changed.out, &changed.checkpoints), (&options.out, &options.checkpoints));
            let data = |options: &TrainOptions| {
                let ModelConfig { history_len, horizon_len, dt_s, .. } = options.model;
                (options.sets.clone(), options.leave_out.clone(), history_len, horizon_len, dt_s)
            };
            assert_eq!(data(&changed), data(&options), "a preset leaves the data alone");
        }
        assert_eq!(TrainOptions::default().with_preset("nothing"), None);
    }

    #[test]
    fn plus_and_the_whole_model_are_the_default() {
        let default = TrainOptions::default();
        for name in ["plus", "compact", "T+C+K"] {
            let changed = default.clone().with_preset(name).unwrap();
            assert_eq!((&changed.model, &changed.objective), (&default.model, &default.objective), "{name}");
        }
    }

    #[test]
    fn presets_can_be_chained() {
        let options = TrainOptions::default().with_preset("paper").unwrap().with_preset("T").unwrap();
        assert_eq!(options.recipe.as_deref(), Some("paper-T"));
        assert_eq!(options.model.vehicle_motion, VehicleMotion::Displacement);
        assert_eq!((options.model.width, options.model.context), (64, false));
        options.check().unwrap();
    }
}
