use config::Run;
use wire::{AgentType, StageId};

use crate::{Propagation, SamplerOptions};

/// Particles of each mode, where the pipeline does not say.
const PARTICLES: usize = 16;

/// The run's settings of the sampler.
#[must_use]
pub fn options(run: &Run) -> SamplerOptions {
    let (model, settings) = (&run.model, run.options(StageId::Sampler));
    let particles = settings.particles.unwrap_or(PARTICLES);
    SamplerOptions {
        history_len: model.history_len,
        horizon_len: model.horizon_len,
        vehicle_motion: nn::motion_kind(model, AgentType::Vehicle),
        motion: nn::motion_options(model),
        propagation: match settings.propagation.unwrap_or_default() {
            config::Propagation::Linearised => Propagation::Linearised,
            config::Propagation::MonteCarlo => Propagation::MonteCarlo { particles },
        },
        seed: run.seed,
        recalls: run.recall,
        ..SamplerOptions::default()
    }
}
