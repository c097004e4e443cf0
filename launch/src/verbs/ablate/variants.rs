use std::path::Path;

use evaluator::MapChoice;
use trainer::TrainOptions;

use super::super::train::with_preset;
use super::weights_file;
use crate::failure::Failure;

/// What the recipe itself is called.
const UNCHANGED: &str = "as recommended";

/// A training that is compared with the others.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Variant {
    /// What its row is called.
    pub(super) name: String,
    /// How it is trained.
    pub(super) options: TrainOptions,
}

/// The variants of a recipe, itself first.
#[derive(Clone, Debug)]
pub(super) struct Variants {
    pub(super) all: Vec<Variant>,
    /// A line for each preset that is left out.
    pub(super) notes: Vec<String>,
}

impl Variants {
    /// The recipe and what `presets` make of it, with its own budget; the files of all lie beside
    /// [`TrainOptions::out`]. Presets that ask for the same training as an earlier one are noted and left
    /// out.
    pub(super) fn of(recipe: &TrainOptions, presets: &[String]) -> Result<Self, Failure> {
        let folder = recipe.out.parent().unwrap_or(Path::new(""));
        let mut variants = Self { all: vec![Variant::new(UNCHANGED, recipe, folder)], notes: Vec::new() };
        let usual = || recipe.ablations().iter().map(|&presets| presets.to_owned()).collect();
        for name in if presets.is_empty() { usual() } else { presets.to_vec() } {
            let changed = name.split('/').try_fold(recipe.clone(), with_preset)?;
            // Presets may change the budget too; here it is one for all.
            let changed =
                TrainOptions { recipe: recipe.recipe.clone(), batch_agents: recipe.batch_agents, ..changed };
            changed.check().map_err(|error| Failure::Usage(format!("{name}: {error}")))?;
            match variants.all.iter().find(|earlier| earlier.options.trains_like(&changed)) {
                Some(same) => {
                    let line = format!("`{name}` is the same training as “{}”.", same.name);
                    variants.notes.push(line);
                }
                None => variants.all.push(Variant::new(&name, &changed, folder)),
            }
        }
        Ok(variants)
    }
}

impl Variant {
    fn new(name: &str, options: &TrainOptions, folder: &Path) -> Self {
        let recipe = options.recipe.as_deref().unwrap_or("recipe");
        let file = format!("{recipe}-{}", name.replace([' ', '/'], "-"));
        let options = TrainOptions {
            out: weights_file(folder, &file),
            checkpoints: folder.join("checkpoints").join(&file),
            recipe: Some(if name == UNCHANGED { recipe.to_owned() } else { file }),
            resume: false,
            ..options.clone()
        };
        Self { name: name.to_owned(), options }
    }

    /// The variant as the evaluation takes it; one whose training used no map of a site gets the online map.
    pub(super) fn for_evaluation(&self) -> evaluator::Variant {
        let name = self.options.out.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let map = if self.options.site_map > 0.0 { MapChoice::Site } else { MapChoice::Online };
        evaluator::Variant { name: self.name.clone(), weights: name, map }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn variants(recipe: &str, presets: &[&str]) -> Result<Variants, String> {
        let options =
            TrainOptions { out: "folder/weights.safetensors".into(), ..trainer::recipe(recipe).unwrap() };
        let presets: Vec<String> = presets.iter().map(|&preset| preset.to_owned()).collect();
        Variants::of(&options, &presets).map_err(|failure| failure.to_string())
    }

    fn names(variants: &Variants) -> Vec<&str> {
        variants.all.iter().map(|variant| &variant.name[..]).collect()
    }

    #[test]
    fn variants_have_the_recipe_s_budget_and_their_own_files() {
        for recipe in ["zara1", "sdd", "interaction"] {
            let variants = variants(recipe, &[]).unwrap();
            let first = &variants.all[0].options;
            assert!(variants.all.len() > 4);
            for variant in &variants.all {
                let TrainOptions { steps, seed, batch_agents, windows, .. } = variant.options;
                let budget = (first.steps, first.seed, first.batch_agents, first.windows);
                assert_eq!((steps, seed, batch_agents, windows), budget, "{}", variant.name);
                let same_files = variants.all.iter().filter(|other| {
                    other.options.out == variant.options.out
                        || other.options.checkpoints == variant.options.checkpoints
                });
                assert_eq!(same_files.count(), 1, "{}", variant.name);
            }
        }
        let paper = &variants("zara1", &["paper/no-map"]).unwrap().all[1].options;
        assert_eq!(paper.out, Path::new("folder/zara1-paper-no-map.safetensors"));
    }

    #[test]
    fn what_changes_nothing_is_told_and_left_out() {
        let vehicles = variants("interaction", &[]).unwrap();
        assert_eq!(vehicles.notes, ["`T+C+K` is the same training as “as recommended”."]);
        let pedestrians = variants("zara1", &["T", "T+C", "T+C+K", "no-attention"]).unwrap();
        assert_eq!(names(&pedestrians), ["as recommended", "T+C", "no-attention"]);
        assert_eq!(pedestrians.notes[1], "`T+C+K` is the same training as “T+C”.");
    }

    #[test]
    fn unknown_presets_are_refused() {
        let refused = variants("zara1", &["no-map/nothing"]).unwrap_err();
        assert!(refused.contains("unknown preset \"nothing\""), "{refused}");
    }
}
