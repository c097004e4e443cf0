use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use clap::{Args, ValueEnum};
use config::Pipeline;
use localiser::MapChoice;
use nn::Weights;
use ports::{Space, Stop};
use recorder::live::LiveOptions;
use recorder::{Report, RunInfo};
use run::{Exit, Run, StageRun};
use scene::ContextMap;
use source::{Playback, PlaybackOptions};
use toml::Value;
use wire::StageId;

use crate::arguments::{
    ModelArguments, RetrievalArguments, SceneArguments, SetArguments, TrackerArguments, canonical,
    check_memory,
};
use crate::failure::{Failure, StageDeath};
use crate::fleet::Fleet;
use crate::options::{Setting, StageOptions, text};
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
    retrieval: RetrievalArguments,
    #[command(flatten)]
    set: SetArguments,
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
    let mut options = StageOptions::of_pipeline(&pipeline);
    options.apply(&arguments.settings()?)?;
    let source = source_options(arguments, &options)?;
    let recording = source::recording(&source, arguments.scene.seed)?;
    // Read here only for what it tells of itself; the source reads it again in its own process.
    let playing = PlaybackOptions { ticks_max: source.ticks, ..Default::default() };
    let playback = Playback::new(recording, playing);
    let info = info(arguments, &options, &source, &playback, weights_path.as_deref(), &weights)?;
    check_map(&mut options)?;

    let run_id = random_id()?;
    let space = Space::create(run_id, SHARED_BYTES)?;
    let report_path = report_path(&mut options, space.root())?;
    let run = Run {
        id: run_id,
        prefix: space.prefix().to_owned(),
        root: space.root().to_owned(),
        interval_ns: playback.interval_ns(),
        lockstep: arguments.speed == Speed::Max,
        seed: arguments.scene.seed,
        weights: weights_path,
        stages: stage_runs(&pipeline, &options),
    };
    weights.config().write(&run.root).map_err(Failure::data)?;
    let live = live_options(&run, &info, playback.ticks_len());
    drop((playback, weights));

    let begun = SystemTime::now();
    let keeps_memory = options.get(StageId::Sampler, "memory").is_some();
    let (exit, unkept) = supervise(&pipeline, &run, &stop, live, arguments.quiet, keeps_memory)?;
    // Where a signal broke the run off, the report tells of what there was: nothing, if the recorder had not begun.
    let written = std::fs::metadata(&report_path).and_then(|file| file.modified());
    if exit == Exit::Done || written.is_ok_and(|written| written >= begun) {
        report(arguments, &report_path, info)?;
    }
    unkept.map_or(Ok(exit), |death| Err(death.into()))
}

impl Arguments {
    /// What the command line sets of the stages.
    fn settings(&self) -> Result<Vec<Setting>, Failure> {
        let forecasts = self.forecasts.as_deref().map(text).transpose()?;
        let forecasts =
            forecasts.map(|path| Setting::of_flag("--forecasts", StageId::Recorder, "forecasts", path));
        let settings = [
            self.scene.settings()?,
            self.tracker.settings(),
            self.model.settings(),
            self.retrieval.settings()?,
            forecasts.into_iter().collect(),
            self.set.set.clone(),
        ];
        Ok(settings.concat())
    }
}

/// What the source plays. What a program of the user's own plays is not known here: what the command line tells of it, or the
/// generated scene, stands for it.
fn source_options(arguments: &Arguments, options: &StageOptions) -> Result<source::Options, Failure> {
    if options.is_built_in(StageId::Source) {
        return options.read(&source::STAGE);
    }
    let mut told = StageOptions::defaults(&[StageId::Source]);
    told.apply(&arguments.scene.settings()?)?;
    told.read(&source::STAGE)
}

/// Opens a map that is a file, to see that it is one.
fn check_map(options: &mut StageOptions) -> Result<(), Failure> {
    let MapChoice::File(path) = options.read(&localiser::STAGE)?.map else { return Ok(()) };
    let path = canonical(&path)?;
    ContextMap::load(&path).map_err(Failure::data)?;
    options.set_path(StageId::Localiser, "map", &path)
}

/// Where the recorder writes its report: as its options tell, else in the run's directory.
fn report_path(options: &mut StageOptions, root: &Path) -> Result<PathBuf, Failure> {
    if let Some(Value::String(path)) = options.get(StageId::Recorder, "report") {
        return Ok(path.into());
    }
    let path = root.join("report.json");
    options.set_path(StageId::Recorder, "report", &path)?;
    Ok(path)
}

/// How the stages of a pipeline are run with these options, in the pipeline's order.
fn stage_runs(pipeline: &Pipeline, options: &StageOptions) -> Vec<StageRun> {
    let mut runs = options.stage_runs();
    let place = |run: &StageRun| pipeline.stages.iter().position(|stage| stage.id as u32 == run.stage);
    runs.sort_by_key(place);
    for run in &mut runs {
        run.budget_ms = place(run).and_then(|place| pipeline.stages[place].budget_ms);
    }
    runs
}

/// Starts the stages, follows them to the end of the scene, and ends them. Tells of a sampler that could not keep its memory of
/// the place.
fn supervise(
    pipeline: &Pipeline,
    run: &Run,
    stop: &Stop,
    live: LiveOptions,
    quiet: bool,
    keeps_memory: bool,
) -> Result<(Exit, Option<StageDeath>), Failure> {
    let record = run.root.join("run");
    run.write(&record).map_err(|error| Failure::Config(error.to_string()))?;
    let mut watch = Watch::open(run, live, quiet)?;
    let mut fleet = Fleet::start(pipeline, run, &record, keeps_memory)?;
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
    let unkept = keeps_memory.then(|| fleet.failure(StageId::Sampler)).flatten();
    watch.close(fleet.lines());
    outcome.map(|exit| (exit, unkept))
}

/// Completes the recorder's report, prints it, and writes it where that is asked for.
fn report(arguments: &Arguments, written: &Path, info: RunInfo) -> Result<(), Failure> {
    let mut report = Report::read(written).map_err(Failure::data)?;
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

/// What is known of a run before it begins.
fn info(
    arguments: &Arguments,
    options: &StageOptions,
    source: &source::Options,
    playback: &Playback,
    weights_path: Option<&Path>,
    weights: &Weights,
) -> Result<RunInfo, Failure> {
    let mut info = RunInfo {
        weights: Some(weights_path.map_or_else(|| "onboard".into(), |path| path.display().to_string())),
        weights_sha256: Some(weights.sha256().to_owned()),
        speed: arguments.speed.to_possible_value().map(|speed| speed.get_name().to_owned()),
        ticks_limit: source.ticks,
        ..RunInfo::default()
    };
    if options.is_built_in(StageId::Sampler) {
        let sampler = options.read(&sampler::STAGE)?;
        info.recalls = Some(sampler.retrieval);
        info.memory_moments = check_memory(&sampler, weights)?;
    }
    if options.is_built_in(StageId::Source) {
        let recording = playback.recording();
        let recorded = source.recording.is_some();
        info.recording = Some(recording.name.clone());
        info.recording_sha256 = recorded.then(|| recording.sha256.clone());
        info.seen_in_training = recorded.then(|| seen_in_training(weights, &recording.sha256)).flatten();
        info.seed = Some(arguments.scene.seed);
        info.scene_agents = (!recorded).then_some(source.agents as u64);
        info.recorded_frames = recorded.then_some(recording.frames.len() as u64);
        info.thinned_by = u32::try_from(playback.thinning()).ok();
        info.interval_ms = Some(playback.interval_ns() as f64 / 1e6);
    }
    Ok(info)
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

/// A number that no other run has.
fn random_id() -> Result<u64, Failure> {
    let mut bytes = [0; 8];
    let urandom = Path::new("/dev/urandom");
    std::fs::File::open(urandom)
        .and_then(|mut file| std::io::Read::read_exact(&mut file, &mut bytes))
        .map_err(|error| Failure::file(urandom, &error))?;
    Ok(u64::from_le_bytes(bytes))
}
