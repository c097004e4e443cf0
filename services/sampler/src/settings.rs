use kinematics::{ControlLimits, DisplacementKind, Integrator};
use model::ModelConfig;
use wire::AgentType;

use crate::{Options, Propagation, PropagationKind, SamplerOptions};

/// The sampler's settings for a model.
#[must_use]
pub fn settings(options: &Options, model: &ModelConfig, seed: u64) -> SamplerOptions {
    SamplerOptions {
        history_len: model.history_len,
        horizon_len: model.horizon_len,
        vehicles_drive: model.drives(AgentType::Vehicle),
        integrator: match model.integrator {
            model::Integrator::Euler => Integrator::Euler,
            model::Integrator::Midpoint => Integrator::Midpoint,
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
            model::Displacement::Residual => DisplacementKind::Residual,
            model::Displacement::Absolute => DisplacementKind::Absolute,
        },
        propagation: match options.propagation {
            PropagationKind::Linearised => Propagation::Linearised,
            PropagationKind::MonteCarlo => Propagation::MonteCarlo { particles: options.particles },
        },
        seed,
        recalls: options.retrieval,
        ..SamplerOptions::default()
    }
}
