//! What several verbs are asked alike: the scene and the model.

use std::path::{Path, PathBuf};

use clap::Args;
use config::{Association, MapChoice, Prior, Run, Scene, View};
use data::Format;
use nn::Weights;
use retrieval::RetrievalMemory;
use rustix::fs::Access;
use source::{Playback, PlaybackOptions};

use crate::failure::Failure;

/// Where the detections come from.
#[derive(Clone, Debug, Args)]
pub struct SceneArguments {
    /// Play a recording
    #[arg(long, value_name = "PATH")]
    pub recording: Option<PathBuf>,
    /// The recording's format; found out where not given
    #[arg(long, requires = "recording")]
    pub format: Option<Format>,
    /// Generate an intersection with so many agents, where no recording is played
    #[arg(long, value_name = "N", default_value_t = 32, conflicts_with = "recording",
          value_parser = clap::value_parser!(u16).range(1..=wire::AGENTS_MAX as i64))]
    pub agents: u16,
    /// Seed of all that is random
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// End after so many ticks
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub ticks: Option<u64>,
}

/// How detections become tracks.
#[derive(Clone, Debug, Args)]
pub struct TrackerArguments {
    /// Associate detections by position even where they carry identities
    #[arg(long)]
    pub associate: bool,
    /// What moves tracks between two detections: `kinematic`, or `learned`: the forecasts made before [default: the pipeline
    /// file's, else `learned`]
    #[arg(long = "tracker.prior", value_name = "PRIOR")]
    pub prior: Option<Prior>,
    /// How detections correct tracks: `assignment`, each by one, or `jpda`: by all that may be its own [default: the pipeline
    /// file's, else `assignment`]
    #[arg(long = "tracker.association", value_name = "ASSOCIATION")]
    pub association: Option<Association>,
    /// What the sensor can see at best, as a sector about the ego's heading, 90,80 for example: who is outside is not missed, where
    /// frames tell that they were made from the ego [default: the pipeline file's, else all there is]
    #[arg(long = "tracker.view", value_name = "DEG,M")]
    pub view: Option<View>,
}

/// What is remembered of the place.
#[derive(Clone, Debug, Args)]
pub struct PlaceArguments {
    /// Forecast without a memory of how those who came by before departed from their forecasts
    #[arg(long)]
    no_recall: bool,
    /// Begin with the memory in this file, if there is one, and keep it there in the end
    #[arg(long, value_name = "FILE", conflicts_with = "no_recall")]
    memory: Option<PathBuf>,
}

/// Where a memory is kept, and what is in it.
pub struct KeptMemory {
    /// The file.
    pub path: PathBuf,
    /// Moments that it begins with.
    pub moments_len: usize,
}

impl PlaceArguments {
    /// Whether the place is to be recalled, where the pipeline says this of it.
    pub fn recalls(&self, pipeline: Option<bool>) -> bool {
        !self.no_recall && (self.memory.is_some() || pipeline.unwrap_or(true))
    }

    /// Where its memory is kept: the file asked for, else the pipeline's. One that is there is opened to see that it is of these
    /// weights; one that is not must have a folder that can be written to.
    pub fn memory(&self, pipeline: Option<&Path>, weights: &Weights) -> Result<Option<KeptMemory>, Failure> {
        let pipeline = pipeline.filter(|_| !self.no_recall);
        let Some(path) = self.memory.as_deref().or(pipeline) else { return Ok(None) };
        let path = std::path::absolute(path).map_err(|error| Failure::file(path, &error))?;
        let mut moments_len = 0;
        if path.try_exists().map_err(|error| Failure::file(&path, &error))? {
            let config = weights.config();
            let steps = (config.horizon_len, config.step_ns());
            let memory = RetrievalMemory::load(&path, weights.sha256(), steps).map_err(Failure::data)?;
            moments_len = memory.entries_len();
        }
        let folder = path.parent().unwrap_or(&path);
        let access = rustix::fs::access(folder, Access::WRITE_OK | Access::EXEC_OK);
        access.map_err(|error| Failure::file(folder, &error.into()))?;
        Ok(Some(KeptMemory { path, moments_len }))
    }
}

/// What forecasts are made with.
#[derive(Clone, Debug, Args)]
pub struct ModelArguments {
    /// Weights other than the embedded ones
    #[arg(long, value_name = "FILE")]
    pub weights: Option<PathBuf>,
    /// Context map: `online`, `none` or a file that `stgdat map` wrote
    #[arg(long, value_name = "MAP")]
    pub map: Option<MapChoice>,
}

/// A recording that is played in this process, and what it is played with.
#[derive(Debug, Args)]
pub struct PlaybackArguments {
    /// The recording
    recording: PathBuf,
    /// The recording's format; found out where not given
    #[arg(long)]
    format: Option<Format>,
    /// Seed of all that is random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// End after so many ticks
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    ticks: Option<u64>,
    #[command(flatten)]
    tracker: TrackerArguments,
    #[command(flatten)]
    model: ModelArguments,
    #[command(flatten)]
    place: PlaceArguments,
}

impl PlaybackArguments {
    /// Where the recording lies, absolute.
    pub fn path(&self) -> Result<PathBuf, Failure> {
        let path = &self.recording;
        path.canonicalize().map_err(|error| Failure::file(path, &error))
    }

    /// The recording, at its beginning, and the run in lockstep that plays it.
    pub fn start(&self) -> Result<(Playback, Run), Failure> {
        let (weights_path, weights) = self.model.open_weights(None)?;
        let format = self.format.map(|format| format.name().to_owned());
        let scene = Scene::Recording { path: self.path()?, format };
        let recording = source::recording(&scene, self.seed, self.ticks)?;
        let options = PlaybackOptions { run_id: 0, ticks_max: self.ticks, lockstep: true };
        let playback = Playback::new(recording, options);
        let run = Run {
            interval_ns: playback.interval_ns(),
            lockstep: true,
            seed: self.seed,
            scene,
            ticks: self.ticks,
            associate: self.tracker.associate,
            prior: self.tracker.prior.unwrap_or_default(),
            association: self.tracker.association.unwrap_or_default(),
            view: self.tracker.view,
            recall: self.place.recalls(None),
            memory: self.place.memory(None, &weights)?.map(|kept| kept.path),
            weights: weights_path,
            model: weights.config().clone(),
            map: self.model.map.clone().unwrap_or(MapChoice::Online),
            ..Run::default()
        };
        Ok((playback, run))
    }
}

impl SceneArguments {
    /// The scene as the run's record tells it; paths are made absolute, as stages may run elsewhere.
    pub fn scene(&self) -> Result<Scene, Failure> {
        let Some(path) = &self.recording else {
            return Ok(Scene::Generated { agents_len: usize::from(self.agents) });
        };
        let path = path.canonicalize().map_err(|error| Failure::file(path, &error))?;
        Ok(Scene::Recording { path, format: self.format.map(|format| format.name().to_owned()) })
    }
}

impl ModelArguments {
    /// Opens the weights: the ones asked for, else the pipeline's, else the embedded ones.
    pub fn open_weights(&self, pipeline: Option<&Path>) -> Result<(Option<PathBuf>, Weights), Failure> {
        let Some(path) = self.weights.as_deref().or(pipeline) else { return Ok((None, Weights::onboard())) };
        let path = path.canonicalize().map_err(|error| Failure::file(path, &error))?;
        let weights = Weights::open(&path).map_err(|error| Failure::weights(&path, &error))?;
        Ok((Some(path), weights))
    }
}
