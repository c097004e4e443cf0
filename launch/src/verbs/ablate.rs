mod training;
mod variants;

use std::path::{Path, PathBuf};

use clap::Args;
use data::sets::Part;
use evaluator::{Ablation, MapChoice, Options, WeightsChoice};
use run::Exit;
use trainer::{ModelCard, TrainOptions};

use crate::failure::Failure;
use crate::show::show;
use crate::tables;
use training::Trained;
use variants::{Variant, Variants};

/// Arguments of `stgdat ablate`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Recipe to vary: a fold of ETH/UCY, sdd, interaction or interaction-without-SITE
    #[arg(long, value_name = "NAME")]
    recipe: String,
    /// Variants: presets of `stgdat train`, joined by `/` where several make one variant; by default the
    /// ablations that matter for the recipe
    #[arg(long, value_name = "PRESETS,…", value_delimiter = ',')]
    presets: Vec<String>,
    /// Set an option of every variant, as in `stgdat train`; presets are applied after it
    #[arg(long, value_name = "OPTION=VALUE")]
    set: Vec<String>,
    /// Updates per variant; by default those of the recipe
    #[arg(long, value_name = "N")]
    steps: Option<u64>,
    /// Seed of every variant
    #[arg(long)]
    seed: Option<u64>,
    /// Threads of training and evaluation
    #[arg(long, value_name = "N")]
    workers: Option<usize>,
    /// Folder with the data sets in their published layout
    #[arg(long, value_name = "DIR", env = "STGDAT_DATA", default_value = "data")]
    data: PathBuf,
    /// Folder for the variants' weights and checkpoints; finished trainings are kept, interrupted ones
    /// resumed
    #[arg(long, value_name = "FOLDER")]
    dir: PathBuf,
    /// Evaluate the validation part instead of the test part
    #[arg(long)]
    validation: bool,
    /// Write every figure as CSV, one per line
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Markdown file whose marks `stgdat ablate RECIPE` get the table
    #[arg(long, alias = "readme", value_name = "FILE")]
    table: Option<PathBuf>,
}

/// Trains a recipe and variants of it with one and the same budget, and compares them on the same windows.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let variants = Variants::of(&recipe(arguments)?, &arguments.presets)?;
    let Variants { all, mut notes } = variants;
    notes.iter().for_each(|line| note!("{line}"));
    let mut trained = Vec::new();
    for variant in &all {
        let outcome = training::train(variant)?;
        if outcome.card().is_none() {
            notes.push(format!("`{}` could not be trained: its loss became infinite or NaN.", variant.name));
        }
        trained.push((variant, outcome));
    }
    let ablation = evaluate(arguments, &trained)?;
    let (budget, table) = (budget(&arguments.recipe, &trained)?, ablation.markdown());
    let text = format!("{budget}\n\n{table}\n{}", notes.join(" ")).trim_end().to_owned() + "\n";
    if let Some(path) = &arguments.csv {
        std::fs::write(path, ablation.csv()).map_err(|error| Failure::file(path, error))?;
    }
    let exit = show(&text)?;
    if let Some(path) = &arguments.table {
        tables::replace(path, &format!("ablate {}", arguments.recipe), &text)?;
    }
    Ok(exit)
}

/// The recipe as the command line changes it, its files in the folder.
fn recipe(arguments: &Arguments) -> Result<TrainOptions, Failure> {
    let mut options = super::train::recipe(&arguments.recipe)?;
    // The tensors of another training would fit few of the variants.
    options.begin_with.clear();
    for set in &arguments.set {
        options = super::train::changed(&options, set)?;
    }
    options.seed = arguments.seed.unwrap_or(options.seed);
    options.steps = arguments.steps.unwrap_or(options.steps);
    options.workers = arguments.workers.unwrap_or(options.workers);
    options.data.clone_from(&arguments.data);
    options.out = arguments.dir.join("weights.safetensors");
    Ok(options)
}

/// Evaluates the variants that could be trained.
fn evaluate(arguments: &Arguments, trained: &[(&Variant, Trained)]) -> Result<Ablation, Failure> {
    let options = Options {
        data: arguments.data.clone(),
        part: if arguments.validation { Part::Validation } else { Part::Test },
        weights: WeightsChoice { file: None, folder: arguments.dir.clone(), precision: nn::Precision::F32 },
        map: MapChoice::Site,
        lanes: false,
        threads: arguments.workers.unwrap_or(1),
    };
    let variants = trained.iter().filter(|(_, trained)| trained.card().is_some());
    let variants: Vec<_> = variants.map(|(variant, _)| variant.for_evaluation()).collect();
    let progress = |step: &str| note!("evaluating: {step} …");
    evaluator::ablation(&options, &arguments.recipe, &variants, progress).map_err(Failure::data)
}

/// The budget that all variants had, and what it took of them.
fn budget(recipe: &str, trained: &[(&Variant, Trained)]) -> Result<String, Failure> {
    let full = super::train::recipe(recipe)?.steps;
    let cards: Vec<&ModelCard> = trained.iter().filter_map(|(_, trained)| trained.card()).collect();
    let Some(first) = cards.first() else {
        return Err(Failure::Failed("no variant could be trained".into()));
    };
    let TrainOptions { steps, batch_agents, seed, .. } = first.options;
    let share = if steps == full { String::new() } else { format!(" (the recipe makes {full})") };
    let minutes = |card: &&ModelCard| card.wall_s / 60.0;
    let least = cards.iter().map(minutes).fold(f64::INFINITY, f64::min);
    let most = cards.iter().map(minutes).fold(0.0, f64::max);
    let machine = first.cpu.as_deref().unwrap_or("a CPU that the card does not name");
    Ok(format!(
        "Equal budget for every variant of `{recipe}`: {steps} updates{share} of {batch_agents} agents or more from random weights, seed \
         {seed}, the weights of the best validation; {least:.1} to {most:.1} minutes of training each on {machine}."
    ))
}

/// The weights file of a variant in a folder.
fn weights_file(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.safetensors"))
}
