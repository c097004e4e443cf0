use wire::{AGENT_TYPES, AgentType, EDGE_ATTRIBUTES, RELATION_FEATURES, STATE_FEATURES};

use crate::linear::{Mlp, MlpMemory};
use crate::weights::{Weights, WeightsError};

const HIDDEN: usize = 128;

/// The state MLPs, one per agent type or one for all: 6 → 128 → 128 → 128 → 32, or 64 without context.
pub struct StateMlp {
    types: [Mlp; 3],
}

impl StateMlp {
    /// The layers `fe.state.*`.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn new(weights: &Weights) -> Result<Self, WeightsError> {
        let config = weights.config();
        let out_len = config.state_embedding_len();
        let lengths = [STATE_FEATURES, HIDDEN, HIDDEN, HIDDEN, out_len];
        let [vehicle, cyclist, pedestrian] =
            AGENT_TYPES.map(|agent_type| config.network_of(agent_type).name());
        let read = |name| Mlp::read(weights, &format!("fe.state.{name}"), &lengths);
        Ok(Self { types: [read(vehicle)?, read(cyclist)?, read(pedestrian)?] })
    }

    /// State embeddings SE, \[row, 32\] (64 without context), of state features s, one per row.
    pub fn embed(
        &self,
        agent_type: AgentType,
        states: &[[f32; STATE_FEATURES]],
        memory: &mut MlpMemory,
        out: &mut [f32],
    ) {
        self.types[agent_type.index()].run(states.as_flattened(), memory, out);
    }
}

/// The relation MLP: 6 → 128 → 128 → 128 → 16.
pub struct RelationMlp {
    mlp: Mlp,
}

impl RelationMlp {
    /// The layers `fe.relation.*`.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn new(weights: &Weights) -> Result<Self, WeightsError> {
        let lengths = [RELATION_FEATURES, HIDDEN, HIDDEN, HIDDEN, EDGE_ATTRIBUTES];
        Ok(Self { mlp: Mlp::read(weights, "fe.relation", &lengths)? })
    }

    /// Edge attributes e of relation features φ, one per row.
    pub fn embed(
        &self,
        relations: &[[f32; RELATION_FEATURES]],
        memory: &mut MlpMemory,
        out: &mut [[f32; EDGE_ATTRIBUTES]],
    ) {
        self.mlp.run(relations.as_flattened(), memory, out.as_flattened_mut());
    }
}
