use filters::Observation;
use wire::{AgentType, Detection, detection_flags};

use crate::options::{InputModel, SMOOTH_M, TrackerOptions};

/// Bounds of a detection's own noise. Beyond them, variances overflow or vanish in a published covariance.
const SIGMA_RANGE_M: (f64, f64) = (1e-6, 1e3);
/// Reported deviations from here on stand for unknown ones. A detector of moving agents is better.
const SIGMA_UNKNOWN_M: f32 = 20.0;

/// A detection with its own time.
#[derive(Clone, Copy, Debug)]
pub struct Found<'a> {
    /// The detection.
    pub detection: &'a Detection,
    /// The type.
    pub agent_type: AgentType,
    /// Time of measurement: the detection's own time.
    pub own_ns: i64,
}

impl<'a> Found<'a> {
    /// A detection of the frame with this stamp.
    #[must_use]
    pub const fn new(stamp_ns: i64, detection: &'a Detection, agent_type: AgentType) -> Self {
        Self { detection, agent_type, own_ns: stamp_ns.saturating_add(detection.offset_ns) }
    }

    /// The bits of the position.
    #[must_use]
    pub const fn place(&self) -> [u32; 2] {
        [self.detection.x_m.to_bits(), self.detection.y_m.to_bits()]
    }

    /// The position.
    #[must_use]
    pub fn position_m(&self) -> [f64; 2] {
        [self.detection.x_m, self.detection.y_m].map(f64::from)
    }

    /// The reported speed.
    #[must_use]
    pub fn speed_mps(&self) -> Option<f64> {
        let has_speed = self.detection.has(detection_flags::HAS_SPEED);
        has_speed.then(|| f64::from(self.detection.speed_mps).abs())
    }
}

/// The observation of a detection. A detection without its own noise gets the noise of its type. A speed that its
/// type cannot have is unknown.
#[must_use]
pub fn observation(detection: &Detection, agent_type: AgentType, input: &InputModel) -> Observation {
    let noise = &input.sensor[agent_type.index()];
    let value = |flag, value: f32, sigma: f64| detection.has(flag).then(|| (f64::from(value), sigma.powi(2)));
    let position_m = [detection.x_m, detection.y_m].map(f64::from);
    let position_variance = position_sigma_m(detection, agent_type, input).powi(2);
    Observation {
        position_m,
        position_variance,
        elongation: input.by_view.elongation(agent_type, position_m, position_variance),
        heading_rad: value(detection_flags::HAS_HEADING, detection.heading_rad, noise.heading_rad),
        speed_mps: value(detection_flags::HAS_SPEED, detection.speed_mps, noise.speed_mps)
            .filter(|(speed_mps, _)| speed_mps.abs() <= input.speed_limits.of(agent_type)),
    }
}

/// Standard deviation of a detection's position per axis.
#[must_use]
pub fn position_sigma_m(detection: &Detection, agent_type: AgentType, input: &InputModel) -> f64 {
    let by_view = input.by_view.factor(agent_type, [detection.x_m, detection.y_m].map(f64::from));
    let by_sensor = |is_reported| input.by_sensor.deviation(agent_type, detection.sensor, is_reported);
    match detection.sigma_m {
        sigma_m if is_known(sigma_m) => {
            let reported_factor = input.reported_factor[agent_type.index()];
            let factor = by_view * by_sensor(true).unwrap_or(reported_factor);
            (factor * f64::from(sigma_m)).clamp(SIGMA_RANGE_M.0, SIGMA_RANGE_M.1)
        }
        _ => {
            (by_view * by_sensor(false).unwrap_or(input.sensor[agent_type.index()].position_m)).max(SMOOTH_M)
        }
    }
}

/// Largest factor on the nominal deviation in association by position. A gate that grows with the learned noise
/// lets in clutter, which increases the learned noise.
const GATE_MAX: f64 = 2.0;

/// Standard deviation of a detection's position in association: the learned one, but at least the nominal one,
/// because a gate must also hold manoeuvres.
#[must_use]
pub fn gate_sigma_m(
    detection: &Detection,
    agent_type: AgentType,
    input: &InputModel,
    options: &TrackerOptions,
) -> f64 {
    let nominal_m = nominal_sigma_m(detection, agent_type, options);
    position_sigma_m(detection, agent_type, input).clamp(nominal_m, GATE_MAX * nominal_m)
}

/// Standard deviation of a detection's position before anything is learned: the reported one, or else the prior
/// of its type. The tracker learns a factor on it.
#[must_use]
pub fn nominal_sigma_m(detection: &Detection, agent_type: AgentType, options: &TrackerOptions) -> f64 {
    match detection.sigma_m {
        sigma_m if is_known(sigma_m) => f64::from(sigma_m).clamp(SIGMA_RANGE_M.0, SIGMA_RANGE_M.1),
        _ => options.detector.sensor[agent_type.index()].position_m,
    }
}

/// Whether a reported deviation is known.
#[must_use]
pub fn is_known(sigma_m: f32) -> bool {
    sigma_m > 0.0 && sigma_m < SIGMA_UNKNOWN_M
}

/// The identity of a detection; 0 if it has none.
#[must_use]
pub fn source_id(detection: &Detection) -> u64 {
    if detection.has(detection_flags::HAS_ID) { detection.id } else { 0 }
}
