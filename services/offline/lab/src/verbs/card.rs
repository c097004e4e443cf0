mod table;

use std::path::{Path, PathBuf};

use clap::Args;
use evaluator::{Entry, Table};
use metrics::Errors;
use nn::Weights;
use run::Exit;
use trainer::ModelCard;
use wire::AgentType;

use console::failure::Failure;
use console::show::show;
use console::tables;
use launch::files::named_weights;

/// Arguments of `stgdat card`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Weights files or names of shipped weights, one row each; by default the embedded weights
    weights: Vec<PathBuf>,
    /// Print the whole card as JSON; for several files, an object by file name
    #[arg(long)]
    json: bool,
    /// Markdown file whose marks `stgdat card` (of several weights `stgdat cards`) get the table
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
}

/// Prints the model card of weights: their training data and their errors on held-out recordings.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let (name, heading, text) = match &arguments.weights[..] {
        [] => one(arguments, &Weights::onboard(), "the embedded weights")?,
        [path] => one(arguments, &open(path)?, &path.display().to_string())?,
        paths => ("cards", String::new(), several(arguments, paths)?),
    };
    if let Some(path) = arguments.table.as_ref().filter(|_| !arguments.json) {
        tables::replace(path, name, &text)?;
    }
    show(&(heading + &text))
}

/// The mark, heading and text of a card.
fn one(
    arguments: &Arguments,
    weights: &Weights,
    name: &str,
) -> Result<(&'static str, String, String), Failure> {
    if arguments.json {
        return Ok(("card", String::new(), pretty(json(weights, name)?)?));
    }
    Ok(("card", format!("weights {}\n\n", weights.sha256()), text(&card(weights, name)?)))
}

/// A table of several cards, or all cards as JSON.
fn several(arguments: &Arguments, paths: &[PathBuf]) -> Result<String, Failure> {
    let (mut cards, mut by_file) = (Vec::new(), serde_json::Map::new());
    for path in paths {
        let (weights, name) = (open(path)?, path.display().to_string());
        let bytes = std::fs::metadata(named_weights(path)).map_err(|error| Failure::file(path, error))?.len();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        cards.push(table::Row { stem, card: card(&weights, &name)?, bytes });
        by_file.insert(name.clone(), json(&weights, &name)?.clone());
    }
    if arguments.json { pretty(&by_file.into()) } else { Ok(table::text(&cards)) }
}

fn open(path: &Path) -> Result<Weights, Failure> {
    let path = &named_weights(path);
    Weights::open(path).map_err(|error| Failure::weights(path, error))
}

fn json<'a>(weights: &'a Weights, name: &str) -> Result<&'a serde_json::Value, Failure> {
    weights.card().ok_or_else(|| Failure::data(format!("{name}: the weights have no card")))
}

fn card(weights: &Weights, name: &str) -> Result<ModelCard, Failure> {
    serde_json::from_value(json(weights, name)?.clone())
        .map_err(|error| Failure::data_about(format!("{name}: the card is of another version"), error))
}

fn pretty(json: &serde_json::Value) -> Result<String, Failure> {
    Ok(serde_json::to_string_pretty(json).map_err(Failure::data)? + "\n")
}

/// The card as Markdown that is also readable in a terminal.
pub fn text(card: &ModelCard) -> String {
    let training = card.training;
    let mut text = format!(
        "{}\n\n{} parameters, trained on {} windows with {} agents of {} recordings: {}, {:.0} minutes.\n\n",
        card.about,
        card.parameters,
        training.windows,
        training.agents,
        card.recordings.len(),
        origin(card),
        card.wall_s / 60.0,
    );
    if card.validation.is_empty() {
        text += "No validation.\n";
    } else {
        text += &validation(card);
    }
    if !card.fitness.is_empty() {
        text += &fitness(card);
    }
    if !card.licences.is_empty() {
        let licences = card.licences.iter().map(|(set, licence)| format!("{set}: {licence}"));
        text += &format!("\nLicences of the training data: {}.\n", licences.collect::<Vec<_>>().join("; "));
    }
    text
}

/// The table of the validation.
fn validation(card: &ModelCard) -> String {
    let pair = |errors: &Errors| format!("{:.3} / {:.3}", errors.ade_m, errors.fde_m);
    let share = |[ade, fde]: [f64; 2]| format!("{:+.0} % / {:+.0} %", -100.0 * ade, -100.0 * fde);
    let model = &card.options.model;
    let horizon_s = model.dt_s * model.horizon_len as f64;
    let map = if model.context { ", online map" } else { "" };
    let columns = ["agents", "min of 20", "20 anchors", "gain", "K = 1", "const. velocity", "gain"];
    let mut table = Table::new("", "", &["data set"], columns);
    for (score, gain) in card.validation.iter().zip(&card.gains) {
        let figures = [
            score.agents.to_string(),
            pair(&score.best_of_modes),
            pair(&score.anchors_best_of_20),
            share(gain.best_of_modes_over_anchors),
            pair(&score.single),
            pair(&score.constant_velocity),
            share(gain.single_over_constant_velocity),
        ];
        table.push(&[&score.set], figures.map(Entry::from));
    }
    format!("Validation, ADE / FDE in m over {horizon_s:.1} s{map}:\n\n{}", table.grid())
}

/// The update that made the weights, or the files that were averaged.
fn origin(card: &ModelCard) -> String {
    let begun: Vec<String> = card.options.begin_with.iter().map(|path| path.display().to_string()).collect();
    let begun = begun.join(", ");
    match card.step {
        0 if card.options.begin_with.len() > 1 => format!("mean of {begun}"),
        0 if !begun.is_empty() => format!("from {begun}"),
        step if begun.is_empty() => format!("update {step}, seed {}", card.options.seed),
        step => format!("update {step} from {begun}, seed {}", card.options.seed),
    }
}

/// The motion and rate for which the weights are suitable.
fn fitness(card: &ModelCard) -> String {
    let model = &card.options.model;
    let types = card.fitness.iter().map(|(name, fit)| {
        let speed = format!("{name}s to {:.1} m/s", fit.speed_max_mps);
        // Accelerations of other agents are mostly noise of their positions.
        if name != AgentType::Vehicle.name() {
            return speed;
        }
        let ([braking, along], across) = (fit.accel_mps2, fit.lateral_accel_max_mps2);
        format!("{speed}, {braking:.1} to {along:.1} m/s² along and {across:.1} m/s² across their course")
    });
    format!(
        "\nFit for {}; detections at {:.1} Hz or faster; histories of 2 to {} steps of {} s. Farther out the network adds \
         less and less, and `out_of_distribution` says how far.\n",
        types.collect::<Vec<_>>().join("; "),
        1.0 / model.dt_s,
        model.history_len,
        model.dt_s
    )
}
