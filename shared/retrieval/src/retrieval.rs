use kinematics::MotionModel;
use wire::ControlGaussian;

use crate::{ControlAdapter, ControlChanges, ForecastControls, Query, RetrievalMemory, Retrieved};

/// A memory that adapts forecasts as it fills, one agent after another.
///
/// A steady one takes no memory.
#[derive(Clone, Debug)]
pub struct Retrieval {
    memory: RetrievalMemory,
    // Kept from one agent to the next for their memory's sake.
    retrieved: Retrieved,
    adapter: ControlAdapter,
}

impl Retrieval {
    /// Retrieves from a memory.
    #[must_use]
    pub fn new(memory: RetrievalMemory) -> Self {
        Self { memory, retrieved: Retrieved::with_room(), adapter: ControlAdapter::default() }
    }

    /// What is stored.
    #[must_use]
    pub const fn memory(&self) -> &RetrievalMemory {
        &self.memory
    }

    /// Shows the memory where agents are: see [`RetrievalMemory::observe`].
    pub fn observe(&mut self, now_ns: i64, agents: impl IntoIterator<Item = (u64, [f32; 2])>) {
        self.memory.observe(now_ns, agents);
    }

    /// Writes what an agent's controls are changed by, and stores the agent with the forecast as it was.
    ///
    /// The controls of an agent that is older than what was observed last are changed, but not stored.
    pub fn adapt<M: AsRef<[ControlGaussian]>>(
        &mut self,
        query: &Query,
        model: &MotionModel,
        controls: &ForecastControls<'_, M>,
        changes: &mut ControlChanges,
    ) {
        let path = controls.best_path(model);
        self.memory.retrieve_and_store(query, &path[..controls.best.len()], &mut self.retrieved);
        self.adapter.adapt(&self.retrieved, model, controls, changes);
    }
}
