//! Multiply-adds of a tick, counted from the model's layers. Padding and unused results do not count.

use nn::{ContextCnn, ModelConfig, Weights};
use onboard::Load;
use wire::{
    CONTEXT_EMBEDDING, EDGE_ATTRIBUTES, LATENT, NODE_ATTRIBUTES, RELATION_FEATURES, STATE_EMBEDDING,
    STATE_FEATURES, TEMPORAL,
};

use console::failure::Failure;

/// Width of the hidden layers and of the GRU.
const HIDDEN: usize = 128;
/// Width of the mode head's hidden layer.
const MODE_HIDDEN: usize = 64;
/// Number of outputs of the decoder's head per step.
const RAW: usize = 5;
const _: () = assert!(STATE_EMBEDDING + CONTEXT_EMBEDDING == NODE_ATTRIBUTES);

/// Multiply-adds of each layer.
pub(super) struct Work {
    config: ModelConfig,
    cnn: usize,
}

impl Work {
    pub(super) fn of(weights: &Weights) -> Result<Self, Failure> {
        let cnn = ContextCnn::new(weights).map_err(Failure::data)?.multiply_adds();
        Ok(Self { config: weights.config().clone(), cnn })
    }

    /// Returns the multiply-adds of a steady tick in tracker, localiser, extractor, encoder, decoder and
    /// sampler. `None` for stages without matrix products.
    pub(super) fn tick(&self, load: &Load) -> [Option<f64>; 6] {
        let mlp = |input: usize, output: usize| HIDDEN * (input + 2 * HIDDEN + output);
        let state = load.node_count * mlp(STATE_FEATURES, STATE_EMBEDDING);
        let relation = load.new_edge_count * mlp(RELATION_FEATURES, EDGE_ATTRIBUTES);
        let extractor = load.agents_len * self.cnn + state + relation;

        let edge_in_message = if self.config.edge_in_message { EDGE_ATTRIBUTES * TEMPORAL } else { 0 };
        let node = NODE_ATTRIBUTES * TEMPORAL;
        let sum = TEMPORAL + NODE_ATTRIBUTES;
        let round = load.node_count * node + load.edges_len * (edge_in_message + sum);
        // The first layer of the edge update runs once per node for sender and receiver.
        let update = load.node_count * 2 * TEMPORAL * HIDDEN + load.edges_len * 2 * EDGE_ATTRIBUTES * HIDDEN;
        let temporal = load.node_count * (node + TEMPORAL * self.config.temporal_heads);
        let encoder = self.config.rounds * round + (self.config.rounds - 1) * update + temporal;

        let gru = 3 * HIDDEN * HIDDEN;
        let burn_in = load.burn_in_count * (gru + 3 * HIDDEN * STATE_FEATURES);
        let draws = self.config.modes + usize::from(self.config.best_latent);
        let steps = load.forecast_count * draws * self.config.horizon_len;
        // The recurrent half of the first step runs once per agent for all draws.
        let recurrences = load.forecast_count + steps - load.forecast_count * draws;
        let latent =
            if self.config.best_latent { 0 } else { load.forecast_count * draws * 3 * HIDDEN * LATENT };
        let modes =
            if self.config.mode_head { MODE_HIDDEN * (TEMPORAL + HIDDEN + self.config.modes) } else { 0 };
        let once = 3 * HIDDEN * TEMPORAL + modes;
        let decoder =
            burn_in + load.forecast_count * once + latent + recurrences * gru + steps * HIDDEN * RAW;
        [None, None, Some(extractor as f64), Some(encoder as f64), Some(decoder as f64), None]
    }
}
