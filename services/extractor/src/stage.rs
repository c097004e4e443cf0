//! The extractor as a process: `context` in, `features` out.

use nn::{ModelConfig, Weights, kernels};
use ports::{Stage, StageError, monotonic_ns};
use run::{OptionError, Run};
use shedding::{Capacity, Deadline};
use wire::{Context, ContextShape, ContextTopic, FeaturesMut, FeaturesTopic, StageId, feature_rows, flags};

use crate::{Extractor, ExtractorOptions, STAGE};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] where the weights, the instruction set or the run's model, options or shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    kernels::follow_environment().map_err(StageError::config)?;
    let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
    let weights = Weights::of_model(run.weights.as_deref(), &model).map_err(StageError::data)?;
    let mut extractor = Extractor::new(&weights, settings(run)?).map_err(StageError::data)?;
    drop(weights);
    // The choice is made here for the stages up to the decoder, which has to be done by then.
    let deadline_ns =
        run.deadline_ns(StageId::Decoder).filter(|_| run.deadline_ns(StageId::Extractor).is_some());
    let mut deadline = deadline_ns.map(|ns| Deadline::new(ns, run.left_for_sampler_ns()));
    let mut capacity = Capacity::default();

    let mut stage = Stage::open(run, &STAGE)?;
    let context = stage.subscribe::<ContextTopic>()?;
    let output = stage.publish::<FeaturesTopic>()?;

    while let Some(input) = stage.next(&context, &output)? {
        let mut passage = stage.begin(&input);
        let (header, begin_ns) = (input.header(), monotonic_ns());
        let deadline = deadline.as_mut().filter(|_| !header.has(flags::LOCKSTEP));
        let until_ns = deadline.map(|deadline| deadline.until_ns(header));
        let served_max = until_ns.map(|until_ns| {
            capacity.took(header.chain_ns, header.chain_len as usize);
            capacity.fit(until_ns.saturating_sub(begin_ns))
        });
        let prepared = Context::read(&input, ContextShape::of(&header.counts))
            .and_then(|context| extractor.prepare_most(header, &context, served_max));
        let result = match prepared {
            Ok(shape) => {
                passage.header.counts.edges_len = shape.edges_len as u32;
                let mut loan = output.loan(feature_rows(&shape))?;
                FeaturesMut::over(&mut loan, shape)
                    .map(|mut features| extractor.write(&mut features))
                    .map(|()| loan)
            }
            Err(rejected) => Err(rejected),
        };
        capacity.took_fixed(monotonic_ns() - begin_ns);
        stage.finish(passage, &output, result)?;
    }
    Ok(())
}

/// The extractor's settings in a run.
///
/// # Errors
/// [`OptionError`] where the run's record holds options that the extractor does not have.
pub fn settings(run: &Run) -> Result<ExtractorOptions, OptionError> {
    Ok(ExtractorOptions { workers: STAGE.options(run)?.workers.unwrap_or_else(nn::default_workers) })
}
