//! Arguments that verbs share: the scene, the model, and the options of the stages.

mod files;

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use configuration::options::{Setting, StageOptions, text};
use configuration::stages::IN_PROCESS;
use console::failure::Failure;
use data::{Format, FrameRate, OpenOptions, Recording};
use lanes::{Coordinates, LaneMap};
use localiser::MapChoice;
use model::{Latents, ModelConfig};
use nn::Weights;
use recorder::InputReport;
use run::Run;
use sampler::LanesOrigin;
use source::{Playback, PlaybackOptions};
use toml::Value;
use wire::{StageId, WorldOrigin};

use self::files::recording_at;
pub use self::files::{
    canonical, check_lanes, check_memory, check_prior, lanes_of, map_of, map_path, open_lanes,
};
use crate::files::{quoted, shipped_weights};
use crate::play_report::input_of;

/// How fast ticks follow one another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Speed {
    /// Real time, at the recording's own rate
    Real,
    /// As fast as possible, in lockstep: each tick waits for the forecasts of the previous one
    Max,
}

/// Seed of the random numbers unless another is given.
const SEED: u64 = 1;

/// Source of the detections.
#[derive(Clone, Debug, Args)]
pub struct SceneArguments {
    /// Recording to play, or a folder that contains one
    #[arg(value_name = "FILE", group = "played")]
    file: Option<PathBuf>,
    /// The same
    #[arg(long, value_name = "PATH", group = "played")]
    recording: Option<PathBuf>,
    /// Format of the recording; detected if not given
    #[arg(long, requires = "played")]
    format: Option<Format>,
    /// Frame rate of the recording, Hz, if its files contain frame numbers but no times; by default the
    /// published rate of the data set
    #[arg(long, value_name = "HZ", requires = "played")]
    fps: Option<FrameRate>,
    /// Topic of a bag whose objects are read; may be given several times. The default is Autoware's own detections
    /// or tracks, or else every topic with detections
    #[arg(long, value_name = "NAME", requires = "played")]
    topic: Vec<String>,
    /// Origin of the world frame in the frame of recording, detections and map, in metres, such as
    /// 458000,5428000. The run subtracts it from all positions; files of forecasts use the recording's frame
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub origin: Option<WorldOrigin>,
    /// Number of agents in the generated scene, which is played if no recording is given (default 32)
    #[arg(long, value_name = "N", conflicts_with = "played")]
    agents: Option<u32>,
    /// Noise of the generated scene's detections, m on each axis; with 0 they are exact. By default 0.15 for
    /// vehicles, 0.12 for cyclists and 0.08 for pedestrians
    #[arg(long, value_name = "M", conflicts_with = "played")]
    noise: Option<f64>,
    /// Seed of the random numbers (default 1)
    #[arg(long)]
    seed: Option<u64>,
    /// Stop after this many ticks
    #[arg(long, value_name = "N")]
    pub ticks: Option<u32>,
}

/// How recordings are read.
#[derive(Clone, Debug, Args)]
pub struct ReadArguments {
    /// Format of the recordings; detected for each file if not given
    #[arg(long)]
    pub format: Option<Format>,
    /// Frame rate of the recordings, Hz, if the files contain frame numbers but no times; by default the
    /// published rate of the data set
    #[arg(long, value_name = "HZ")]
    pub fps: Option<FrameRate>,
    /// Topic of a bag whose objects are read; may be given several times. The default is Autoware's own detections
    /// or tracks, or else every topic with detections
    #[arg(long, value_name = "NAME")]
    pub topic: Vec<String>,
    /// Origin of the world frame in the recordings' frame, in metres, such as 458000,5428000. It is
    /// subtracted from all positions
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub origin: Option<WorldOrigin>,
}

/// Options of the tracker.
#[derive(Clone, Debug, Args)]
struct TrackerArguments {
    /// Associate detections by position even if they carry identities
    #[arg(long)]
    associate: bool,
}

/// Options of the retrieval memory.
#[derive(Clone, Debug, Args)]
struct RetrievalArguments {
    /// Forecast without the retrieval memory
    #[arg(long)]
    no_retrieval: bool,
    /// File of the retrieval memory: read at the start if it exists, written at the end
    #[arg(long, value_name = "FILE", conflicts_with = "no_retrieval")]
    memory: Option<PathBuf>,
}

/// Options of the stages.
#[derive(Clone, Debug, Args)]
pub struct SetArguments {
    /// Set an option of a stage, such as tracker.fov=90,80. It overrides pipeline.toml and other arguments;
    /// the last one wins. `stgdat stage --help` lists the options
    #[arg(long, value_name = "STAGE.OPTION=VALUE")]
    pub set: Vec<Setting>,
}

/// The model and its map.
#[derive(Clone, Debug, Args)]
pub struct ModelArguments {
    /// Weights to use instead of the embedded ones: a file, or the name of shipped weights such as
    /// `onboard-free`
    #[arg(long, value_name = "FILE|NAME")]
    pub weights: Option<PathBuf>,
    /// Context map: `online`, `none` or a file written by `stgdat map`
    #[arg(long, value_name = "MAP")]
    pub map: Option<MapChoice>,
    /// Lanelet2 map of the site (OSM XML). Forecasts of vehicles follow its lanes
    #[arg(long, value_name = "FILE")]
    lanes: Option<PathBuf>,
    /// Origin of the world frame in the map of --lanes: latitude and longitude in degrees, or a position in the
    /// map's own frame in metres, as in 81000,50000m
    #[arg(long, value_name = "LAT,LON|X,Ym", requires = "lanes", allow_hyphen_values = true)]
    lanes_origin: Option<Coordinates>,
}

/// The model, its maps, and the options of all stages but the source.
#[derive(Clone, Debug, Args)]
pub struct PipelineArguments {
    #[command(flatten)]
    tracker: TrackerArguments,
    /// The model and its maps.
    #[command(flatten)]
    pub model: ModelArguments,
    #[command(flatten)]
    retrieval: RetrievalArguments,
    #[command(flatten)]
    set: SetArguments,
}

/// A recording that is played in this process, with its options.
#[derive(Debug, Args)]
pub struct PlaybackArguments {
    /// Recording to play, or a folder that contains one; by default the generated scene
    recording: Option<PathBuf>,
    #[command(flatten)]
    read: ReadArguments,
    /// Seed of the random numbers (default 1)
    #[arg(long)]
    seed: Option<u64>,
    /// Stop after this many ticks
    #[arg(long, value_name = "N")]
    ticks: Option<u32>,
    #[command(flatten)]
    pipeline: PipelineArguments,
}

/// A recording at its start, and the run that plays it.
pub struct Played {
    /// The recording.
    pub playback: Playback,
    /// What the audit of the recording found.
    pub input: InputReport,
    /// The run, in lockstep.
    pub run: Run,
    /// Model.
    pub model: ModelConfig,
}

/// A lockstep run in this process whose recording is not read yet.
pub struct Prepared {
    /// The recording and how it is read.
    pub source: source::Options,
    /// The run, with the default interval.
    pub run: Run,
    /// Model.
    pub model: ModelConfig,
}

impl SceneArguments {
    /// The seed.
    pub fn seed(&self) -> u64 {
        self.seed.unwrap_or(SEED)
    }

    /// Prints a note if the given seed has no effect.
    pub fn note_unused_seed(
        &self,
        source: &source::Options,
        sampler: &sampler::Options,
        model: &ModelConfig,
    ) {
        if self.seed.is_some() && source.recording.is_some() {
            note_unused_seed(sampler, model);
        }
    }

    /// Settings of the source.
    pub fn settings(&self) -> Result<Vec<Setting>, Failure> {
        let source = |flag, option, value: Value| Setting::of_flag(flag, StageId::Source, option, value);
        let unset = |flag, option| Setting::unset(flag, StageId::Source, option);
        let path = self.file.as_deref().or(self.recording.as_deref());
        let recording = path.map(|path| text(&recording_at(path)?)).transpose()?;
        let settings = [
            // --recording replaces format and rate in pipeline.toml too. --agents and --noise replace the
            // recording.
            recording.is_some().then(|| unset("--recording", "format")),
            recording.is_some().then(|| unset("--recording", "fps")),
            recording.is_some().then(|| unset("--recording", "topics")),
            self.agents.map(|_| unset("--agents", "recording")),
            self.noise.map(|_| unset("--noise", "recording")),
            recording.map(|path| source("--recording", "recording", path.into())),
            self.format.map(|format| source("--format", "format", format.name().into())),
            self.fps.map(|fps| source("--fps", "fps", fps.hertz().into())),
            (!self.topic.is_empty()).then(|| source("--topic", "topics", self.topic.clone().into())),
            self.agents.map(|agents| source("--agents", "agents", agents.into())),
            self.noise.map(|noise_m| source("--noise", "noise_m", noise_m.into())),
            self.ticks.map(|ticks| source("--ticks", "ticks", ticks.into())),
        ];
        Ok(settings.into_iter().flatten().collect())
    }
}

impl ReadArguments {
    /// Returns the options with which recordings are opened.
    pub fn options(&self) -> OpenOptions {
        let (format, fps, topics) = (self.format, self.fps, self.topic.clone());
        OpenOptions { format, fps, origin: self.origin.unwrap_or_default(), topics }
    }

    /// Returns these arguments as command-line text, each after a space.
    pub fn written(&self) -> String {
        let format = self.format.map(|format| format!(" --format {format}"));
        let fps = self.fps.map(|fps| format!(" --fps {fps}"));
        let origin = self.origin.map(|origin| format!(" --origin {origin}"));
        let topics = self.topic.iter().map(|topic| format!(" --topic {}", quoted(topic)));
        [format, fps, origin].into_iter().flatten().chain(topics).collect()
    }

    /// Reads a recording and warns about its probable defects.
    pub fn open(&self, path: &Path) -> Result<Recording, Failure> {
        let recording = data::open_with(path, self.options()).map_err(Failure::data)?;
        warn_of_doubts(&recording);
        Ok(recording)
    }
}

/// Warns about probable defects of a recording.
pub fn warn_of_doubts(recording: &Recording) {
    for found in data::findings(recording).iter().filter(|found| found.doubtful) {
        tracing::warn!("{}: {found}", recording.name);
    }
}

impl TrackerArguments {
    /// Settings of the tracker.
    fn settings(&self) -> Vec<Setting> {
        let associate =
            self.associate.then(|| Setting::of_flag("--associate", StageId::Tracker, "associate", true));
        associate.into_iter().collect()
    }
}

impl RetrievalArguments {
    /// Settings of the sampler.
    fn settings(&self) -> Result<Vec<Setting>, Failure> {
        let retrieval = |flag, on: bool| Setting::of_flag(flag, StageId::Sampler, "retrieval", on);
        if self.no_retrieval {
            let flag = "--no-retrieval";
            return Ok(vec![Setting::unset(flag, StageId::Sampler, "memory"), retrieval(flag, false)]);
        }
        let Some(path) = &self.memory else { return Ok(Vec::new()) };
        let memory = Setting::of_flag("--memory", StageId::Sampler, "memory", text(path)?);
        Ok(vec![retrieval("--memory", true), memory])
    }
}

impl ModelArguments {
    /// Settings of the localiser and of the sampler.
    pub fn settings(&self) -> Result<Vec<Setting>, Failure> {
        let map = self
            .map
            .as_ref()
            .map(|map| Setting::of_flag("--map", StageId::Localiser, "map", map.to_string()));
        let of_sampler =
            |flag, option, value: String| Setting::of_flag(flag, StageId::Sampler, option, value);
        let Some(path) = &self.lanes else { return Ok(map.into_iter().collect()) };
        let lanes = of_sampler("--lanes", "lanes", text(&canonical(path)?)?);
        let origin = match self.lanes_origin {
            Some(origin) => of_sampler("--lanes-origin", "lanes_origin", origin.to_string()),
            None => Setting::unset("--lanes", StageId::Sampler, "lanes_origin"),
        };
        Ok(map.into_iter().chain([lanes, origin]).collect())
    }

    /// Returns these arguments as command-line text, each after a space.
    pub fn written(&self) -> String {
        let path = |flag: &str, path: &PathBuf| format!(" {flag} {}", quoted(&path.to_string_lossy()));
        let weights = self.weights.as_ref().map(|weights| path("--weights", weights));
        let map = self.map.as_ref().map(|map| format!(" --map {}", quoted(&map.to_string())));
        let lanes = self.lanes.as_ref().map(|lanes| path("--lanes", lanes));
        let origin = self.lanes_origin.map(|origin| format!(" --lanes-origin {origin}"));
        [weights, map, lanes, origin].into_iter().flatten().collect()
    }

    /// Reads the lane map given on the command line, if any. `origin` is the recording's origin.
    pub fn open_lanes(&self, origin: WorldOrigin) -> Result<Option<LaneMap>, Failure> {
        let coordinates = LanesOrigin::coordinates(self.lanes_origin.map(LanesOrigin), origin);
        self.lanes.as_ref().map(|path| open_lanes(path, coordinates)).transpose()
    }

    /// Opens the weights named on the command line, else the pipeline's weights, else the embedded ones.
    pub fn open_weights(&self, pipeline: Option<&Path>) -> Result<(Option<PathBuf>, Weights), Failure> {
        let Some(path) = self.weights.as_deref().or(pipeline) else { return Ok((None, Weights::onboard())) };
        let path = shipped_weights(path).map_or_else(|| canonical(path), Ok)?;
        let weights = Weights::open(&path).map_err(|error| Failure::weights(&path, error))?;
        Ok((Some(path), weights))
    }
}

impl PipelineArguments {
    /// Settings of the stages. Those of --set come last, after `more`, because the last setting of an option wins.
    pub fn settings(&self, more: Option<Setting>) -> Result<Vec<Setting>, Failure> {
        let (model, retrieval) = (self.model.settings()?, self.retrieval.settings()?);
        Ok([self.tracker.settings(), model, retrieval, Vec::from_iter(more), self.set.set.clone()].concat())
    }
}

impl PlaybackArguments {
    /// How the recording is read.
    pub const fn read(&self) -> &ReadArguments {
        &self.read
    }

    /// The model and the maps.
    pub const fn model(&self) -> &ModelArguments {
        &self.pipeline.model
    }

    /// Absolute path of the recording; `None` for the generated intersection.
    pub fn path(&self) -> Result<Option<PathBuf>, Failure> {
        self.recording.as_deref().map(recording_at).transpose()
    }

    /// Returns the recording at its start and the lockstep run that plays it.
    pub fn start(&self) -> Result<Played, Failure> {
        let Prepared { source, mut run, model } = self.prepare()?;
        let recording = source::recording(&source, run.origin(), run.seed)?;
        warn_of_doubts(&recording);
        // Counted before frames are merged, so the line numbers match the files.
        let input = input_of(&recording);
        let playing = PlaybackOptions { run_id: 0, ticks_max: source.ticks, lockstep: true };
        let playback = Playback::new(recording, playing);
        run.interval_ns = playback.interval_ns();
        Ok(Played { playback, input, run, model })
    }

    /// Checks the arguments and returns the lockstep run that they describe, before its recording is read.
    pub fn prepare(&self) -> Result<Prepared, Failure> {
        let (weights_path, weights) = self.pipeline.model.open_weights(None)?;
        let options = self.options()?;
        let sampler = options.read(&sampler::STAGE)?;
        check_memory(&sampler, &weights)?;
        check_prior(&sampler)?;
        let origin = self.read.origin.unwrap_or_default();
        check_lanes(&sampler, origin)?;
        if self.seed.is_some() && self.recording.is_some() {
            note_unused_seed(&sampler, weights.config());
        }
        let source = source::Options { recording: self.path()?, ..options.read(&source::STAGE)? };
        let run = Run {
            lockstep: true,
            seed: self.seed.unwrap_or(SEED),
            weights: weights_path,
            origin_m: origin.position_m(),
            stages: options.stage_runs(),
            ..Run::default()
        };
        Ok(Prepared { source, run, model: weights.config().clone() })
    }

    fn options(&self) -> Result<StageOptions, Failure> {
        if let Some(set) = self.pipeline.set.set.iter().find(|set| set.is_of(StageId::Source, "recording")) {
            return Err(set.refused("the recording is already an argument"));
        }
        let scene = SceneArguments {
            file: None,
            recording: None,
            format: self.read.format,
            fps: self.read.fps,
            topic: self.read.topic.clone(),
            origin: None,
            agents: None,
            noise: None,
            seed: self.seed,
            ticks: self.ticks,
        };
        let mut options = StageOptions::defaults(&IN_PROCESS);
        options.apply(&[scene.settings()?, self.pipeline.settings(None)?].concat())?;
        Ok(options)
    }
}

/// Prints a note if the seed has no effect on a recording. Only latent variables and particles are drawn at
/// random.
fn note_unused_seed(sampler: &sampler::Options, model: &ModelConfig) {
    if model.latents == Latents::Points && sampler.propagation != sampler::PropagationKind::MonteCarlo {
        tracing::info!(
            "note: --seed changes nothing here: with these weights, nothing random is drawn on a recording"
        );
    }
}
