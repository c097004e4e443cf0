//! The sampler as a process: it receives `tracks` and `controls`, and sends `forecasts` with or without
//! controls.

use model::ModelConfig;
use ports::{Awaited, Loan, PortError, Publisher, Stage, StageError};
use run::Run;
use wire::{Cause, ControlsTopic, ForecastsTopic, Topic, TracksTopic, flags};

use crate::memory::journal;
pub use crate::memory::{open, save_memory};
use crate::{STAGE, Sampler};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] if the run's model, options, shared memory or memory file can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
    let mut sampler = open(run, &model)?;
    let followed = follow(run, &model, &mut sampler);
    let saved = save_memory(run, &sampler);
    followed.and(saved)
}

/// Answers every tick with forecasts.
fn follow(run: &Run, model: &ModelConfig, sampler: &mut Sampler) -> Result<(), StageError> {
    let options = STAGE.options(run)?;
    let deadline_ns = run.interval_ns.min((options.deadline_ms * 1e6) as u64);

    let mut stage = Stage::open(run, &STAGE)?;
    let tracks = stage.subscribe::<TracksTopic>()?;
    let controls = stage.subscribe::<ControlsTopic>()?;
    let output = stage.publish_after::<ForecastsTopic>(|header, sent| sampler.follow(header, sent))?;
    // A spare process opens the journal only now, when it takes over.
    let mut journal = journal(run, sampler, stage.incarnation());

    loop {
        let input = match stage.next_until(&tracks, &output, None)? {
            Awaited::Frame(input) => input,
            Awaited::Void(tracks) => {
                // Their controls are VOID as well. They are removed from the queue, because they would push
                // out later controls there, which would look like gaps.
                if tracks.header().is_tick() {
                    controls.of_tick(tracks.header().seq)?;
                }
                continue;
            }
            Awaited::Late | Awaited::Lost => continue,
            Awaited::Stopped => break,
        };
        let mut header = *input.header();
        let until_ns = (!header.has(flags::LOCKSTEP)).then_some(header.released_ns + deadline_ns);
        let awaited = stage.wait_for(&controls, header.seq, until_ns)?;
        let mut loan = output.loan(input.len())?;
        let (mut passage, learned) = match awaited {
            Awaited::Frame(controls) => {
                let passage = stage.begin(&controls);
                header.shed = controls.header().shed;
                let learned = sampler.learned(&header, &input, &controls, &mut loan).map_err(|why| {
                    stage.refuse(controls.header(), ControlsTopic::NAME, &why);
                    Cause::Rejected
                });
                (passage, learned)
            }
            Awaited::Void(controls) => (stage.begin(&controls), Err(Cause::Rejected)),
            Awaited::Lost => (stage.begin(&input), Err(Cause::Rejected)),
            Awaited::Late => (stage.begin(&input), Err(Cause::Late)),
            Awaited::Stopped => break,
        };
        let written = match learned {
            Ok(written) => Ok(written),
            Err(cause) => sampler.fallback(&header, &input, cause, &mut loan),
        };
        // The header comes from the tracks, the hops from the controls.
        passage.header = header.with_hops_of(&passage.header);
        passage.header.counts.horizon_len = model.horizon_len as u32;
        passage.header.counts.modes_len = model.modes as u32;
        passage.header.resumed_ticks = sampler.resumed_ticks();
        let result = match written {
            Ok(written) if written < input.len() => {
                passage.header.counts.agents_len = written as u32;
                passage.header.silent_len = (input.len() - written) as u32;
                Ok(shortened(&output, loan, written)?)
            }
            written => written.map(|_| loan),
        };
        stage.finish(passage, &output, result)?;
        if let Some(kept) = &mut journal
            && let Err(why) = sampler.commit(header.seq + 1, kept)
        {
            tracing::warn!("learned state is no longer saved: {why}");
            journal = None;
        }
    }
    Ok(())
}

/// Returns the first forecasts of a loan as a new frame, because the length of a loan can't be changed.
fn shortened(
    output: &Publisher<ForecastsTopic>,
    loan: Loan<ForecastsTopic>,
    len: usize,
) -> Result<Loan<ForecastsTopic>, PortError> {
    let kept = loan[..len].to_vec();
    drop(loan);
    output.copy(&kept)
}
