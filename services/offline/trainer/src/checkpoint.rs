//! The state of a run on disk, from which it can be resumed.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use safetensors::SafeTensors;

use crate::TrainError;
use crate::error::TensorError;
use crate::net::layout::layout;
use crate::net::tensors::{TensorRole, Tensors};
use crate::optimiser::{Adam, Moments};
use crate::options::TrainOptions;

/// Name of the file in the checkpoint folder.
const FILE: &str = "checkpoint.safetensors";

/// A run between two updates.
pub(crate) struct RunState {
    pub(crate) weights: Tensors,
    pub(crate) adam: Adam,
    /// The averaged weights of the best validation.
    pub(crate) best: Tensors,
    pub(crate) progress: RunProgress,
}

/// The numbers of a [`RunState`].
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunProgress {
    /// Updates tried.
    pub(crate) step: u64,
    /// Updates that moved the weights.
    pub(crate) adam_steps: u64,
    /// Figure of the best validation; `None` before the first validation.
    pub(crate) best_figure: Option<f64>,
    /// Update of the best validation.
    pub(crate) best_step: u64,
    /// Validations since the best.
    pub(crate) stale: u32,
    /// Time spent so far.
    pub(crate) seconds: f64,
    /// Seed and model at the start of the run.
    pub(crate) seed: u64,
    pub(crate) model: nn::ModelConfig,
    /// SHA-256 of the user's own recordings in the training data.
    #[serde(default)]
    pub(crate) recordings: Vec<String>,
}

impl RunState {
    /// A run that has made no update.
    pub(crate) fn new(weights: Tensors, options: &TrainOptions) -> Self {
        let adam = Adam::new(options.optimiser.clone(), &options.model, &weights);
        let progress = RunProgress {
            step: 0,
            adam_steps: 0,
            best_figure: None,
            best_step: 0,
            stale: 0,
            seconds: 0.0,
            seed: options.seed,
            model: options.model.clone(),
            recordings: Vec::new(),
        };
        Self { best: weights.clone(), weights, adam, progress }
    }

    /// Writes the checkpoint. An older one is replaced only by a complete one.
    pub(crate) fn save(&self, folder: &Path) -> Result<(), TrainError> {
        let mut all = Tensors::default();
        let mut add = |prefix: &str, tensors: &Tensors| {
            let named = tensors.0.iter();
            all.0.extend(named.map(|(name, tensor)| (format!("{prefix}/{name}"), tensor.clone())));
        };
        add("value", &self.weights);
        add("average", &self.adam.average);
        add("best", &self.best);
        let moments = |values: fn(&Moments) -> &Vec<f32>| {
            let mut tensors = Tensors::default();
            for (name, moments) in &self.adam.moments {
                let shape = &self.weights.tensor(name).shape;
                tensors.insert(name, shape, values(moments).clone(), TensorRole::Learned);
            }
            tensors
        };
        add("first", &moments(|moments| &moments.first));
        add("second", &moments(|moments| &moments.second));
        let run = serde_json::to_string(&self.progress).expect("numbers and strings are JSON");
        let bytes = all.to_safetensors(nn::Stored::F32, HashMap::from([("run".to_owned(), run)]));
        let path = folder.join(FILE);
        let bytes = bytes.map_err(|error| error.of(&path))?;
        let io = |source| TrainError::Io { path: folder.to_owned(), source };
        std::fs::create_dir_all(folder).map_err(io)?;
        write_whole(&path, &bytes)
    }

    /// Reads the checkpoint of a run with the same seed and model; `None` if there is none.
    pub(crate) fn load(options: &TrainOptions) -> Result<Option<Self>, TrainError> {
        let path = options.checkpoints.join(FILE);
        if !path.exists() {
            return Ok(None);
        }
        let bytes = std::fs::read(&path).map_err(|source| TrainError::Io { path: path.clone(), source })?;
        let progress = read_progress(&bytes, &path)?;
        if progress.seed != options.seed || progress.model != options.model {
            return Err(refused(&path, "it was made with another seed or model"));
        }
        let read = |prefix: &str, roles: &[TensorRole]| {
            let mut entries = layout(&options.model);
            entries.retain(|entry| roles.contains(&entry.role));
            entries.iter_mut().for_each(|entry| entry.name = format!("{prefix}/{}", entry.name));
            let tensors = Tensors::from_safetensors(&bytes, &entries).map_err(|error| error.of(&path))?;
            let named = tensors.0.into_iter();
            Ok::<Tensors, TrainError>(Tensors(
                named.map(|(name, tensor)| (name[prefix.len() + 1..].to_owned(), tensor)).collect(),
            ))
        };
        let all = [TensorRole::Learned, TensorRole::Statistic, TensorRole::Fixed];
        let weights = read("value", &all)?;
        let mut adam = Adam::new(options.optimiser.clone(), &options.model, &weights);
        adam.steps = progress.adam_steps;
        adam.average = read("average", &all)?;
        let (mut first, mut second) =
            (read("first", &[TensorRole::Learned])?, read("second", &[TensorRole::Learned])?);
        for (name, moments) in &mut adam.moments {
            if let (Some(first), Some(second)) = (first.0.remove(name), second.0.remove(name)) {
                (moments.first, moments.second) = (first.values, second.values);
            }
        }
        Ok(Some(Self { weights, adam, best: read("best", &all)?, progress }))
    }
}

fn read_progress(bytes: &[u8], path: &Path) -> Result<RunProgress, TrainError> {
    let (_, header) =
        SafeTensors::read_metadata(bytes).map_err(|error| TensorError::Safetensors(error).of(path))?;
    let run = header.metadata().as_ref().and_then(|metadata| metadata.get("run"));
    let run = run.ok_or_else(|| refused(path, "it is no checkpoint: the metadata lack `run`"))?;
    serde_json::from_str(run).map_err(|source| TrainError::Metadata {
        path: path.to_owned(),
        key: "run",
        source,
    })
}

fn refused(path: &Path, reason: &'static str) -> TrainError {
    TrainError::Checkpoint { path: path.to_owned(), reason }
}

/// Writes a file under another name and moves it to `path`, so that `path` is never incomplete.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), TrainError> {
    let mut partial: PathBuf = path.to_owned();
    partial.set_extension("partial");
    let io = |source| TrainError::Io { path: path.to_owned(), source };
    std::fs::write(&partial, bytes).map_err(io)?;
    std::fs::rename(&partial, path).map_err(io)
}
