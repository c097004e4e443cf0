//! The weights behind a table, and their provenance in reports.

use std::path::PathBuf;

use data::Recording;
use nn::{Latents, ModelConfig, Precision, Weights};

use crate::error::EvaluateError;
use crate::forecaster::Forecaster;
use crate::scenes::Cut;

/// The recipe of the weights that are embedded in the executable.
pub const EMBEDDED: &str = "onboard";

/// Selects weights.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WeightsChoice {
    /// One weights file for all recipes.
    pub file: Option<PathBuf>,
    /// If `file` is `None`, the folder with one file per recipe. The onboard weights are always embedded.
    pub folder: PathBuf,
    /// Precision of the decoder.
    pub precision: Precision,
}

/// Loaded weights that can forecast.
pub struct Model {
    /// Forecaster with these weights.
    pub forecaster: Forecaster,
    /// Of no part and no recordings.
    provenance: Provenance,
    /// Fingerprints of the recordings that training saw.
    trained_on: Vec<String>,
}

/// Provenance of the weights behind a part of a report's figures.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Provenance {
    /// Name of the part.
    pub part: String,
    /// The weights file.
    pub weights: String,
    /// Fingerprint of the weights file.
    pub sha256: String,
    /// The recipe named by its card.
    pub recipe: Option<String>,
    /// The seed named by its card.
    pub seed: Option<u64>,
    /// How the 20 forecasts of an agent were made.
    pub draws: String,
    /// The map that the network read.
    pub map: String,
    /// Precision of the decoder.
    pub precision: Precision,
    /// Number of recordings behind the figures.
    pub recordings: usize,
    /// Number of these recordings that the card lists as training data.
    pub seen_in_training: usize,
}

impl WeightsChoice {
    /// The weights of `file`, or the embedded ones.
    ///
    /// # Errors
    /// [`EvaluateError::Unusable`] if the file can't be read.
    pub fn load(&self) -> Result<Weights, EvaluateError> {
        let Some(path) = &self.file else { return Ok(Weights::onboard()) };
        Weights::open(path).map_err(|error| EvaluateError::unusable(path.display().to_string(), error))
    }

    /// Opens the weights of `recipe`, or `file` if it is set.
    ///
    /// # Errors
    /// [`EvaluateError`] if the weights are missing or can't be used.
    pub fn open(&self, recipe: &str, seed: u64) -> Result<Model, EvaluateError> {
        let path = self.file.clone().unwrap_or_else(|| self.folder.join(format!("{recipe}.safetensors")));
        let mut shown = path.display().to_string();
        let weights = if self.file.is_none() && recipe == EMBEDDED {
            "embedded".clone_into(&mut shown);
            Weights::onboard()
        } else if path.exists() {
            Self { file: Some(path.clone()), ..self.clone() }.load()?
        } else {
            return Err(EvaluateError::NoWeights { path: shown, recipe: recipe.to_owned() });
        };
        let failed = |source| EvaluateError::unusable(path.display().to_string(), source);
        let mut forecaster = Forecaster::new(weights, seed).map_err(failed)?;
        if self.precision != Precision::F32 {
            forecaster.decode_in(self.precision).map_err(failed)?;
        }
        let weights = forecaster.weights();
        let card = weights.card();
        let entry =
            |name: &str| card.and_then(|card| card.get(name).or_else(|| card.get("options")?.get(name)));
        let recordings = card.and_then(|card| card.get("recordings")?.as_array());
        let fingerprint = |recording: &serde_json::Value| Some(recording.get("sha256")?.as_str()?.to_owned());
        let provenance = Provenance {
            part: String::new(),
            weights: shown,
            sha256: weights.sha256().to_owned(),
            recipe: entry("recipe").and_then(|recipe| Some(recipe.as_str()?.to_owned())),
            seed: entry("seed").and_then(serde_json::Value::as_u64),
            draws: draws(forecaster.config()),
            map: String::new(),
            precision: self.precision,
            recordings: 0,
            seen_in_training: 0,
        };
        let trained_on = recordings.into_iter().flatten().filter_map(fingerprint).collect();
        Ok(Model { provenance, trained_on, forecaster })
    }
}

impl Model {
    /// Whether the card lists the recording as training data.
    pub(crate) fn has_seen(&self, recording: &Recording) -> bool {
        self.trained_on.contains(&recording.sha256)
    }

    /// The provenance of these weights for a part of a report.
    #[must_use]
    pub fn provenance(&self, part: &str, map: &str, recordings: &[&Recording]) -> Provenance {
        let seen = recordings.iter().filter(|recording| self.has_seen(recording));
        Provenance {
            part: part.to_owned(),
            map: if self.forecaster.config().context { map } else { "not read" }.to_owned(),
            recordings: recordings.len(),
            seen_in_training: seen.count(),
            ..self.provenance.clone()
        }
    }

    /// Fails unless the model has the steps of the data set.
    pub(crate) fn check_steps(&self, set: &'static str, wanted: &Cut) -> Result<(), EvaluateError> {
        let own = Cut::of(self.forecaster.config());
        let steps = |of: &Cut| (of.history_len, of.horizon_len, of.step_ns());
        if steps(&own) == steps(wanted) {
            return Ok(());
        }
        let [own, wanted] = [&own, wanted].map(|Cut { history_len, horizon_len, dt_s, .. }| {
            format!("{history_len} + {horizon_len} steps of {dt_s} s")
        });
        Err(EvaluateError::Steps { path: self.provenance.weights.clone(), own, set, wanted })
    }
}

/// How a model's forecasts of an agent are made, and how many are kept.
fn draws(config: &ModelConfig) -> String {
    let modes_len = config.modes;
    match config.latents {
        Latents::Points => format!("{modes_len} of {modes_len} learned latent points, none selected"),
        Latents::Normal => format!("{modes_len} of {modes_len} seeded draws from N(0, I), none selected"),
    }
}

impl Provenance {
    /// The provenance in one line.
    pub fn line(&self) -> String {
        let recipe = self.recipe.as_deref().unwrap_or("unknown");
        let seed = self.seed.map_or_else(|| "unknown".to_owned(), |seed| seed.to_string());
        let seen = match self.seen_in_training {
            0 => String::new(),
            seen => format!(", {seen} SEEN IN TRAINING"),
        };
        let precision = match self.precision {
            Precision::F32 => String::new(),
            other => format!(", decoder in {other}"),
        };
        format!(
            "{}: {} ({}, recipe {recipe}, seed {seed}), {} recordings{seen}, map {}, {}{precision}",
            self.part,
            self.weights,
            &self.sha256[..12.min(self.sha256.len())],
            self.recordings,
            self.map,
            self.draws,
        )
    }
}
