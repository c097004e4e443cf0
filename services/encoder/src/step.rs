use nn::{ModelConfig, Weights, kernels};
use ports::{Allowance, Answer, NoTopic, StageError, Step, Tick, drive};
use run::{OptionError, Run};
use wire::{EncodingsTopic, FeatureShape, Features, FeaturesTopic, Rejected};

use crate::{Encoder, EncoderOptions, STAGE};

/// Runs the encoder as a process: `features` in, `encodings` out.
///
/// # Errors
/// [`StageError`] if the weights, the instruction set or the run's model, options or shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    drive(run, &STAGE, |run| {
        kernels::follow_environment().map_err(StageError::config)?;
        let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
        let weights = Weights::of_model(run.weights.as_deref(), &model).map_err(StageError::data)?;
        Encoder::new(&weights, settings(run)?).map_err(StageError::data)
    })
}

/// The encoder's settings in a run.
///
/// # Errors
/// [`OptionError`] if the run's record holds options that the encoder does not have.
pub fn settings(run: &Run) -> Result<EncoderOptions, OptionError> {
    Ok(EncoderOptions { workers: STAGE.options(run)?.workers.unwrap_or_else(nn::default_workers) })
}

impl Step for Encoder {
    type Input = FeaturesTopic;
    type Second = NoTopic;
    type Output = EncodingsTopic;

    fn answer(
        &mut self,
        tick: &Tick<'_, FeaturesTopic>,
        out: &mut Answer<'_, EncodingsTopic>,
    ) -> Result<(), Rejected> {
        let served_max = match tick.allowance {
            Allowance::AtMost(agents) => agents,
            _ => usize::MAX,
        };
        let counts = &tick.header.counts;
        let features = Features::read(tick.input, FeatureShape::of(counts), counts.history_len as usize)?;
        let encodings = out.elements(counts.agents_len as usize)?;
        let served = self.step(tick.header, &features, served_max, encodings)?;
        out.served(served);
        Ok(())
    }
}
