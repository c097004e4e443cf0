use model::ModelConfig;
use wire::AgentType;

use crate::{Options, Propagation, PropagationKind, SamplerOptions};

/// The sampler's settings for a model.
#[must_use]
pub fn settings(options: &Options, model: &ModelConfig, seed: u64) -> SamplerOptions {
    SamplerOptions {
        history_len: model.history_len,
        horizon_len: model.horizon_len,
        vehicle_motion: nn::motion_kind(model, AgentType::Vehicle),
        motion: nn::motion_options(model),
        propagation: match options.propagation {
            PropagationKind::Linearised => Propagation::Linearised,
            PropagationKind::MonteCarlo => Propagation::MonteCarlo { particles: options.particles },
        },
        seed,
        retrieval: options.retrieval,
        evidence: options.evidence,
        degradation: options.degradation(),
        ..SamplerOptions::default()
    }
}
