//! The source as a process: reads a recording or generates a scene, and publishes `detections` and `truth`.

use ports::{Stage, StageError, monotonic_ns};
use run::Run;

use crate::outputs::{Outputs, REPEAT_NS};
use crate::pace::Pace;
use crate::plan::Plan;
use crate::{Playback, PlaybackOptions, STAGE, recording};

/// Longest wait for the stages to link and, in lockstep, for the forecasts of a tick.
pub(crate) const ANSWER_LIMIT_NS: u64 = 60_000_000_000;
/// Longest wait for the last tick to pass, and then for the end frame to reach the stages.
pub(crate) const END_LIMIT_NS: u64 = 2_000_000_000;

/// Runs the stage until the scene has ended or the process is asked to end.
///
/// # Errors
/// [`StageError`] if the scene or the run's shared memory can't be used, or the other stages do not answer.
pub fn run(run: &Run) -> Result<(), StageError> {
    let options = STAGE.options(run)?;
    let scene = recording(&options, run.origin(), run.seed)?;
    let options = PlaybackOptions { run_id: run.id, ticks_max: options.ticks, lockstep: run.lockstep };
    let mut playback = Playback::new(scene, options);

    let mut stage = Stage::open(run, &STAGE)?;
    let mut outputs = Outputs::open(&mut stage, run)?;

    let warm_up = playback.warm_up();
    let plan = Plan::of(run);
    let earlier_ns = (stage.incarnation() > 0).then(|| plan.start_ns()).flatten();
    let mut pace = if let Some(start_ns) = earlier_ns {
        let answered = outputs.take_over(&mut stage, warm_up)?;
        // Resume at the tick that is due. Earlier ticks are lost, or the tracker has predicted them.
        let due_ns = monotonic_ns().saturating_sub(start_ns);
        playback.skip_to(due_ns, answered.map_or(0, |seq| seq + 1));
        Pace::new(start_ns, playback.interval_ns())
    } else {
        outputs.repeat(&mut stage, warm_up, ANSWER_LIMIT_NS, |peers| peers.unlinked().is_empty())?;
        // Let the warm-up frames pass before the first tick.
        Pace::new(monotonic_ns() + 2 * REPEAT_NS, playback.interval_ns())
    };
    let mut planned_ns = None;

    while let Some(tick) = playback.next_tick() {
        let due_ns = if run.lockstep { 0 } else { tick.due_ns };
        if !stage.sleep_until(pace.release_ns(due_ns, monotonic_ns()))? {
            return Ok(());
        }
        if planned_ns != Some(pace.start_ns()) {
            planned_ns = Some(pace.start_ns());
            plan.write(pace.start_ns())?;
        }
        outputs.send(&mut stage, &tick)?;
        if run.lockstep {
            outputs.wait_for_forecasts(&mut stage, tick.header.seq, ANSWER_LIMIT_NS)?;
        }
    }

    let end = playback.end();
    // The end frame must not push the last tick out of a queue. After END_LIMIT_NS it is sent anyway.
    let _ = outputs.wait_for_forecasts(&mut stage, end.seq.saturating_sub(1), END_LIMIT_NS);
    let _ = outputs.repeat(&mut stage, end, END_LIMIT_NS, |_| false);
    Ok(())
}
