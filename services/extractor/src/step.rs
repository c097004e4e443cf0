use nn::{ModelConfig, Weights, kernels};
use ports::{Allowance, Answer, NoTopic, StageError, Step, Tick, drive};
use run::{OptionError, Run};
use wire::{Context, ContextShape, ContextTopic, FeaturesMut, FeaturesTopic, Rejected, feature_rows};

use crate::{Extractor, ExtractorOptions, STAGE};

/// Runs the extractor as a process: `context` in, `features` out.
///
/// # Errors
/// [`StageError`] if the weights, the instruction set or the run's model, options or shared memory can't be used.
pub fn run(run: &Run) -> Result<(), StageError> {
    drive(run, &STAGE, |run| {
        kernels::follow_environment().map_err(StageError::config)?;
        let model = ModelConfig::of_run(&run.root).map_err(StageError::config)?;
        let weights = Weights::of_model(run.weights.as_deref(), &model).map_err(StageError::data)?;
        Extractor::new(&weights, settings(run)?).map_err(StageError::data)
    })
}

/// The extractor's settings in a run.
///
/// # Errors
/// [`OptionError`] if the run's record holds options that the extractor does not have.
pub fn settings(run: &Run) -> Result<ExtractorOptions, OptionError> {
    Ok(ExtractorOptions { workers: STAGE.options(run)?.workers.unwrap_or_else(nn::default_workers) })
}

impl Step for Extractor {
    type Input = ContextTopic;
    type Second = NoTopic;
    type Output = FeaturesTopic;

    fn answer(
        &mut self,
        tick: &Tick<'_, ContextTopic>,
        out: &mut Answer<'_, FeaturesTopic>,
    ) -> Result<(), Rejected> {
        let served_max = match tick.allowance {
            Allowance::AtMost(agents) => Some(agents),
            _ => None,
        };
        let context = Context::read(tick.input, ContextShape::of(&tick.header.counts))?;
        let shape = self.prepare(tick.header, &context, served_max)?;
        out.header.counts.edges_len = shape.edges_len as u32;
        self.write(&mut FeaturesMut::over(out.elements(feature_rows(&shape))?, shape)?);
        Ok(())
    }
}
