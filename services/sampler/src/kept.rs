use model::ModelConfig;
use nn::Weights;
use ports::StageError;
use retrieval::RetrievalMemory;
use run::Run;

use crate::settings::settings;
use crate::{Options, STAGE, Sampler};

/// A sampler as the run's record says, with the memory of the place that the run begins with, if it has one.
///
/// # Errors
/// [`StageError`] where the run's options or that memory can't be used.
pub fn open(run: &Run, model: &ModelConfig) -> Result<Sampler, StageError> {
    let options = STAGE.options(run)?;
    let mut sampler = Sampler::new(settings(&options, model, run.seed));
    if let Some(path) = options.memory.filter(|path| path.exists()) {
        let weights = Weights::of_model(run.weights.as_deref(), model).map_err(StageError::data)?;
        let steps = (model.horizon_len, model.step_ns());
        sampler.recall(RetrievalMemory::load(&path, weights.sha256(), steps).map_err(StageError::data)?);
    }
    Ok(sampler)
}

/// Keeps what the sampler remembers of the place where the run's record wants it, for another run to begin with.
///
/// # Errors
/// [`StageError`] where it can't be written.
pub fn keep_memory(run: &Run, sampler: &Sampler) -> Result<(), StageError> {
    let Options { memory: path, .. } = STAGE.options(run)?;
    let (Some(path), Some(memory)) = (path, sampler.memory()) else { return Ok(()) };
    let weights = Weights::open_or_onboard(run.weights.as_deref()).map_err(StageError::data)?;
    memory.save(&path, weights.sha256()).map_err(StageError::data)
}
