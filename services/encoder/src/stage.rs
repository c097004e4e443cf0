//! The encoder as a process: `features` in, `encodings` out.

use nn::{ModelConfig, Weights, kernels};
use ports::{Stage, StageError, monotonic_ns};
use run::{OptionError, Run};
use shedding::{Capacity, Deadline};
use wire::{EncodingsTopic, FeatureShape, Features, FeaturesTopic, StageId, flags};

use crate::{Encoder, EncoderOptions, STAGE};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] where the weights, the instruction set or the run's model, options or shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    kernels::follow_environment().map_err(StageError::config)?;
    let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
    let weights = Weights::of_model(run.weights.as_deref(), &model).map_err(StageError::data)?;
    let mut encoder = Encoder::new(&weights, settings(run)?).map_err(StageError::data)?;
    drop(weights);
    let deadline_ns = run.deadline_ns(StageId::Encoder);
    let mut deadline = deadline_ns.map(|ns| Deadline::new(ns, run.left_for_sampler_ns()));
    let mut capacity = Capacity::default();

    let mut stage = Stage::open(run, &STAGE)?;
    let features = stage.subscribe::<FeaturesTopic>()?;
    let output = stage.publish::<EncodingsTopic>()?;

    while let Some(input) = stage.next(&features, &output)? {
        let passage = stage.begin(&input);
        let (header, begin_ns) = (input.header(), monotonic_ns());
        let deadline = deadline.as_mut().filter(|_| !header.has(flags::LOCKSTEP));
        let until_ns = deadline.map(|deadline| deadline.until_ns(header));
        let served_max =
            until_ns.map_or(usize::MAX, |until_ns| capacity.fit(until_ns.saturating_sub(begin_ns)));
        let counts = &header.counts;
        let mut loan = output.loan(counts.agents_len as usize)?;
        let result = Features::read(&input, FeatureShape::of(counts), counts.history_len as usize)
            .and_then(|features| encoder.step_most(header, &features, served_max, &mut loan));
        if let Ok(served_len) = result {
            capacity.took(monotonic_ns() - begin_ns, served_len);
        }
        stage.finish(passage, &output, result.map(|_| loan))?;
    }
    Ok(())
}

/// The encoder's settings in a run.
///
/// # Errors
/// [`OptionError`] where the run's record holds options that the encoder does not have.
pub fn settings(run: &Run) -> Result<EncoderOptions, OptionError> {
    Ok(EncoderOptions { workers: STAGE.options(run)?.workers.unwrap_or_else(nn::default_workers) })
}
