use config::Run;
use kinematics::{ControlLimits, DisplacementKind, Integrator};
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
        vehicles_drive: model.drives(AgentType::Vehicle),
        integrator: match model.integrator {
            nn::Integrator::Euler => Integrator::Euler,
            nn::Integrator::Midpoint => Integrator::Midpoint,
        },
        limits: ControlLimits {
            accel_mps2: model.accel_limit_mps2,
            slip_rate_radps: model.slip_rate_limit_radps,
        },
        slip_limit_rad: model.slip_limit_rad,
        initial_slip: model.initial_slip,
        rear_axle_ratio: model.rear_axle_ratio,
        default_length_m: model.default_length_m,
        displacement: match model.displacement {
            nn::Displacement::Residual => DisplacementKind::Residual,
            nn::Displacement::Absolute => DisplacementKind::Absolute,
        },
        propagation: match settings.propagation.unwrap_or_default() {
            config::Propagation::Linearised => Propagation::Linearised,
            config::Propagation::MonteCarlo => Propagation::MonteCarlo { particles },
        },
        seed: run.seed,
        recalls: run.recall,
        ..SamplerOptions::default()
    }
}
