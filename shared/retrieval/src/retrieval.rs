use kinematics::MotionModel;
use wire::ControlGaussian;

use crate::{ControlAdapter, ControlChanges, ForecastControls, Query, RetrievalMemory, Retrieved};

/// Adapts forecasts by a memory and fills it, one agent after another.
/// In a steady pipeline it allocates nothing.
#[derive(Clone, Debug)]
pub struct Retrieval {
    memory: RetrievalMemory,
    // Scratch, kept from one agent to the next so that nothing is allocated.
    retrieved: Retrieved,
    adapter: ControlAdapter,
}

impl Retrieval {
    /// Retrieval from a memory.
    #[must_use]
    pub fn new(memory: RetrievalMemory) -> Self {
        Self { memory, retrieved: Retrieved::with_room(), adapter: ControlAdapter::default() }
    }

    /// The memory.
    #[must_use]
    pub const fn memory(&self) -> &RetrievalMemory {
        &self.memory
    }

    /// Gives the memory the present positions of agents: see [`RetrievalMemory::observe`].
    pub fn observe(&mut self, now_ns: i64, agents: impl IntoIterator<Item = (u64, [f32; 2])>) {
        self.memory.observe(now_ns, agents);
    }

    /// Writes the changes of an agent's controls, then stores the agent with its unchanged forecast.
    /// An agent older than the newest observation gets its changes, but is not stored.
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
