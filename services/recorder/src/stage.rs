//! The recorder as a process: reads `forecasts` and `truth`, writes a report and a file of forecasts.

use ports::{Stage, StageError, Stop, await_turn, clock_offset_ns, monotonic_ns};
use run::Run;
use wire::{ForecastsTopic, Header, Rejected, StageId, Topic, TruthTopic, flags};

use crate::STAGE;
use crate::saved::{report_path, resume, save};

/// Time between checkpoints: the most that a death of the recorder loses.
const KEEP_NS: u64 = 1_000_000_000;

/// Runs the stage until the recording ends or the process is asked to end. Then it writes the report.
///
/// # Errors
/// [`StageError`] if the run's options or shared memory cannot be used, or a file cannot be written.
pub fn run(run: &Run) -> Result<(), StageError> {
    let options = STAGE.options(run)?;
    let stop = Stop::on_signals().map_err(|source| StageError::File { path: run.root.clone(), source })?;
    // It continues from the final checkpoint of the previous process.
    await_turn(StageId::Recorder, &stop)?;
    let (mut recorder, mut file) = resume(run, &options)?;
    let mut stage = Stage::open(run, &STAGE)?;
    let forecasts = stage.subscribe_deep::<ForecastsTopic>(ForecastsTopic::DEPTH_MAX)?;
    let truth = stage.subscribe_deep::<TruthTopic>(TruthTopic::DEPTH_MAX)?;
    let mut peers = stage.peers(run)?;
    let side_outputs = stage.side_outputs(run)?;
    let mut kept_ns = monotonic_ns();

    while let Some(frame) = stage.take(&forecasts)? {
        // The truth of a tick is sent before its detections, so it is available when the forecasts arrive.
        while let Some(frame) = truth.receive()? {
            let result = recorder.truth(frame.header(), &frame);
            count(&mut stage, frame.header(), TruthTopic::NAME, result);
        }
        for header in side_outputs.take()? {
            recorder.added_stage(&header);
        }
        peers.listen()?.iter().for_each(|heartbeat| recorder.heartbeat(heartbeat));
        if recorder.is_recorded(frame.header()) {
            continue;
        }
        recorder.set_clock_offset(clock_offset_ns());
        let result = recorder.forecasts(frame.header(), &frame).map(|_| ());
        if result.is_ok() {
            file.write(frame.header(), &frame)?;
        }
        count(&mut stage, frame.header(), ForecastsTopic::NAME, result);
        if frame.header().has(flags::END) {
            break;
        }
        if monotonic_ns().saturating_sub(kept_ns) >= KEEP_NS {
            kept_ns = monotonic_ns();
            file.flush()?;
            save(run, &mut recorder);
        }
        // In lockstep the source waits for this heartbeat before it releases the next tick.
        if frame.header().has(flags::LOCKSTEP) && frame.header().is_tick() {
            stage.beat()?;
        }
    }
    if stage.stop().requested() {
        recorder.end(monotonic_ns());
        // If this process is asked to end, another process may continue.
        save(run, &mut recorder);
    }
    file.finish()?;
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
