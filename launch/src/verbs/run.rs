mod supervise;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use configuration::Pipeline;
use configuration::options::{Setting, StageOptions, absolute, text};
use configuration::pipeline_file;
use console::failure::Failure;
use console::say;
use console::{log, streams};
use localiser::MapChoice;
use nn::Weights;
use ports::{LogFormat, Space, Stop, clock_offset_ns};
use recorder::{InputReport, Report, RunInfo, SceneNoise, Status, Supervision, Verdict, is_standard_output};
use recording::About;
use run::{Exit, Run, SpareRun, StageRun};
use scene::ContextMap;
use serde_json::json;
use source::{Playback, PlaybackOptions};
use telemetry::observe::{ObserveArguments, Observer, address};
use telemetry::tap::{Recording, RingArguments, Tap};
use telemetry::watch::Watch;
use toml::Value;
use wire::{StageId, WorldOrigin};

use self::supervise::{Following, supervise};
use crate::arguments::{
    PipelineArguments, SceneArguments, Speed, canonical, check_lanes, check_memory, check_prior,
    warn_of_doubts,
};
use crate::fail_if::{self, Condition};
use crate::files::{check_place, version, within};
use crate::pages::RunReport;
use crate::play_report::input_of;
use crate::saved_state::{self, SavedState};
use crate::verbs::record;
use crate::verbs::view::{self, Page};
use crate::version;
use crate::view_arguments::ViewArguments;

/// Shared memory that must be free at the start of a run, bytes.
pub const SHARED_BYTES: u64 = 48 << 20;
/// Width of the report if the output is not a terminal.
const REPORT_WIDTH: usize = 100;

/// Arguments of `stgdat run`.
#[derive(Debug, Args)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    #[command(flatten)]
    stages: PipelineArguments,
    /// Speed of playing
    #[arg(long, value_enum, default_value = "real")]
    speed: Speed,
    /// Write the report as JSON
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Write the report as one HTML page, with the scene and the times of all ticks
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Replace the file of --html if it exists
    #[arg(long, requires = "html")]
    force: bool,
    /// Write all forecasts as JSON lines
    #[arg(long, value_name = "FILE")]
    forecasts: Option<PathBuf>,
    /// The pipeline.toml; by default the built-in one
    #[arg(long, value_name = "FILE")]
    pipeline: Option<PathBuf>,
    /// Exit with 70 if this condition holds for the report, such as `end_to_end_p99 > 75 ms`. May be
    /// repeated; an unknown name lists all figures
    #[arg(long, value_name = "CONDITION")]
    fail_if: Vec<Condition>,
    /// Record the run in this MCAP file, which must not exist
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// Topics to record, separated by commas, or `all`
    #[arg(long, value_name = "LIST", requires = "record", default_value = record::TOPICS, value_parser = record_topics)]
    record_topics: String,
    #[command(flatten)]
    ring: RingArguments,
    #[command(flatten)]
    tools: ViewArguments,
    #[command(flatten)]
    observe: ObserveArguments,
    /// Show the run in a browser (`stgdat view`): serve the page on this address or port
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, value_parser = address)]
    view: Option<Option<SocketAddr>>,
    /// Folder in which the run creates its own folder; by default $RUNTIME_DIRECTORY, $XDG_RUNTIME_DIR or
    /// /tmp
    #[arg(long, value_name = "FOLDER")]
    runtime_dir: Option<PathBuf>,
    /// Exit with 65 if the input is doubtful or no agent was forecast
    #[arg(long)]
    strict: bool,
    /// Show no progress
    #[arg(long)]
    quiet: bool,
    /// Write the path of the run's record to this file before the stages start
    #[arg(long, value_name = "FILE", hide = true)]
    announce: Option<PathBuf>,
}

/// Runs a pipeline to the end of its scene and reports. At a terminal the live page stays after the end until Ctrl-C if a
/// browser has watched.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    // Nothing that this process prints may delay the restart of a stage.
    streams::never_wait().map_err(Failure::unavailable)?;
    let stop = Stop::on_signals().map_err(Failure::unavailable)?;
    let mut page = None;
    let outcome = run_and_report(arguments, &stop, &mut page);
    let Some(page) = page.filter(|_| !stop.requested() && view::is_attended()) else { return outcome };
    let exit = outcome.unwrap_or_else(|failure| {
        failure.print();
        failure.exit()
    });
    page.stay(&stop);
    Ok(exit)
}

fn run_and_report(arguments: &Arguments, stop: &Stop, page: &mut Option<Page>) -> Result<Exit, Failure> {
    if arguments.ring.limits().is_some() && arguments.record.is_none() {
        return Err(Failure::Usage("--last: --record FILE names the files that it is written to".to_owned()));
    }
    if arguments.ring.limits().is_some() && arguments.html.is_some() {
        return Err(Failure::Usage("--html: the page needs the whole run, without --last".to_owned()));
    }
    if !arguments.tools.is_empty() && arguments.record.is_none() {
        return Err(Failure::Usage("--for: --record FILE names the file that it is written to".to_owned()));
    }
    if let Some(report) = &arguments.report {
        check_place(report)?;
    }
    let pipeline = pipeline_file::load(arguments.pipeline.as_deref())?;
    let (weights_path, weights) = arguments.stages.model.open_weights(pipeline.weights.as_deref())?;
    let mut options = StageOptions::of_pipeline(&pipeline);
    options.apply(&arguments.settings()?)?;
    let source = source_options(arguments, &options)?;
    let origin = arguments.scene.origin.or(pipeline.origin).unwrap_or_default();
    let recording = source::recording(&source, origin, arguments.scene.seed())?;
    warn_of_doubts(&recording);
    let input = match options.is_built_in(StageId::Source) {
        true => input_of(&recording),
        false => InputReport::default(),
    };
    // Read here for the recording's name, length and interval. The source reads it again in its own process.
    let playing = PlaybackOptions { ticks_max: source.ticks, ..Default::default() };
    let playback = Playback::new(recording, playing);
    let mut info = info(arguments, &options, &source, origin, &playback, weights_path.as_deref(), &weights)?;
    check_map(&mut options)?;
    let state = state_file(&mut options, arguments.speed == Speed::Max)?;

    let mut space = Space::create(arguments.runtime_dir.as_deref(), SHARED_BYTES)?;
    let report_path = report_path(&mut options, space.root())?;
    let run = Run {
        id: space.id(),
        prefix: space.prefix().to_owned(),
        root: space.root().to_owned(),
        interval_ns: playback.interval_ns(),
        lockstep: arguments.speed == Speed::Max,
        seed: arguments.scene.seed(),
        protected: pipeline.protected.clone(),
        shed: pipeline.shed,
        weights: weights_path,
        origin_m: origin.position_m(),
        stages: stage_runs(&pipeline, &options),
        spares: spare_runs(&pipeline, arguments.speed == Speed::Max),
        topics: pipeline.topics.clone(),
        readers: pipeline.readers.clone(),
    };
    weights.config().write(&run.root).map_err(Failure::data)?;
    info.precision = version::precision(&run);
    info.run_id = Some(format!("{:016x}", run.id));
    let (title, ticks_limit) = (info.recording.clone().unwrap_or_default(), Some(playback.tick_count()));
    drop((playback, weights));

    let report_before = version(&report_path);
    let state = state.zip(info.weights_sha256.clone());
    let state = state.map(|(path, sha256)| SavedState::start(&run, path, sha256)).transpose()?;
    let keeps_memory = options.get(StageId::Sampler, "memory").is_some();
    let record_file = write_record(&run, arguments.announce.as_deref())?;
    about(arguments, &info, &run)?.write(&run.root).map_err(|error| Failure::file(&run.root, error))?;
    let tap = Tap::start(&record_file)?;
    let html = arguments
        .html
        .as_deref()
        .map(|path| RunReport::new(path, arguments.record.as_deref(), arguments.force));
    let html = html.transpose()?;
    let recording = arguments.record.as_deref().or(html.as_ref().map(RunReport::recording));
    let recording = recording
        .map(|file| {
            Recording::start(&run.root, file, &arguments.record_topics, &arguments.ring, |command| {
                arguments.tools.pass_on(command);
            })
        })
        .transpose()?;
    let observer = Observer::open(&run, &arguments.observe, input.clone(), title, ticks_limit)?;
    let watch = Watch::open(&run, arguments.quiet, observer)?;
    *page = arguments.view.map(|address| Page::start(&run.root, address)).transpose()?;
    let following = Following { tap, recording, watch, state };
    space.keep();
    let ended = supervise(&pipeline, &run, &mut space, &record_file, stop, following, keeps_memory)?;
    // The report covers the run up to its end, however it ended. After a signal or failure a report exists if
    // the recorder had begun. If the recorder died too, its last saved state is used.
    let report_after = version(&report_path);
    let is_written = report_after.is_some() && report_after != report_before;
    let measured = match &ended.outcome {
        _ if is_written => Some(Report::read(&report_path).map_err(Failure::data)?),
        Ok(Exit::Done) if ended.outages.given_up().is_empty() => {
            Some(Report::read(&report_path).map_err(Failure::data)?)
        }
        _ => recorder::saved::kept_report(&run)
            .or_else(|| ended.linked.then(|| recorder::saved::empty_report(&run))),
    };
    let mut is_refused = false;
    // A run that could not start has only its failure to report.
    if let Some(measured) = measured.filter(|_| ended.outcome.is_ok() || ended.linked) {
        let ended_by = ended.outcome.as_ref().err().map(ToString::to_string);
        let mut supervision = ended.outages.into_record(ended_by);
        supervision.memory = ended.memory.into_report();
        supervision.spares = ended.spares;
        supervision.dead_readers = ended.dead_readers;
        let given_up = !supervision.given_up.is_empty();
        let mut measured = measured;
        measured.audited(&input);
        let measured = report(arguments, measured, info, supervision)?;
        ended.recorded.iter().for_each(|line| log::print_line(line));
        html.map_or(Ok(()), |html| html.write(Some(measured.clone())))?;
        if matches!(ended.outcome, Ok(Exit::Done)) {
            fail_if::check(&arguments.fail_if, &measured)?;
            if given_up {
                return Ok(Exit::Failed);
            }
            is_refused = arguments.strict && measured.is_doubtful();
        }
    }
    let exit = ended.outcome?;
    if let Some(failure) = ended.unwritten.into_iter().next() {
        return Err(failure);
    }
    let exit = if is_refused { Exit::Data } else { exit };
    ended.unkept.map_or(Ok(exit), |death| Err(death.into()))
}

impl Arguments {
    /// Returns the settings of the command line.
    fn settings(&self) -> Result<Vec<Setting>, Failure> {
        let forecasts = self.forecasts.as_deref().map(text).transpose()?;
        let forecasts =
            forecasts.map(|path| Setting::of_flag("--forecasts", StageId::Recorder, "forecasts", path));
        Ok([self.scene.settings()?, self.stages.settings(forecasts)?].concat())
    }
}

/// Returns the options of the source. The options of an external source are unknown here, so the command line
/// or the generated scene is used.
fn source_options(arguments: &Arguments, options: &StageOptions) -> Result<source::Options, Failure> {
    if options.is_built_in(StageId::Source) {
        return options.read(&source::STAGE);
    }
    let mut options = StageOptions::defaults(&[StageId::Source]);
    options.apply(&arguments.scene.settings()?)?;
    options.read(&source::STAGE)
}

/// Checks that the map can be loaded, if it is a file.
fn check_map(options: &mut StageOptions) -> Result<(), Failure> {
    let MapChoice::File(path) = options.read(&localiser::STAGE)?.map else { return Ok(()) };
    let path = canonical(&path)?;
    ContextMap::load(&path).map_err(Failure::data)?;
    options.set_path(StageId::Localiser, "map", &path)
}

/// Returns the file of the learned state: from the sampler's options, or else in the service's folder of state.
/// In lockstep there is none.
fn state_file(options: &mut StageOptions, is_lockstep: bool) -> Result<Option<PathBuf>, Failure> {
    if is_lockstep || !options.is_built_in(StageId::Sampler) {
        return Ok(None);
    }
    let named = options.read(&sampler::STAGE)?.state;
    let Some(path) = named.or_else(saved_state::file_of_service) else { return Ok(None) };
    check_place(&path)?;
    let path = absolute(&path)?;
    options.set_path(StageId::Sampler, "state", &path)?;
    Ok(Some(path))
}

/// Returns the path of the recorder's report: from its options, or else in the run's directory.
fn report_path(options: &mut StageOptions, root: &Path) -> Result<PathBuf, Failure> {
    if let Some(Value::String(path)) = options.get(StageId::Recorder, "report") {
        return Ok(path.into());
    }
    let path = root.join("report.json");
    options.set_path(StageId::Recorder, "report", &path)?;
    Ok(path)
}

/// Returns the stages for the run record, in the pipeline's order.
fn stage_runs(pipeline: &Pipeline, options: &StageOptions) -> Vec<StageRun> {
    let mut runs = options.stage_runs();
    let place = |run: &StageRun| pipeline.stages.iter().position(|stage| stage.id.number() == run.stage);
    runs.sort_by_key(place);
    for run in &mut runs {
        if let Some(stage) = place(run).map(|place| &pipeline.stages[place]) {
            run.budget_ms = stage.budget_ms;
            run.program = program(stage);
            run.reads = pipeline.read_by(stage).map(str::to_owned).collect();
            run.writes = pipeline.written_by(stage).map(str::to_owned).collect();
        }
    }
    runs
}

/// Returns the file name of a stage's external program; empty if the stage is built in.
fn program(stage: &configuration::Stage) -> String {
    let program = stage.command.as_ref().and_then(|command| Path::new(command.first()?).file_name());
    program.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Returns the spares for the run record; empty in lockstep, in which stages are not restarted.
fn spare_runs(pipeline: &Pipeline, lockstep: bool) -> Vec<SpareRun> {
    let with_spare = pipeline.stages.iter().filter(|stage| stage.spare && !lockstep);
    let topics = |stage: &configuration::Stage| {
        let topics = stage.reads.iter().chain(&stage.writes);
        topics.map(|topic| stage.topics.get(topic).unwrap_or(topic).clone()).collect()
    };
    with_spare.map(|stage| SpareRun { stage: stage.id.number(), topics: topics(stage) }).collect()
}

/// Writes the run's record. Then atomically writes the record's path to the announcement file.
fn write_record(run: &Run, announce: Option<&Path>) -> Result<PathBuf, Failure> {
    // For programs that the launcher did not start.
    let origin = run.root.join("origin");
    std::fs::write(&origin, run.origin().to_string()).map_err(|error| Failure::file(&origin, error))?;
    let prefix = run.root.join("prefix");
    std::fs::write(&prefix, &run.prefix).map_err(|error| Failure::file(&prefix, error))?;
    let record = run.root.join(ports::RECORD);
    run.write(&record).map_err(Failure::config)?;
    if let Some(announce) = announce {
        let part = announce.with_extension("part");
        std::fs::write(&part, record.as_os_str().as_encoded_bytes())
            .and_then(|()| std::fs::rename(&part, announce))
            .map_err(|error| Failure::file(announce, error))?;
    }
    Ok(record)
}

/// Completes the recorder's report, prints it, and writes it to the file of `--report`.
fn report(
    arguments: &Arguments,
    mut report: Report,
    info: RunInfo,
    supervision: Supervision,
) -> Result<Report, Failure> {
    report.supervised(supervision);
    let measured = std::mem::take(&mut report.run);
    report.run = RunInfo {
        interval_ms: measured.interval_ms.or(info.interval_ms),
        played_s: measured.played_s,
        elapsed_s: measured.elapsed_s,
        lockstep: measured.lockstep,
        ..info
    };
    match log::format() {
        LogFormat::Json => say!("{}", report_line(&report)),
        LogFormat::Text => {
            let width = rustix::termios::tcgetwinsize(std::io::stdout())
                .map_or(REPORT_WIDTH, |size| usize::from(size.ws_col).max(1));
            say!("{}", report.render(width).trim_end_matches('\n'));
        }
    }
    report.lanes.doubt().iter().for_each(|doubt| tracing::warn!("{doubt}"));
    if let Some(path) = &arguments.report {
        if is_standard_output(path) {
            streams::finish();
        }
        let (file, whole) = (path.clone(), report.clone());
        within(path, move || whole.write(&file).map_err(Failure::data))?;
    }
    Ok(report)
}

/// Most bytes of a line in systemd's journal, which splits longer lines (`LineMax=`), less some room.
const LINE_MAX: usize = 46 << 10;

/// The report as one line of JSON with the fields of the log's lines. If it is too long for a journal, `report` has
/// the verdict and the key figures only, and `whole` is false.
fn report_line(report: &Report) -> String {
    let Verdict { status, reasons } = &report.verdict;
    let level = if *status == Status::Ok { "INFO" } else { "WARN" };
    let message = [&[status.name().to_owned()], &reasons[..]].concat().join("; ");
    let mut line = json!({
        "timestamp": ports::now(), "level": level, "target": "report", "message": message,
        "run": report.run.run_id, "whole": true, "report": report,
    });
    if line.to_string().len() > LINE_MAX {
        line["whole"] = false.into();
        line["report"] =
            json!({ "verdict": report.verdict, "ticks": report.ticks, "late_ticks": report.late_ticks });
    }
    line.to_string()
}

/// Returns the facts of a run that are known before it begins.
fn info(
    arguments: &Arguments,
    options: &StageOptions,
    source: &source::Options,
    origin: WorldOrigin,
    playback: &Playback,
    weights_path: Option<&Path>,
    weights: &Weights,
) -> Result<RunInfo, Failure> {
    let mut info = RunInfo {
        weights: Some(weights_path.map_or_else(|| "onboard".into(), |path| path.display().to_string())),
        weights_sha256: Some(weights.sha256().to_owned()),
        weights_licences: weights.licences(),
        speed: arguments.speed.to_possible_value().map(|speed| speed.get_name().to_owned()),
        ticks_limit: source.ticks,
        ..RunInfo::default()
    };
    if options.is_built_in(StageId::Sampler) {
        let sampler = options.read(&sampler::STAGE)?;
        info.retrieval = Some(sampler.retrieval);
        info.memory_entries = check_memory(&sampler, weights)?;
        check_prior(&sampler)?;
        check_lanes(&sampler, origin)?;
        arguments.scene.note_unused_seed(source, &sampler, weights.config());
    }
    if options.is_built_in(StageId::Source) {
        let recording = playback.recording();
        let recorded = source.recording.is_some();
        info.recording = Some(recording.name.clone());
        info.recording_sha256 = recorded.then(|| recording.sha256.clone());
        info.seen_in_training = recorded.then(|| seen_in_training(weights, &recording.sha256)).flatten();
        info.seed = Some(arguments.scene.seed());
        info.scene_agents = (!recorded).then_some(source.agents as u64);
        info.scene_noise = (!recorded).then(|| scene_noise(source, arguments.scene.seed()));
        info.recorded_frames = recorded.then_some(recording.frames.len() as u64);
        info.thinned_by = u32::try_from(playback.thinning()).ok();
        info.interval_ms = Some(playback.interval_ns() as f64 / 1e6);
    }
    Ok(info)
}

/// The noise of the generated scene's detections.
fn scene_noise(source: &source::Options, seed: u64) -> SceneNoise {
    let scene = source::generated_scene(source, seed);
    // From the decimal digits: 0.1 as f32 is another number as f64.
    let exactly = |sigma: f32| sigma.to_string().parse().unwrap_or_else(|_| f64::from(sigma));
    SceneNoise {
        position_m: scene.position_sigma_m.map(exactly),
        heading_deg: exactly(scene.heading_sigma_rad.to_degrees()),
    }
}

/// Whether the model card lists the recording's SHA-256 among the training data; `None` without a card.
fn seen_in_training(weights: &Weights, sha256: &str) -> Option<bool> {
    weights.card().map(|card| card.to_string().contains(sha256))
}

/// Returns the description of the run for a recording.
fn about(arguments: &Arguments, info: &RunInfo, run: &Run) -> Result<About, Failure> {
    Ok(About {
        program: concat!("stgdat ", env!("CARGO_PKG_VERSION")).to_owned(),
        pipeline: pipeline_file::text(arguments.pipeline.as_deref())?,
        weights_sha256: info.weights_sha256.clone().unwrap_or_default(),
        kernels: version::kernels(run),
        scene: info.recording.clone().unwrap_or_else(|| "detections of a producer".to_owned()),
        run: run.clone(),
        clock_offset_ns: clock_offset_ns(),
        ..About::default()
    })
}

fn record_topics(list: &str) -> Result<String, String> {
    record::topics(list).map(|_| list.to_owned())
}
