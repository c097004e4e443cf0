//! Files of a run's sampler: the retrieval memory that it starts from and saves at the end, the state that
//! outlives its process, and the lanes.

use std::sync::Arc;

use evidence::{Evidence, Priors};
use lanes::LaneMap;
use model::ModelConfig;
use nn::Weights;
use ports::{KeptMemory, StageError};
use retrieval::RetrievalMemory;
use run::Run;

use crate::journal::{Identity, Journal, Storage};
use crate::settings::settings;
use crate::state;
use crate::{LanesOrigin, Options, STAGE, Sampler};

/// A sampler with the options of the run's record: warm-started from the memory file that they name, if it
/// exists, with their priors, and with the lanes of their map.
///
/// # Errors
/// [`StageError`] if the run's options or one of the files can't be used.
pub fn open(run: &Run, model: &ModelConfig) -> Result<Sampler, StageError> {
    let options = STAGE.options(run)?;
    let workers = options.workers.unwrap_or_else(nn::default_workers);
    let mut sampler =
        Sampler::with_workers(settings(&options, model, run), workers).map_err(StageError::data)?;
    if let Some(path) = &options.prior {
        sampler.expect(Priors::open(path).map_err(StageError::data)?.all());
    }
    if let Some(path) = &options.lanes {
        let map = LaneMap::open(path, LanesOrigin::coordinates(options.lanes_origin, run.origin()));
        sampler.guide_along(&Arc::new(map.map_err(StageError::data)?));
    }
    if let Some(path) = options.memory.filter(|path| path.exists()) {
        let weights = Weights::of_model(run.weights.as_deref(), model).map_err(StageError::data)?;
        let steps = (model.horizon_len, model.step_ns());
        sampler.warm_start(RetrievalMemory::load(&path, weights.sha256(), steps).map_err(StageError::data)?);
    }
    Ok(sampler)
}

/// Name of the file in the run's shared memory for the state that outlives the sampler's process.
pub(crate) const KEPT: &str = "sampler_kept";

/// The run's memory for the sampler's learned state.
pub(crate) struct Kept(KeptMemory);

impl Storage for Kept {
    fn bytes(&mut self) -> &mut [u8] {
        self.0.bytes()
    }

    fn grow_to(&mut self, len: usize) -> Result<(), String> {
        let Self(kept) = self;
        kept.grow_to(len).map_err(|error| format!("{}: {error}", kept.path().display()))
    }
}

/// Opens the journal for the sampler's state, once the previous process is gone. The sampler resumes with the
/// previous process's state. It keeps no state in lockstep, in which stages are not restarted.
pub(crate) fn resume(run: &Run, sampler: &mut Sampler, incarnation: u32) {
    let Some(identity) = Identity::of(run.id, sampler.options()).filter(|_| !run.lockstep) else { return };
    let opened = KeptMemory::open(run, KEPT).map_err(|error| error.to_string()).and_then(|kept| {
        let kept: Box<dyn Storage + Send> = Box::new(Kept(kept));
        let mut journal = Journal::over(kept, identity);
        let why = match journal
            .resume(None)
            .and_then(|resumed| resumed.map(|r| sampler.resume(r)).transpose())
        {
            Ok(Some(())) => {
                let entry_count = sampler.memory().map_or(0, RetrievalMemory::entry_count);
                let matured_count = sampler.evidence().map_or(0.0, Evidence::matured_count);
                tracing::warn!(
                    "incarnation {incarnation} restarted with {entry_count} entries of the retrieval memory \
                         and the evidence of {matured_count:.0} forecasts, as of tick {}",
                    sampler.resumed_ticks().saturating_sub(1)
                );
                return Ok(journal);
            }
            Ok(None) => "nothing was kept",
            Err(why) => why,
        };
        let is_loaded = state::load(run, sampler);
        if incarnation > 0 && !is_loaded {
            tracing::warn!("restarted with an empty retrieval memory and no evidence: {why}");
        }
        journal.clear().map(|()| journal)
    });
    match opened {
        Ok(journal) => sampler.keep_in(Some(journal)),
        Err(why) => tracing::warn!("a restart will begin without retrieval memory and evidence: {why}"),
    }
}

/// Saves the sampler's memory to the file that the run's options name, if they do, for later runs to start
/// from.
///
/// # Errors
/// [`StageError`] if the file can't be written.
pub fn save_memory(run: &Run, sampler: &Sampler) -> Result<(), StageError> {
    let Options { memory: path, .. } = STAGE.options(run)?;
    let (Some(path), Some(memory)) = (path, sampler.memory()) else { return Ok(()) };
    let weights = Weights::open_or_onboard(run.weights.as_deref()).map_err(StageError::data)?;
    memory.save(&path, weights.sha256()).map_err(StageError::data)
}
