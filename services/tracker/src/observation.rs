use filters::Observation;
use wire::{AgentType, Detection, detection_flags};

use crate::options::InputModel;

/// Bounds of a detection's own noise: beyond them, variances overflow or vanish in a published covariance.
const SIGMA_RANGE_M: (f64, f64) = (1e-6, 1e3);

/// The observation of a detection, with the noise of its type where it has none of its own.
#[must_use]
pub fn observation(detection: &Detection, agent_type: AgentType, input: &InputModel) -> Observation {
    let noise = &input.sensor[agent_type.index()];
    let value = |flag, value: f32, sigma: f64| detection.has(flag).then(|| (f64::from(value), sigma.powi(2)));
    Observation {
        position_m: [f64::from(detection.x_m), f64::from(detection.y_m)],
        position_variance: position_sigma_m(detection, agent_type, input).powi(2),
        heading_rad: value(detection_flags::HAS_HEADING, detection.heading_rad, noise.heading_rad),
        speed_mps: value(detection_flags::HAS_SPEED, detection.speed_mps, noise.speed_mps),
    }
}

/// Standard deviation of a detection's position per axis.
#[must_use]
pub fn position_sigma_m(detection: &Detection, agent_type: AgentType, input: &InputModel) -> f64 {
    match detection.sigma_m {
        sigma_m if sigma_m > 0.0 => f64::from(sigma_m).clamp(SIGMA_RANGE_M.0, SIGMA_RANGE_M.1),
        _ => input.sensor[agent_type.index()].position_m,
    }
}

/// The identity that a detection carries, 0 where it carries none.
#[must_use]
pub fn source_id(detection: &Detection) -> u64 {
    if detection.has(detection_flags::HAS_ID) { detection.id } else { 0 }
}
