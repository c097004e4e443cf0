//! The decoder as a process: `encodings` in, `controls` out.

use nn::{Deadline, ModelConfig, Weights, kernels};
use ports::{Stage, StageError, monotonic_ns};
use run::{OptionError, Run};
use wire::{ControlsTopic, EncodingsTopic, StageId, flags};

use crate::{Decoder, DecoderOptions, STAGE};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] where the weights, the instruction set, the precision or the run's model, options or shared memory
/// can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    kernels::follow_environment().map_err(StageError::config)?;
    let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
    let weights = Weights::of_model(run.weights.as_deref(), &model).map_err(StageError::data)?;
    let settings = settings(run)?;
    settings.precision.check().map_err(StageError::config)?;
    let mut decoder = Decoder::new(&weights, settings).map_err(StageError::data)?;
    drop(weights);
    let deadline_ns = run.deadline_ns(StageId::Decoder);
    let mut deadline = deadline_ns.map(|ns| shedding::Deadline::new(ns, run.left_for_sampler_ns()));

    let mut stage = Stage::open(run, &STAGE)?;
    let encodings = stage.subscribe::<EncodingsTopic>()?;
    let output = stage.publish::<ControlsTopic>()?;

    while let Some(input) = stage.next(&encodings, &output)? {
        let mut passage = stage.begin(&input);
        let header = input.header();
        let deadline = deadline.as_mut().filter(|_| !header.has(flags::LOCKSTEP));
        let deadline =
            deadline.map(|deadline| Deadline { until_ns: deadline.until_ns(header), clock: monotonic_ns });
        let result = match decoder.serve(header, &input, deadline) {
            Ok(served_len) => {
                let counts = &mut passage.header.counts;
                counts.agents_len = served_len as u32;
                counts.horizon_len = model.horizon_len as u32;
                counts.modes_len = model.modes as u32;
                let forecastable = input.iter().enumerate().filter(|(_, agent)| agent.forecastable != 0);
                for (place, _) in forecastable.filter(|(place, _)| !decoder.is_served(*place)) {
                    passage.header.mark_shed(place);
                }
                let mut loan = output.loan(served_len)?;
                decoder.write(&mut loan);
                Ok(loan)
            }
            Err(rejected) => Err(rejected),
        };
        stage.finish(passage, &output, result)?;
    }
    Ok(())
}

/// The decoder's settings in a run.
///
/// # Errors
/// [`OptionError`] where the run's record holds options that the decoder does not have.
pub fn settings(run: &Run) -> Result<DecoderOptions, OptionError> {
    let options = STAGE.options(run)?;
    Ok(DecoderOptions {
        workers: options.workers.unwrap_or_else(nn::default_workers),
        seed: run.seed,
        precision: options.precision,
    })
}
