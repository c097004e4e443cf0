use config::Run;
use ports::StageError;
use retrieval::RetrievalMemory;

use crate::Sampler;
use crate::settings::options;

/// A sampler as the run's record says, with the memory of the place that the run begins with, if it has one.
///
/// # Errors
/// [`StageError`] where that memory can't be used.
pub fn open(run: &Run) -> Result<Sampler, StageError> {
    let mut sampler = Sampler::new(options(run));
    if let Some(path) = run.memory.as_deref().filter(|path| run.recall && path.exists()) {
        let weights = run.open_weights().map_err(StageError::data)?;
        let steps = (run.model.horizon_len, run.model.step_ns());
        sampler.recall(RetrievalMemory::load(path, weights.sha256(), steps).map_err(StageError::data)?);
    }
    Ok(sampler)
}

/// Keeps what the sampler remembers of the place where the run's record wants it, for another run to begin with.
///
/// # Errors
/// [`StageError`] where it can't be written.
pub fn keep_memory(run: &Run, sampler: &Sampler) -> Result<(), StageError> {
    let (Some(path), Some(memory)) = (&run.memory, sampler.memory()) else { return Ok(()) };
    let weights = run.open_weights().map_err(StageError::data)?;
    memory.save(path, weights.sha256()).map_err(StageError::data)
}
