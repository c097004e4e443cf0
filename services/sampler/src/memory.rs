//! Files of a run's sampler: the retrieval memory that it begins with and saves at the end, and the lanes.

use std::sync::Arc;

use lanes::LaneMap;
use model::ModelConfig;
use nn::Weights;
use ports::StageError;
use retrieval::RetrievalMemory;
use run::Run;

use crate::settings::settings;
use crate::{LanesOrigin, Options, STAGE, Sampler};

/// A sampler with the options of the run's record: warm-started from the memory file that they name, if it
/// exists, and with the lanes of their map.
///
/// # Errors
/// [`StageError`] where the run's options or one of the files can't be used.
pub fn open(run: &Run, model: &ModelConfig) -> Result<Sampler, StageError> {
    let options = STAGE.options(run)?;
    let mut sampler = Sampler::new(settings(&options, model, run.seed));
    if let Some(path) = &options.lanes {
        let map = LaneMap::open(path, LanesOrigin::coordinates(options.lanes_origin));
        sampler.guide_along(Arc::new(map.map_err(StageError::data)?));
    }
    if let Some(path) = options.memory.filter(|path| path.exists()) {
        let weights = Weights::of_model(run.weights.as_deref(), model).map_err(StageError::data)?;
        let steps = (model.horizon_len, model.step_ns());
        sampler.warm_start(RetrievalMemory::load(&path, weights.sha256(), steps).map_err(StageError::data)?);
    }
    Ok(sampler)
}

/// Saves the sampler's memory to the file that the run's options name, if they do, for later runs to start
/// from.
///
/// # Errors
/// [`StageError`] where the file can't be written.
pub fn save_memory(run: &Run, sampler: &Sampler) -> Result<(), StageError> {
    let Options { memory: path, .. } = STAGE.options(run)?;
    let (Some(path), Some(memory)) = (path, sampler.memory()) else { return Ok(()) };
    let weights = Weights::open_or_onboard(run.weights.as_deref()).map_err(StageError::data)?;
    memory.save(&path, weights.sha256()).map_err(StageError::data)
}
