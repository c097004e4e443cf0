//! The decoder as a process: `encodings` in, `controls` out.

use nn::{ModelConfig, Weights, kernels};
use ports::{Stage, StageError};
use run::{OptionError, Run};
use wire::{ControlsTopic, EncodingsTopic};

use crate::{Decoder, DecoderOptions, STAGE};

/// Runs the stage until the process is asked to end.
///
/// # Errors
/// [`StageError`] where the weights, the instruction set or the run's model, options or shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    kernels::follow_environment().map_err(StageError::config)?;
    let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
    let weights = Weights::of_model(run.weights.as_deref(), &model).map_err(StageError::data)?;
    let mut decoder = Decoder::new(&weights, settings(run)?).map_err(StageError::data)?;
    drop(weights);

    let mut stage = Stage::open(run, &STAGE)?;
    let encodings = stage.subscribe::<EncodingsTopic>()?;
    let output = stage.publish::<ControlsTopic>()?;

    while let Some(input) = stage.next(&encodings, &output)? {
        let mut passage = stage.begin(&input);
        let forecast_len = Decoder::len(&input);
        let counts = &mut passage.header.counts;
        counts.agents_len = forecast_len as u32;
        counts.horizon_len = model.horizon_len as u32;
        counts.modes_len = model.modes as u32;
        let mut loan = output.loan(forecast_len)?;
        let result = decoder.step(input.header(), &input, &mut loan);
        stage.finish(passage, &output, result.map(|()| loan))?;
    }
    Ok(())
}

/// The decoder's settings in a run.
///
/// # Errors
/// [`OptionError`] where the run's record holds options that the decoder does not have.
pub fn settings(run: &Run) -> Result<DecoderOptions, OptionError> {
    Ok(DecoderOptions {
        workers: STAGE.options(run)?.workers.unwrap_or_else(nn::default_workers),
        seed: run.seed,
    })
}
