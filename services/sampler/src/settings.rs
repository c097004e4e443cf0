use model::ModelConfig;
use run::{Run, SpeedLimits};
use wire::AgentType;

use crate::{Options, Propagation, PropagationKind, SamplerOptions};

/// The sampler's settings in a run with this model.
#[must_use]
pub fn settings(options: &Options, model: &ModelConfig, run: &Run) -> SamplerOptions {
    SamplerOptions {
        history_len: model.history_len,
        horizon_len: model.horizon_len,
        modes_len: model.modes,
        vehicle_motion: nn::motion_kind(model, AgentType::Vehicle),
        motion: nn::motion_options(model),
        propagation: match options.propagation {
            PropagationKind::Linearised => Propagation::Linearised,
            PropagationKind::MonteCarlo => Propagation::MonteCarlo { particles: options.particles },
        },
        seed: run.seed,
        speed_limits: SpeedLimits::of_run(run),
        retrieval: options.retrieval,
        evidence: options.evidence,
        conflicts: options.conflicts,
        degradation: options.degradation(),
        deadline_ns: run.interval_ns.min((options.deadline_ms * 1e6) as u64),
        ..SamplerOptions::default()
    }
}
