use std::path::PathBuf;

use clap::Args;
use config::Exit;
use nn::Weights;
use trainer::{Errors, ModelCard};

use crate::failure::Failure;
use crate::readme;
use crate::show::show;

/// Arguments of `stgdat card`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Weights; the embedded ones where none are named
    weights: Option<PathBuf>,
    /// Print the whole card as JSON
    #[arg(long)]
    json: bool,
    /// Write the table between the marks `stgdat card` of a Markdown file
    #[arg(long, value_name = "FILE")]
    readme: Option<PathBuf>,
}

/// Prints the model card that weights carry: what they were trained on and how they did on what they never saw.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let weights = match &arguments.weights {
        Some(path) => Weights::open(path).map_err(|error| Failure::weights(path, &error))?,
        None => Weights::onboard(),
    };
    let Some(json) = weights.card() else {
        return Err(Failure::Data("these weights carry no card".into()));
    };
    if arguments.json {
        let json = serde_json::to_string_pretty(json).map_err(Failure::data)?;
        return show(&(json + "\n"));
    }
    let card = serde_json::from_value(json.clone())
        .map_err(|error| Failure::Data(format!("the card is of another version: {error}")))?;
    let text = text(&card);
    if let Some(path) = &arguments.readme {
        readme::insert(path, "card", &text)?;
    }
    show(&format!("weights {}\n\n{text}", weights.sha256()))
}

/// The card for people to read: Markdown that also reads well in a terminal.
pub fn text(card: &ModelCard) -> String {
    let training = card.training;
    let mut text = format!(
        "{}\n\n{} parameters, trained on {} windows with {} agents of {} recordings: update {}, seed {}, {:.0} minutes.\n\n",
        card.about,
        card.parameters,
        training.windows,
        training.agents,
        card.recordings.len(),
        card.step,
        card.options.seed,
        card.wall_s / 60.0,
    );
    let pair = |errors: &Errors| format!("{:.3} / {:.3}", errors.ade_m, errors.fde_m);
    let share = |[ade, fde]: [f64; 2]| format!("{:+.0} % / {:+.0} %", -100.0 * ade, -100.0 * fde);
    text += "Validation, ADE / FDE in m over 4.8 s, online map:\n\n";
    text += &format!(
        "| {:<12} | agents | {:>15} | {:>15} | {:>15} | {:>15} | {:>15} | {:>15} |\n",
        "data set", "best of 20", "20 anchors", "gain", "K = 1", "const. velocity", "gain"
    );
    text += &format!("|:{:-<12}-|-------:|{}\n", "", format!("{:->16}:|", "").repeat(6));
    for (score, gain) in card.validation.iter().zip(&card.gains) {
        text += &format!(
            "| {:<12} | {:>6} | {:>15} | {:>15} | {:>15} | {:>15} | {:>15} | {:>15} |\n",
            score.set,
            score.agents,
            pair(&score.best_of_modes),
            pair(&score.anchors_best_of_20),
            share(gain.best_of_modes_over_anchors),
            pair(&score.single),
            pair(&score.constant_velocity),
            share(gain.single_over_constant_velocity),
        );
    }
    text
}
