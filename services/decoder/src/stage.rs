//! The decoder as a process: `encodings` in, `controls` out.

use config::Run;
use ports::{Stage, StageError};
use wire::{ControlsTopic, EncodingsTopic, StageId};

use crate::{Decoder, DecoderOptions};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] where the weights or the run's shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    let weights = run.open_weights().map_err(StageError::data)?;
    let mut decoder = Decoder::new(&weights, options(run)).map_err(StageError::data)?;
    drop(weights);

    let mut stage = Stage::open(run, StageId::Decoder)?;
    let encodings = stage.subscribe::<EncodingsTopic>()?;
    let output = stage.publish::<ControlsTopic>()?;

    while let Some(input) = stage.next(&encodings, &output)? {
        let mut passage = stage.begin(&input);
        let forecast_len = Decoder::len(&input);
        let counts = &mut passage.header.counts;
        counts.agents_len = forecast_len as u32;
        counts.horizon_len = run.model.horizon_len as u32;
        counts.modes_len = run.model.modes as u32;
        let mut loan = output.loan(forecast_len)?;
        let result = decoder.step(input.header(), &input, &mut loan);
        stage.finish(passage, &output, result.map(|()| loan))?;
    }
    Ok(())
}

/// The run's settings of the decoder.
#[must_use]
pub fn options(run: &Run) -> DecoderOptions {
    DecoderOptions { workers: run.options(StageId::Decoder).workers.unwrap_or(1), seed: run.seed }
}
