use std::path::Path;

use nn::Weights;
use trainer::{ModelCard, TrainError, TrainOptions};

use super::variants::Variant;
use crate::failure::Failure;

/// Name of the file in a checkpoint folder with the options of its training.
const OPTIONS_FILE: &str = "options.json";

/// What came of a training.
pub(super) enum Trained {
    /// Weights with this card.
    To(Box<ModelCard>),
    /// The losses became infinite or NaN.
    Diverged,
}

/// What is to be done for a variant's weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Course {
    /// Nothing: they are there.
    Keep,
    /// Go on from the newest checkpoint.
    Resume,
    /// Train from the start.
    Begin,
}

impl Trained {
    /// The card, where there are weights.
    pub(super) fn card(&self) -> Option<&ModelCard> {
        match self {
            Self::To(card) => Some(card),
            Self::Diverged => None,
        }
    }
}

/// Trains a variant as far as it is not trained yet. Its weights appear at their path when they are complete.
pub(super) fn train(variant: &Variant) -> Result<Trained, Failure> {
    let Variant { name, options } = variant;
    let options_path = options.checkpoints.join(OPTIONS_FILE);
    let finished = card(&options.out);
    let begun = std::fs::read_to_string(&options_path).ok().and_then(|text| serde_json::from_str(&text).ok());
    let course = Course::of(options, finished.as_ref().map(|card| &card.options), begun.as_ref());
    match (course, finished) {
        (Course::Keep, Some(card)) => {
            note!("{name}: trained already, {}", options.out.display());
            return Ok(Trained::To(Box::new(card)));
        }
        (Course::Resume, _) => note!("{name}: goes on from its checkpoint, if there is one"),
        (_, Some(_)) => note!("{name}: was trained with other options, trains again"),
        _ => note!("{name}: trains"),
    }
    let file = |error: std::io::Error| Failure::file(&options_path, error);
    std::fs::create_dir_all(&options.checkpoints).map_err(file)?;
    std::fs::write(&options_path, serde_json::to_string_pretty(options).map_err(Failure::data)?)
        .map_err(file)?;
    let run = TrainOptions {
        resume: course == Course::Resume,
        // The trainer writes after every good validation: weights of an unfinished training must not pass for
        // complete ones.
        out: options.checkpoints.join("weights.safetensors"),
        ..options.clone()
    };
    match trainer::train(&run) {
        Ok(summary) => {
            std::fs::rename(&run.out, &options.out).map_err(|error| Failure::file(&options.out, error))?;
            Ok(Trained::To(Box::new(summary.card)))
        }
        Err(error @ TrainError::Diverged { .. }) => {
            note!("{name}: {error}");
            Ok(Trained::Diverged)
        }
        Err(error) => Err(Failure::data(error)),
    }
}

impl Course {
    /// What `options` ask for, where weights of a `finished` training exist and another training has `begun`.
    fn of(options: &TrainOptions, finished: Option<&TrainOptions>, begun: Option<&TrainOptions>) -> Self {
        // The number of threads only touches the last digits.
        let alike = |other: &TrainOptions| {
            TrainOptions { workers: options.workers, ..other.without_places() } == options.without_places()
        };
        match (finished.is_some_and(alike), begun.is_some_and(alike)) {
            (true, _) => Self::Keep,
            (false, true) => Self::Resume,
            (false, false) => Self::Begin,
        }
    }
}

/// The card of weights; `None` where there are none, or none that can be read.
fn card(path: &Path) -> Option<ModelCard> {
    let weights = Weights::open(path).ok()?;
    serde_json::from_value(weights.card()?.clone()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_same_training_is_kept_or_resumed() {
        let options = TrainOptions { steps: 20, ..trainer::recipe("zara1").unwrap() };
        let elsewhere = TrainOptions {
            data: "there".into(),
            out: "then.safetensors".into(),
            checkpoints: "them".into(),
            resume: true,
            workers: 5,
            ..options.clone()
        };
        let longer = TrainOptions { steps: 40, ..options.clone() };
        let course = |finished: Option<&TrainOptions>, begun: Option<&TrainOptions>| {
            Course::of(&options, finished, begun)
        };
        assert_eq!(course(None, None), Course::Begin);
        assert_eq!(course(Some(&elsewhere), None), Course::Keep);
        assert_eq!(course(Some(&elsewhere), Some(&longer)), Course::Keep);
        assert_eq!(course(None, Some(&elsewhere)), Course::Resume);
        assert_eq!(course(Some(&longer), Some(&elsewhere)), Course::Resume);
        assert_eq!(course(Some(&longer), Some(&longer)), Course::Begin);
        for other in [
            TrainOptions { seed: 2, ..options.clone() },
            options.clone().with_preset("literal").unwrap(),
            TrainOptions { batch_agents: 1, ..options.clone() },
        ] {
            assert_eq!(course(Some(&other), Some(&other)), Course::Begin);
        }
    }

    #[test]
    fn options_on_disk_are_the_same_training() {
        for name in trainer::RECIPES {
            let options = trainer::recipe(name).unwrap();
            let text = serde_json::to_string_pretty(&options).unwrap();
            let read: TrainOptions = serde_json::from_str(&text).unwrap();
            assert_eq!(Course::of(&options, None, Some(&read)), Course::Resume, "{name}");
        }
    }
}
