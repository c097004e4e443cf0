//! The life of a run: its stages are started, followed and ended.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use configuration::stages;
use configuration::{Pipeline, Stage};
use console::failure::{Failure, StageDeath};
use console::log;
use nn::kernels;
use ports::{Space, Stop, Topics};
use recorder::SpareReport;
use recording::Happened;
use run::{Exit, Run};
use supervisor::control::{Control, Request};
use supervisor::scheduling;
use supervisor::{Fleet, Program, Settings, StageSettings};
use telemetry::memory::Memory;
use telemetry::outages::Outages;
use telemetry::service::{self, Phase, Service};
use telemetry::tap::{Recording, Tap};
use telemetry::watch::Watch;
use wire::StageId;

use crate::awake::Awake;
use crate::saved_state::SavedState;

/// Time limit for all stages to start and to link to their neighbours. A run waits for a detector of others
/// without a limit.
const START_LIMIT: Duration = Duration::from_secs(45);
/// Time after which a run that has not begun waits for its detector. Built-in stages start within a second.
const DETECTOR_LIMIT: Duration = Duration::from_secs(3);
/// How a run ended.
pub(super) struct Ended {
    /// The exit code, or the failure that ended the run early.
    pub outcome: Result<Exit, Failure>,
    /// The failure of a sampler that could not write its retrieval memory.
    pub unkept: Option<StageDeath>,
    /// Whether the pipeline was linked, which means that the run had begun.
    pub linked: bool,
    pub outages: Outages,
    pub memory: Memory,
    /// The outcome of each spare.
    pub spares: BTreeMap<String, SpareReport>,
    /// Number of dead processes that read topics and were not stages.
    pub dead_readers: u64,
    /// The recording's final lines about its file.
    pub recorded: Vec<String>,
    /// Files about the run that could not be written.
    pub unwritten: Vec<Failure>,
}

/// The observers of a run besides its stages.
pub(super) struct Following {
    pub tap: Tap,
    pub recording: Option<Recording>,
    pub watch: Watch,
    pub state: Option<SavedState>,
}

/// Starts the stages, follows them to the end of the scene, and ends them.
pub(super) fn supervise(
    pipeline: &Pipeline,
    run: &Run,
    space: &mut Space,
    record: &Path,
    stop: &Stop,
    following: Following,
    keeps_memory: bool,
) -> Result<Ended, Failure> {
    let Following { mut tap, recording, mut watch, state } = following;
    let control = Control::open(run)?;
    ports::log_run(&run.root);
    // The first process that opens a topic creates it. An external program would not reserve places for
    // others.
    let has_places = !run.spares.is_empty() || !run.readers.is_empty();
    let _topics = has_places.then(|| Topics::make(run)).transpose()?;
    let limits = scheduling::raise_limits(pipeline.realtime.lock);
    let messages = tap.messages();
    let sink = move |stage: StageId, line: &str| {
        log::relay(stage, line);
        messages.line(stage, line);
    };
    let settings = settings(pipeline, run, record, keeps_memory);
    let mut fleet = Fleet::start(settings, Box::new(sink))?;
    fleet.notes().into_iter().chain(limits).chain(service::missed_limits()).for_each(|note| watch.note(note));
    let _awake =
        pipeline.realtime.awake.then(Awake::hold).and_then(|held| held.map_err(|note| watch.note(note)).ok());
    let mut memory = Memory::default();
    let started = Instant::now();
    let mut linked = false;
    let has_detector = pipeline.stages.iter().any(|s| s.id == StageId::Source && s.command.is_some());
    let may_wait = has_detector && !run.lockstep;
    let mut service = Service::of_environment(run, started)?;
    let outcome = loop {
        match space.tend() {
            0 => {}
            files => watch.restored(files),
        }
        if tap.tend() {
            fleet.clean_up();
        }
        fleet.note_process(tap.pid());
        let heartbeats = match watch.follow(&fleet) {
            Ok(heartbeats) => heartbeats,
            Err(failure) => break Err(failure),
        };
        heartbeats.iter().for_each(|heartbeat| memory.heartbeat(heartbeat));
        if let Some(exit) = stop.exit() {
            break Ok(exit);
        }
        if !linked && watch.unlinked().is_empty() {
            linked = true;
            tap.event(Happened::Linked);
        }
        match fleet.tend(&heartbeats, linked, space.is_restoring()) {
            Ok(events) => events.iter().for_each(|event| {
                watch.say(event);
                event.happened().into_iter().for_each(|what| tap.event(what));
            }),
            Err(failure) => break Err(failure.into()),
        }
        let waits = may_wait && !linked && (fleet.awaits_source() || started.elapsed() > DETECTOR_LIMIT);
        watch.wait_for(waits.then_some(StageId::Source));
        watch.answer(&fleet, linked);
        if let Some(service) = &mut service {
            let phase = match linked {
                true if watch.ticks() > 0 => Phase::Ready,
                false if waits => Phase::Waiting,
                _ => Phase::Starting,
            };
            service.tend(&heartbeats, phase, || watch.status(&fleet).service_line(), Instant::now());
        }
        if let Err(failure) = replace(&mut watch, &mut tap, &mut fleet, &control, run, linked) {
            break Err(failure);
        }
        if fleet.done(StageId::Recorder) || fleet.is_over() {
            break Ok(Exit::Done);
        }
        if !linked && !waits && started.elapsed() > START_LIMIT {
            let names: Vec<&str> = watch.unlinked().into_iter().map(StageId::name).collect();
            let seconds = START_LIMIT.as_secs();
            break Err(Failure::Failed(format!("not linked after {seconds} s: {}", names.join(", "))));
        }
    };
    let (spares, dead_readers) = (fleet.spare_reports(), fleet.dead_readers());
    let undead = fleet.end();
    let how = outcome.as_ref().map_or_else(ToString::to_string, |exit| format!("{exit:?}").to_lowercase());
    tap.event(Happened::Ended { how });
    tap.end();
    let mut recorded = Vec::new();
    if let Some(recording) = recording {
        let (lines, is_whole) = recording.end();
        recorded = lines;
        if !is_whole {
            recorded
                .push("the recording is incomplete: it is readable up to its last whole chunk".to_owned());
        }
    }
    let unkept = keeps_memory.then(|| fleet.failure(StageId::Sampler)).flatten();
    let (outages, mut unwritten) = watch.close(&undead, &fleet);
    unwritten.extend(state.and_then(|state| state.end().err()));
    Ok(Ended { outcome, unkept, linked, outages, memory, spares, dead_readers, recorded, unwritten })
}

/// The rules for the processes of a run.
fn settings(pipeline: &Pipeline, run: &Run, record: &Path, keeps_memory: bool) -> Settings {
    let stage = |stage: &Stage| {
        let topics = stage.topics.iter().map(|(topic, name)| format!("{topic}={name}")).collect();
        let (command, scheduling) = (stage.command.clone(), stage.scheduling.clone());
        let program = Program { command, topics, scheduling, record: None };
        StageSettings { stage: stage.id, program, restart: stage.restart, has_spare: stage.spare }
    };
    let isa = kernels::forced().map(|isa| (kernels::VARIABLE, isa.key()));
    let variables = isa.into_iter().chain([log::variable()]);
    Settings {
        stages: pipeline.stages.iter().map(stage).collect(),
        run: run.clone(),
        record: record.to_owned(),
        keeps_memory,
        environment: variables.map(|(name, value)| (name.to_owned(), value.to_owned())).collect(),
        check: |stage, options| stages::built_in(stage).map_or(Ok(()), |stage| stage.declared.check(options)),
    }
}

/// Accepts orders to replace stages. Lets a warm process take over between two ticks.
fn replace(
    watch: &mut Watch,
    tap: &mut Tap,
    fleet: &mut Fleet,
    control: &Control,
    run: &Run,
    linked: bool,
) -> Result<(), Failure> {
    for request in control.requests() {
        match request {
            Request::Replace(order, client) => fleet.replace(&order, client, linked),
            Request::Ready(stage, incarnation, client) => {
                fleet.ready(stage, incarnation, client, watch.ticks());
            }
        }
    }
    if fleet.is_warm(watch.ticks()) {
        watch.await_tick(Duration::from_nanos(2 * run.interval_ns))?;
        if let Some(event) = fleet.hand_over()? {
            watch.say(&event);
            event.happened().into_iter().for_each(|what| tap.event(what));
        }
    }
    fleet.passed(|stage| watch.passed(stage));
    Ok(())
}
