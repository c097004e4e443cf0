//! The model card in the metadata of the weights file.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;

use crate::TrainError;
use crate::base::Fitness;
use crate::checkpoint::RunProgress;
use crate::machine;
use crate::net::tensors::Tensors;
use crate::options::TrainOptions;
use crate::options::set_named;
use crate::samples::Source;
use crate::score::{BASELINE_MIN_M, SetScore, rounded};

/// Provenance and figures of a set of weights.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ModelCard {
    /// A sentence on what the model forecasts.
    pub about: String,
    /// Options of the training run.
    pub options: TrainOptions,
    /// The update whose averaged weights the file contains.
    pub step: u64,
    /// Time that training took.
    pub wall_s: f64,
    /// Largest resident memory since the training began or was resumed. Absent from cards of the first
    /// versions.
    #[serde(default)]
    pub peak_rss_mib: Option<u64>,
    /// The CPU on which training ended.
    #[serde(default)]
    pub cpu: Option<String>,
    /// Calibration factors of each type's covariances, fitted to the validation.
    #[serde(default)]
    pub calibration: BTreeMap<String, f64>,
    /// Number of parameters.
    pub parameters: usize,
    /// Windows and agents of the training data.
    pub training: Seen,
    /// Validation with the online map, by data set.
    pub validation: Vec<SetScore>,
    /// Validation without a map, by data set.
    pub validation_without_map: Vec<SetScore>,
    /// Relative improvement over the baselines, by data set.
    pub gains: Vec<Gain>,
    /// Every recording of the training data.
    pub recordings: Vec<Source>,
    /// The licence of each data set that the weights were trained on, by name. `driving` has one entry per
    /// source. Absent from cards of the first versions.
    #[serde(default)]
    pub licences: BTreeMap<String, String>,
    /// The range of motion in nearly all training windows, by agent type. The weights are suitable for motion
    /// in this range. Absent if the model has no support.
    #[serde(default)]
    pub fitness: BTreeMap<String, Fitness>,
}

/// The licences of data sets, by name. A set with several sources has those of the sources with recordings.
fn licences(sets: &[String], recordings: &[Source]) -> BTreeMap<String, String> {
    let known = sets.iter().filter_map(|name| set_named(name).ok());
    let licences = known.flat_map(|set| {
        let all = set.licences();
        let has_any = |source: &str| recordings.iter().any(|recording| recording.name.starts_with(source));
        all.iter().filter(move |(source, _)| all.len() == 1 || has_any(source))
    });
    licences.map(|&(name, licence)| (name.to_owned(), licence.to_owned())).collect()
}

fn add_missing<T: PartialEq>(to: &mut Vec<T>, from: Vec<T>) {
    for value in from {
        if !to.contains(&value) {
            to.push(value);
        }
    }
}

/// Size of the training data.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Seen {
    /// Windows.
    pub windows: usize,
    /// Agents in these windows whose future is known.
    pub agents: usize,
}

/// Relative reduction of a baseline's error (1 − error / baseline), from the validation with the map.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Gain {
    /// Name of the set.
    pub set: String,
    /// ADE and FDE of the single forecast against constant velocity.
    pub single_over_constant_velocity: [f64; 2],
    /// ADE and FDE of the best mode against the best of 20 residual anchors.
    pub best_of_modes_over_anchors: [f64; 2],
}

impl Gain {
    /// The gains of a set.
    #[must_use]
    pub fn of(score: &SetScore) -> Self {
        let gone = |ours: f64, theirs: f64| rounded(1.0 - ours / theirs.max(BASELINE_MIN_M));
        let (single, cv) = (score.single, score.constant_velocity);
        let (best, anchors) = (score.best_of_modes, score.anchors_best_of_20);
        Self {
            set: score.set.clone(),
            single_over_constant_velocity: [gone(single.ade_m, cv.ade_m), gone(single.fde_m, cv.fde_m)],
            best_of_modes_over_anchors: [gone(best.ade_m, anchors.ade_m), gone(best.fde_m, anchors.fde_m)],
        }
    }
}

impl ModelCard {
    pub(crate) fn new(
        options: &TrainOptions,
        progress: &RunProgress,
        (weights, calibration): (&Tensors, BTreeMap<String, f64>),
        training: Seen,
        recordings: Vec<Source>,
        fitness: BTreeMap<String, Fitness>,
        [validation, validation_without_map]: [Vec<SetScore>; 2],
    ) -> Self {
        Self {
            about: format!(
                "STG-DAT: forecasts of vehicles, cyclists and pedestrians from their last {:.1} s",
                options.model.history_len as f64 * options.model.dt_s
            ),
            options: options.without_places(),
            step: progress.best_step,
            wall_s: progress.seconds.round(),
            peak_rss_mib: machine::peak_rss_mib(),
            cpu: Some(machine::cpu()),
            calibration,
            parameters: weights.0.values().map(|tensor| tensor.values.len()).sum(),
            training,
            gains: validation.iter().map(Gain::of).collect(),
            validation,
            validation_without_map,
            licences: licences(&options.sets, &recordings),
            recordings,
            fitness,
        }
    }

    /// The card of the mean of the weights in `files`. It is the last card, with the data sets, recordings
    /// and training time of all. `None` without cards.
    pub(crate) fn of_mean(mut cards: Vec<Self>, files: &[PathBuf]) -> Option<Self> {
        let mut card = cards.pop()?;
        let Some(last) = files.last().filter(|_| !cards.is_empty()) else { return Some(card) };
        (card.step, card.options.steps) = (0, 0);
        card.options.begin_with = files.to_vec();
        let mut counted = vec![last];
        for (file, other) in files.iter().zip(cards) {
            if !counted.contains(&file) {
                card.wall_s += other.wall_s;
                counted.push(file);
            }
            add_missing(&mut card.options.sets, other.options.sets);
            add_missing(&mut card.recordings, other.recordings);
        }
        Some(card)
    }

    /// The card of weights that were trained earlier and now get the support of these options.
    pub(crate) fn revised(
        self,
        options: &TrainOptions,
        fitness: BTreeMap<String, Fitness>,
        [validation, validation_without_map]: [Vec<SetScore>; 2],
    ) -> Self {
        let mut trained = self.options;
        trained.model = options.model.clone();
        trained.out.clone_from(&options.out);
        Self {
            gains: validation.iter().map(Gain::of).collect(),
            validation,
            validation_without_map,
            licences: licences(&trained.sets, &self.recordings),
            fitness,
            options: trained.without_places(),
            ..self
        }
    }

    /// The bytes of a weights file with this card.
    pub(crate) fn weights_file(&self, weights: &Tensors) -> Result<Vec<u8>, TrainError> {
        let path = &self.options.out;
        let entry = |key: &'static str, json: serde_json::Result<String>| match json {
            Ok(json) => Ok((key.to_owned(), json)),
            Err(source) => Err(TrainError::Metadata { path: path.clone(), key, source }),
        };
        let metadata = HashMap::from([
            entry("config", serde_json::to_string(&self.options.model))?,
            entry("card", serde_json::to_string(self))?,
        ]);
        weights.to_safetensors(nn::Stored::F16, metadata).map_err(|error| error.of(path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metrics::Errors;

    #[test]
    fn even_motion_gives_no_boundless_gain() {
        let single = Errors { ade_m: 0.46, fde_m: 1.43 };
        let score = SetScore { single, ..SetScore::default() };
        assert_eq!(Gain::of(&score).single_over_constant_velocity, [-45.0, -142.0]);
        assert!((score.relative() - 27.115).abs() < 0.01, "{}", score.relative());
    }

    #[test]
    fn licences_are_those_of_the_sources_that_there_are_recordings_of() {
        let recording = |name: &str| Source {
            set: "driving train".to_owned(),
            name: name.to_owned(),
            sha256: String::new(),
        };
        let sets = ["driving", "generated"].map(str::to_owned);
        let left = [recording("mona/a"), recording("ngsim_us101/b")];
        let found: Vec<String> = licences(&sets, &left).into_keys().collect();
        assert_eq!(found, ["generated", "mona", "ngsim"]);
    }
}
