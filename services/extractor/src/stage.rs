//! The extractor as a process: `context` in, `features` out.

use config::Run;
use ports::{Stage, StageError};
use wire::{Context, ContextShape, ContextTopic, FeaturesMut, FeaturesTopic, StageId, feature_rows};

use crate::{Extractor, ExtractorOptions};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] where the weights or the run's shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let weights = run.open_weights().map_err(StageError::data)?;
    let mut extractor = Extractor::new(&weights, options(run)).map_err(StageError::data)?;
    drop(weights);

    let mut stage = Stage::open(run, StageId::Extractor)?;
    let context = stage.subscribe::<ContextTopic>()?;
    let output = stage.publish::<FeaturesTopic>()?;

    while let Some(input) = stage.next(&context, &output)? {
        let mut passage = stage.begin(&input);
        let prepared = Context::read(&input, ContextShape::of(&input.header().counts))
            .and_then(|context| extractor.prepare(input.header(), &context));
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
        stage.finish(passage, &output, result)?;
    }
    Ok(())
}

/// The run's settings of the extractor.
#[must_use]
pub fn options(run: &Run) -> ExtractorOptions {
    ExtractorOptions { workers: run.options(StageId::Extractor).workers.unwrap_or(1) }
}
