use kinematics::MotionModel;
use wire::ControlGaussian;

use crate::{
    Bucket, ControlAdapter, ControlChanges, ForecastControls, Query, RetrievalMemory, Retrieved, Unstored,
};

/// Adapts forecasts by a memory, one agent after another; each thread has its own.
/// In a steady pipeline it allocates nothing.
#[derive(Clone, Debug)]
pub struct Retrieval {
    // Scratch, kept from one agent to the next so that nothing is allocated.
    retrieved: Retrieved,
    adapter: ControlAdapter,
}

impl Default for Retrieval {
    fn default() -> Self {
        Self { retrieved: Retrieved::with_room(), adapter: ControlAdapter::default() }
    }
}

impl Retrieval {
    /// Writes the changes of an agent's controls, and returns the agent with its unchanged forecast, for
    /// [`RetrievalMemory::store`]. `ahead` has the buckets of those that are to be stored before it: the
    /// result is the same as if they had been.
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
