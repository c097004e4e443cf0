use kinematics::{ControlLimits, DisplacementKind, MotionKind, MotionOptions};
use wire::AgentType;

use crate::{Displacement, Integrator, ModelConfig};

/// The motion constants that a model was trained with.
#[must_use]
pub const fn motion_options(config: &ModelConfig) -> MotionOptions {
    MotionOptions {
        integrator: match config.integrator {
            Integrator::Euler => kinematics::Integrator::Euler,
            Integrator::Midpoint => kinematics::Integrator::Midpoint,
        },
        limits: ControlLimits {
            accel_mps2: config.accel_limit_mps2,
            slip_rate_radps: config.slip_rate_limit_radps,
        },
        slip_limit_rad: config.slip_limit_rad,
        initial_slip: config.initial_slip,
        rear_axle_ratio: config.rear_axle_ratio,
        default_length_m: config.default_length_m,
        displacement: match config.displacement {
            Displacement::Residual => DisplacementKind::Residual,
            Displacement::Absolute => DisplacementKind::Absolute,
        },
    }
}

/// The motion model that a model's controls use for an agent type.
#[must_use]
pub fn motion_kind(config: &ModelConfig, agent_type: AgentType) -> MotionKind {
    if config.drives(agent_type) { MotionKind::Bicycle } else { MotionKind::Displacement }
}
