use kinematics::MotionModel;
use wire::ControlGaussian;

use crate::{
    Bucket, ControlAdapter, ControlChanges, ForecastControls, Query, RetrievalMemory, Retrieved, Unstored,
};

/// Adapts forecasts by a memory, one agent at a time; each thread has its own. A steady pipeline allocates
/// nothing.
#[derive(Clone, Debug)]
pub struct Retrieval {
    // Scratch memory, reused for each agent so that nothing is allocated.
    retrieved: Retrieved,
    adapter: ControlAdapter,
}

impl Default for Retrieval {
    fn default() -> Self {
        Self { retrieved: Retrieved::with_room(), adapter: ControlAdapter::default() }
    }
}

impl Retrieval {
    /// Writes the changes of an agent's controls. Returns the agent with its unchanged forecast, for
    /// [`RetrievalMemory::store`]. `ahead` has the buckets of agents that will be stored before it: the
    /// result is the same as if they had been stored.
    pub fn adapt<M: AsRef<[ControlGaussian]>>(
        &mut self,
        (memory, ahead): (&RetrievalMemory, &[Bucket]),
        query: &Query,
        model: &MotionModel,
        controls: &ForecastControls<'_, M>,
        changes: &mut ControlChanges,
    ) -> Unstored {
        let path = controls.best_path(model);
        memory.retrieve_behind(ahead, query.agent, &query.key, &mut self.retrieved);
        self.adapter.adapt(&self.retrieved, model, controls, changes);
        Unstored::new(query, &path[..controls.best.len()], &self.retrieved)
    }
}
