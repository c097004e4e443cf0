//! The recorder as a process: reads `forecasts` and `truth`, writes a report and a file of forecasts.

use std::io;
use std::path::PathBuf;

use ports::{Stage, StageError, Stop, await_turn, monotonic_ns};
use run::Run;
use wire::{ForecastsTopic, Header, Rejected, StageId, Topic, TruthTopic, flags};

use crate::{Checkpoint, ForecastWriter, Options, Recorder, RecorderOptions, Report, STAGE};

/// Time between checkpoints: the most that a death of the recorder loses.
const KEEP_NS: u64 = 1_000_000_000;
/// Name of the checkpoint in the run's directory.
const CHECKPOINT: &str = "recorder-checkpoint.json";
/// Name of the file in the run's directory with the forecasts' errors so far, for the launcher.
const ACCURACY: &str = "accuracy.json";
/// Name of the report in the run's directory.
const REPORT: &str = "report.json";

/// Runs the stage until the recording ends or the process is asked to end. Then it writes the report.
///
/// # Errors
/// [`StageError`] if the run's options or shared memory cannot be used, or a file cannot be written.
pub fn run(run: &Run) -> Result<(), StageError> {
    let options = STAGE.options(run)?;
    let stop = Stop::on_signals().map_err(|source| StageError::File { path: run.root.clone(), source })?;
    // It continues from the final checkpoint of the previous process.
    await_turn(StageId::Recorder, &stop)?;
    let checkpoint = checkpoint_path(run);
    let kept = (ports::incarnation() > 0).then(|| Checkpoint::read(&checkpoint).ok()).flatten();
    let is_resumed = kept.is_some();
    let open_file = |path| match is_resumed {
        true => ForecastWriter::resume(path, run.origin()),
        false => ForecastWriter::create(path, run.origin()),
    };
    let mut recorder =
        kept.map_or_else(|| Recorder::new(settings(run)), |kept| Recorder::resume(settings(run), kept));
    let unwritable = |source: io::Error| {
        let path = options.forecasts.clone().unwrap_or_else(|| PathBuf::from("forecasts"));
        StageError::File { path, source }
    };
    let mut writer = options.forecasts.as_deref().map(open_file).transpose().map_err(unwritable)?;

    let mut stage = Stage::open(run, &STAGE)?;
    let forecasts = stage.subscribe_deep::<ForecastsTopic>(ForecastsTopic::DEPTH_MAX)?;
    let truth = stage.subscribe_deep::<TruthTopic>(TruthTopic::DEPTH_MAX)?;
    let mut peers = stage.peers(run)?;
    let beside = stage.beside(run)?;
    let mut kept_ns = monotonic_ns();

    while let Some(frame) = stage.take(&forecasts)? {
        // The truth of a tick is sent before its detections, so it is available when the forecasts arrive.
        while let Some(frame) = truth.receive()? {
            let result = recorder.truth(frame.header(), &frame);
            count(&mut stage, frame.header(), TruthTopic::NAME, result);
        }
        for header in beside.take()? {
            recorder.beside(&header);
        }
        peers.listen()?.iter().for_each(|heartbeat| recorder.heartbeat(heartbeat));
        if recorder.is_recorded(frame.header()) {
            continue;
        }
        let result = recorder.forecasts(frame.header(), &frame).map(|_| ());
        if let (Ok(()), Some(writer)) = (&result, &mut writer) {
            writer.write(frame.header(), &frame).map_err(unwritable)?;
        }
        count(&mut stage, frame.header(), ForecastsTopic::NAME, result);
        if frame.header().has(flags::END) {
            break;
        }
        if monotonic_ns().saturating_sub(kept_ns) >= KEEP_NS {
            kept_ns = monotonic_ns();
            if let Some(writer) = &mut writer {
                writer.flush().map_err(unwritable)?;
            }
            save(run, &mut recorder);
        }
        // In lockstep the source waits for this heartbeat before it releases the next tick.
        if frame.header().has(flags::LOCKSTEP) && frame.header().is_tick() {
            stage.beat()?;
        }
    }
    if stage.stop().requested() {
        // If this process is asked to end, another process may continue.
        save(run, &mut recorder);
    }
    if let Some(writer) = writer {
        writer.finish().map_err(unwritable)?;
    }
    // The refusals since its own last heartbeat.
    recorder.heartbeat(&stage.heartbeat());
    recorder.report().write(&report_path(run, &options)).map_err(StageError::data)
}

fn count(stage: &mut Stage, header: &Header, topic: &'static str, result: Result<(), Rejected>) {
    match result {
        Ok(()) if topic == ForecastsTopic::NAME && header.is_tick() => stage.done(header.seq),
        Ok(()) => {}
        Err(why) => stage.refuse(header, topic, &why),
    }
}

/// Saves the recorder's state, and the errors of the forecasts for the launcher. A failure is counted: only a
/// death of the recorder would lose anything by it.
fn save(run: &Run, recorder: &mut Recorder) {
    let saved = recorder.checkpoint().write(&checkpoint_path(run)).map_err(|error| error.to_string());
    let told = tell_accuracy(run, recorder).map_err(|error| error.to_string());
    if let Err(error) = saved.and(told) {
        tracing::warn!("the recorder's state is not saved: {error}");
        recorder.count_unwritten();
    }
}

/// Writes the forecasts' errors so far, for the launcher.
fn tell_accuracy(run: &Run, recorder: &Recorder) -> io::Result<()> {
    let json = serde_json::to_vec(&recorder.accuracy().errors)?;
    crate::whole_file::write(&accuracy_path(run), &json)
}

/// Path of the file with the forecasts' errors so far, as JSON of [`crate::Errors`].
#[must_use]
pub fn accuracy_path(run: &Run) -> PathBuf {
    run.root.join(ACCURACY)
}

fn checkpoint_path(run: &Run) -> PathBuf {
    run.root.join(CHECKPOINT)
}

/// The report of a run whose recorder died and was not restarted, from its last checkpoint; `None` if there
/// is no checkpoint.
#[must_use]
pub fn kept_report(run: &Run) -> Option<Report> {
    let kept = Checkpoint::read(&checkpoint_path(run)).ok()?;
    Some(Recorder::resume(settings(run), kept).report())
}

/// The report of a run whose recorder has left no checkpoint.
#[must_use]
pub fn empty_report(run: &Run) -> Report {
    Recorder::new(settings(run)).report()
}

/// Path of a run's report.
#[must_use]
pub fn report_path(run: &Run, options: &Options) -> PathBuf {
    options.report.clone().unwrap_or_else(|| run.root.join(REPORT))
}

fn settings(run: &Run) -> RecorderOptions {
    RecorderOptions { stages: run.order(), budgets_ms: run.budgets_ms(), ..RecorderOptions::default() }
}
