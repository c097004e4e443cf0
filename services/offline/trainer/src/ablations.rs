//! Ablations: trainings that differ from another in one part of the model, and the detection of those that do
//! not differ in effect.

use data::sets::{DataSet, Fold};

use crate::options::TrainOptions;
use crate::presets::{MODELS, PRESETS};

/// The ablations of trainings on pedestrians alone, from positions alone.
const OF_PEDESTRIANS: [&str; 5] =
    ["no-attention", "equal-attention", "literal", "online-map", "paper/no-map"];

/// The ablations of trainings with vehicles and maps.
const OF_VEHICLES: &[&str] = PRESETS.split_at(MODELS).1;

impl TrainOptions {
    /// The ablations that have an effect under these options: presets, or several joined by `/` that are
    /// applied in turn.
    #[must_use]
    pub fn ablations(&self) -> &'static [&'static str] {
        if self.has_vehicles() { OF_VEHICLES } else { &OF_PEDESTRIANS }
    }

    /// Whether a training with these options gives the same model as one with `other`, but for files,
    /// threads, GPU and chance: options without effect, such as the motion of vehicles where there are none,
    /// may differ.
    #[must_use]
    pub fn trains_like(&self, other: &Self) -> bool {
        self.effective() == other.effective()
    }

    /// The options without name, threads and GPU, and with those that have no effect at their defaults.
    fn effective(&self) -> Self {
        let default = Self::default();
        let mut options =
            Self { recipe: None, workers: default.workers, gpu: default.gpu, ..self.without_places() };
        let (model, usual) = (&mut options.model, default.model);
        if !model.context {
            (model.width, model.stem) = (usual.width, usual.stem);
            (model.patch_size, model.patch_cell_m) = (usual.patch_size, usual.patch_cell_m);
            model.patch_ahead_m = usual.patch_ahead_m;
            (options.without_map, options.site_map) = (default.without_map, default.site_map);
        }
        if !self.has_vehicles() {
            (model.vehicle_motion, model.node_types) = (usual.vehicle_motion, usual.node_types);
            (model.integrator, model.initial_slip) = (usual.integrator, usual.initial_slip);
            model.slip_limit_rad = usual.slip_limit_rad;
        }
        options
    }

    /// Whether a data set has more than pedestrians.
    fn has_vehicles(&self) -> bool {
        let folds = Fold::ALL.map(DataSet::EthUcyFold);
        let pedestrians = || folds.into_iter().chain([DataSet::EthUcy, DataSet::SddTrajnet]);
        !self.sets.iter().all(|set| pedestrians().any(|known| known.name() == set))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{RECIPES, recipe};

    fn changed(recipe_name: &str, presets: &str) -> TrainOptions {
        let options = recipe(recipe_name).unwrap();
        presets.split('/').fold(options, |options, preset| options.with_preset(preset).unwrap())
    }

    #[test]
    fn ablations_change_their_recipe() {
        for name in RECIPES {
            let options = recipe(name).unwrap();
            let centred = options.model.patch_ahead_m == 0.0;
            for presets in options.ablations() {
                let ablation = changed(name, presets);
                ablation.check().unwrap();
                let same = *presets == "T+C+K" || centred && *presets == "centred-patch";
                assert_eq!(options.trains_like(&ablation), same, "{name}, {presets}");
            }
        }
    }

    #[test]
    fn options_without_effect_do_not_distinguish_trainings() {
        let options = recipe("zara1").unwrap();
        for presets in ["T", "same-node", "no-map", "centred-patch", "full", "plus"] {
            assert!(options.trains_like(&changed("zara1", presets)), "{presets}");
        }
        assert!(changed("zara1", "T+C").trains_like(&changed("zara1", "T+C+K")));
        assert!(!options.trains_like(&changed("zara1", "T+C")));
        let elsewhere = TrainOptions { workers: 7, resume: true, data: "there".into(), ..options.clone() };
        assert!(options.trains_like(&elsewhere));
        assert!(!options.trains_like(&TrainOptions { seed: 2, ..options.clone() }));
        let vehicles = recipe("interaction").unwrap();
        for presets in ["T", "same-node", "no-map", "centred-patch", "full"] {
            assert!(!vehicles.trains_like(&changed("interaction", presets)), "{presets}");
        }
    }
}
