use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use config::{Exit, MapChoice, Options, Pipeline, Run, Stage, StageRun};
use nn::Weights;
use ports::{Space, Stop};
use recorder::live::LiveOptions;
use recorder::{Report, RunInfo};
use source::{Playback, PlaybackOptions};
use wire::StageId;

use crate::arguments::{ModelArguments, PlaceArguments, SceneArguments, TrackerArguments};
use crate::failure::{Failure, StageDeath};
use crate::fleet::Fleet;
use crate::pipeline_file;
use crate::watch::Watch;

/// Time in which all stages must have started and be linked to their neighbours.
const START_LIMIT: Duration = Duration::from_secs(45);
/// Shared memory that a run may need.
const SHARED_BYTES: u64 = 48 << 20;
/// Width of the report where no terminal tells its own.
const REPORT_WIDTH: usize = 100;

/// Arguments of `stgdat run`.
#[derive(Debug, Args)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    #[command(flatten)]
    tracker: TrackerArguments,
    #[command(flatten)]
    model: ModelArguments,
    #[command(flatten)]
    place: PlaceArguments,
    /// Play in the recording's own time, or as fast as nothing is lost
    #[arg(long, value_enum, default_value = "real")]
    speed: Speed,
    /// Write the report as JSON
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Write all forecasts as JSON lines
    #[arg(long, value_name = "FILE")]
    forecasts: Option<PathBuf>,
    /// The stages and how they are wired
    #[arg(long, value_name = "FILE")]
    pipeline: Option<PathBuf>,
    /// Show nothing while it runs
    #[arg(long)]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Speed {
    /// At the recording's own rate
    Real,
    /// In lockstep: each tick waits for the forecasts of the one before
    Max,
}

/// Runs a pipeline to the end of its scene and reports.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let stop = Stop::on_signals().map_err(|error| Failure::Unavailable(error.to_string()))?;
    let pipeline = pipeline_file::load(arguments.pipeline.as_deref())?;
    let (weights_path, weights) = arguments.model.open_weights(pipeline.weights.as_deref())?;
    let scene = &arguments.scene;
    let recording = source::recording(&scene.scene()?, scene.seed, scene.ticks)?;
    // Read here only for what it tells of itself; the source reads it again in its own process.
    let playback = Playback::new(recording, PlaybackOptions { ticks_max: scene.ticks, ..Default::default() });
    let info = match pipeline.stages.iter().find(|stage| stage.id == StageId::Source) {
        // What a source of the user's own plays is not known here.
        Some(Stage { command: Some(_), .. }) => model_info(arguments, weights_path.as_deref(), &weights),
        _ => info(arguments, &playback, weights_path.as_deref(), &weights),
    };

    let tracker = options(&pipeline, StageId::Tracker);
    let sampler = options(&pipeline, StageId::Sampler);
    let recall = arguments.place.recalls(sampler.recall);
    let memory = arguments.place.memory(sampler.memory.as_deref(), &weights)?;
    let memory_moments = memory.as_ref().map(|kept| kept.moments_len as u64);
    let info = RunInfo { recalls: Some(recall), memory_moments, ..info };
    let run_id = random_id()?;
    let space = Space::create(run_id, SHARED_BYTES)?;
    let run = Run {
        id: run_id,
        prefix: space.prefix().to_owned(),
        root: space.root().to_owned(),
        interval_ns: playback.interval_ns(),
        lockstep: arguments.speed == Speed::Max,
        seed: scene.seed,
        scene: scene.scene()?,
        ticks: scene.ticks,
        associate: arguments.tracker.associate,
        prior: arguments.tracker.prior.or(tracker.prior).unwrap_or_default(),
        association: arguments.tracker.association.or(tracker.association).unwrap_or_default(),
        view: arguments.tracker.view.or(tracker.view),
        recall,
        memory: memory.map(|kept| kept.path),
        weights: weights_path,
        model: weights.config().clone(),
        map: map(&arguments.model, &pipeline)?,
        report: space.root().join("report.json"),
        forecasts: arguments.forecasts.as_deref().map(absolute).transpose()?,
        stages: pipeline.stages.iter().map(stage_run).collect(),
    };
    let live = live_options(&run, &info, playback.ticks_len());
    drop((playback, weights));

    let (exit, unkept) = supervise(&pipeline, &run, &stop, live, arguments.quiet)?;
    // Where a signal broke the run off, the report tells of what there was: nothing, if the recorder had not begun.
    if exit == Exit::Done || run.report.exists() {
        report(arguments, &run, info)?;
    }
    unkept.map_or(Ok(exit), |death| Err(death.into()))
}

/// Starts the stages, follows them to the end of the scene, and ends them. Tells of a sampler that could not keep its memory of
/// the place.
fn supervise(
    pipeline: &Pipeline,
    run: &Run,
    stop: &Stop,
    live: LiveOptions,
    quiet: bool,
) -> Result<(Exit, Option<StageDeath>), Failure> {
    let record = run.root.join("run");
    run.write(&record).map_err(|error| Failure::Config(error.to_string()))?;
    let mut watch = Watch::open(run, live, quiet)?;
    let mut fleet = Fleet::start(pipeline, run, &record)?;
    let started = Instant::now();
    let mut linked = false;
    let outcome = loop {
        watch.follow(fleet.lines())?;
        if let Some(exit) = stop.exit() {
            break Ok(exit);
        }
        if let Some(death) = fleet.death() {
            break Err(death.into());
        }
        if fleet.done(StageId::Recorder) {
            break Ok(Exit::Done);
        }
        linked = linked || watch.unlinked().is_empty();
        if !linked && started.elapsed() > START_LIMIT {
            let names: Vec<&str> = watch.unlinked().into_iter().map(StageId::name).collect();
            let seconds = START_LIMIT.as_secs();
            break Err(Failure::Failed(format!("not linked after {seconds} s: {}", names.join(", "))));
        }
    };
    fleet.end();
    let unkept = run.memory.is_some().then(|| fleet.failure(StageId::Sampler)).flatten();
    watch.close(fleet.lines());
    outcome.map(|exit| (exit, unkept))
}

/// Completes the recorder's report, prints it, and writes it where that is asked for.
fn report(arguments: &Arguments, run: &Run, info: RunInfo) -> Result<(), Failure> {
    let mut report = Report::read(&run.report).map_err(Failure::data)?;
    let heard = std::mem::take(&mut report.run);
    report.run = RunInfo {
        interval_ms: heard.interval_ms.or(info.interval_ms),
        played_s: heard.played_s,
        elapsed_s: heard.elapsed_s,
        lockstep: heard.lockstep,
        ..info
    };
    if let Some(path) = &arguments.report {
        report.write(path).map_err(Failure::data)?;
    }
    let width = rustix::termios::tcgetwinsize(std::io::stdout())
        .map_or(REPORT_WIDTH, |size| usize::from(size.ws_col).max(1));
    print!("{}", report.render(width));
    Ok(())
}

fn info(
    arguments: &Arguments,
    playback: &Playback,
    weights_path: Option<&Path>,
    weights: &Weights,
) -> RunInfo {
    let recording = playback.recording();
    let recorded = arguments.scene.recording.is_some();
    RunInfo {
        recording: Some(recording.name.clone()),
        recording_sha256: recorded.then(|| recording.sha256.clone()),
        seen_in_training: recorded.then(|| seen_in_training(weights, &recording.sha256)).flatten(),
        seed: Some(arguments.scene.seed),
        scene_agents: (!recorded).then(|| u64::from(arguments.scene.agents)),
        recorded_frames: recorded.then_some(recording.frames.len() as u64),
        thinned_by: u32::try_from(playback.thinning()).ok(),
        interval_ms: Some(playback.interval_ns() as f64 / 1e6),
        ..model_info(arguments, weights_path, weights)
    }
}

/// What is known of a run whatever it plays.
fn model_info(arguments: &Arguments, weights_path: Option<&Path>, weights: &Weights) -> RunInfo {
    RunInfo {
        weights: Some(weights_path.map_or_else(|| "onboard".into(), |path| path.display().to_string())),
        weights_sha256: Some(weights.sha256().to_owned()),
        speed: arguments.speed.to_possible_value().map(|speed| speed.get_name().to_owned()),
        ticks_limit: arguments.scene.ticks,
        ..RunInfo::default()
    }
}

/// Whether the model card names the recording's fingerprint among what the weights were trained on, where there is one.
fn seen_in_training(weights: &Weights, sha256: &str) -> Option<bool> {
    weights.card().map(|card| card.to_string().contains(sha256))
}

fn live_options(run: &Run, info: &RunInfo, ticks_len: u64) -> LiveOptions {
    LiveOptions {
        title: info.recording.clone().unwrap_or_default(),
        budgets_ms: run.budgets_ms(),
        ticks_limit: Some(ticks_len),
        ..LiveOptions::default()
    }
}

fn stage_run(stage: &Stage) -> StageRun {
    StageRun {
        stage: stage.id as u32,
        budget_ms: stage.budget_ms,
        built_in: stage.command.is_none(),
        options: stage.options.clone(),
    }
}

/// What the pipeline's file sets of a stage.
fn options(pipeline: &Pipeline, id: StageId) -> Options {
    let stage = pipeline.stages.iter().find(|stage| stage.id == id);
    stage.map(|stage| stage.options.clone()).unwrap_or_default()
}

/// The map that is asked for, else the pipeline's.
fn map(model: &ModelArguments, pipeline: &Pipeline) -> Result<MapChoice, Failure> {
    let of_pipeline = options(pipeline, StageId::Localiser).map;
    match model.map.clone().or(of_pipeline).unwrap_or_default() {
        MapChoice::File(path) => {
            let path = path.canonicalize().map_err(|error| Failure::file(&path, &error))?;
            scene::ContextMap::load(&path).map_err(Failure::data)?;
            Ok(MapChoice::File(path))
        }
        other => Ok(other),
    }
}

/// The path from the root: stages may run elsewhere.
fn absolute(path: &Path) -> Result<PathBuf, Failure> {
    std::path::absolute(path).map_err(|error| Failure::file(path, &error))
}

/// A number that no other run has.
fn random_id() -> Result<u64, Failure> {
    let mut bytes = [0; 8];
    let urandom = Path::new("/dev/urandom");
    std::fs::File::open(urandom)
        .and_then(|mut file| std::io::Read::read_exact(&mut file, &mut bytes))
        .map_err(|error| Failure::file(urandom, &error))?;
    Ok(u64::from_le_bytes(bytes))
}
