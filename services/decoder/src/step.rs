use nn::{ModelConfig, Weights, kernels};
use ports::{Answer, NoTopic, StageError, Step, Tick, drive};
use run::{OptionError, Run};
use wire::{ControlsTopic, EncodingsTopic, Rejected};

use crate::{Decoder, DecoderOptions, STAGE};

/// Runs the decoder as a process: `encodings` in, `controls` out.
///
/// # Errors
/// [`StageError`] if the weights, the instruction set, the precision or the run's model, options or shared memory
/// can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    drive(run, &STAGE, |run| {
        kernels::follow_environment().map_err(StageError::config)?;
        let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
        let weights = Weights::of_model(run.weights.as_deref(), &model).map_err(StageError::data)?;
        let settings = settings(run)?;
        settings.precision.check().map_err(StageError::config)?;
        Decoder::new(&weights, settings).map_err(StageError::data)
    })
}

/// The decoder's settings in a run.
///
/// # Errors
/// [`OptionError`] if the run's record holds options that the decoder does not have.
pub fn settings(run: &Run) -> Result<DecoderOptions, OptionError> {
    let options = STAGE.options(run)?;
    Ok(DecoderOptions {
        workers: options.workers.unwrap_or_else(nn::default_workers),
        seed: run.seed,
        precision: options.precision,
    })
}

impl Step for Decoder {
    type Input = EncodingsTopic;
    type Second = NoTopic;
    type Output = ControlsTopic;

    fn answer(
        &mut self,
        tick: &Tick<'_, EncodingsTopic>,
        out: &mut Answer<'_, ControlsTopic>,
    ) -> Result<(), Rejected> {
        let served = self.serve(tick.header, tick.input, tick.allowance)?;
        let counts = &mut out.header.counts;
        counts.agents_len = served as u32;
        (counts.horizon_len, counts.modes_len) = self.sizes();
        let forecastable = tick.input.iter().enumerate().filter(|(_, agent)| agent.forecastable != 0);
        for (place, _) in forecastable.filter(|(place, _)| !self.is_served(*place)) {
            out.header.mark_shed(place);
        }
        self.write(out.elements(served)?);
        Ok(())
    }
}
