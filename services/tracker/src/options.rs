use filters::{Bicycle, ConstantVelocity, Integrator, Models};
use run::{Declaration, SpeedLimits};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::{AgentType, Detection, HISTORY_MAX, Header, SPEED_MAX_MPS, StageId, detection_flags, flags};

use crate::noise::{SensorFactors, ViewFactors};
use crate::{FieldOfView, Tracker};

/// The tracker.
pub const STAGE: Declaration<Options> = ports::declare::<Tracker, _>(StageId::Tracker);

/// What may be set of the tracker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Whether to associate detections by position even if they carry identities.
    pub associate: bool,
    /// Prediction of tracks between detections. `learned`: earlier forecasts and the process model;
    /// `kinematic`: the process model alone.
    pub prior: Prior,
    /// How detections correct tracks. `assignment`: one detection corrects each track; `jpda`: all detections
    /// within its gate do, weighted.
    pub association: Association,
    /// Field of view of the sensor, a sector about the ego's heading, for detections from the ego. Tracks
    /// outside lose little if they are missed. Unlimited if not given.
    pub fov: Option<FieldOfView>,
    /// Number of consecutive frames with bit-identical moving detections after which the source counts as
    /// frozen. Tracks are then predicted without them. 0 turns this off.
    #[schemars(range(max = 1000))]
    pub frozen_frames: u32,
    /// Maximum speed of a vehicle, m/s. No measurement, track or forecast is faster.
    #[schemars(range(max = SPEED_MAX_MPS), extend("exclusiveMinimum" = 0.0))]
    pub vehicle_speed_max_mps: f64,
    /// Maximum speed of a cyclist, m/s.
    #[schemars(range(max = SPEED_MAX_MPS), extend("exclusiveMinimum" = 0.0))]
    pub cyclist_speed_max_mps: f64,
    /// Maximum speed of a pedestrian, m/s.
    #[schemars(range(max = SPEED_MAX_MPS), extend("exclusiveMinimum" = 0.0))]
    pub pedestrian_speed_max_mps: f64,
}

impl Default for Options {
    fn default() -> Self {
        let limits = SpeedLimits::default();
        Self {
            associate: false,
            prior: Prior::default(),
            association: Association::default(),
            fov: None,
            // Two thirds of a second: a detector of 2 Hz may be sent again in every tick.
            frozen_frames: 8,
            vehicle_speed_max_mps: limits.vehicle_mps,
            cyclist_speed_max_mps: limits.cyclist_mps,
            pedestrian_speed_max_mps: limits.pedestrian_mps,
        }
    }
}

impl Options {
    /// The highest speeds.
    #[must_use]
    pub const fn speed_limits(&self) -> SpeedLimits {
        SpeedLimits {
            vehicle_mps: self.vehicle_speed_max_mps,
            cyclist_mps: self.cyclist_speed_max_mps,
            pedestrian_mps: self.pedestrian_speed_max_mps,
        }
    }
}

/// What predicts a track between two detections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Prior {
    /// Its type's process model alone.
    Kinematic,
    /// The newest forecast of the track, if it has one, and the process model.
    #[default]
    Learned,
}

/// How detections without a trusted identity correct tracks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Association {
    /// Each track by one detection: the cheapest assignment.
    #[default]
    Assignment,
    /// Each published track by all detections within its gate, weighted by their association probabilities
    /// (JPDA).
    Jpda,
}

/// Standard deviations of a detector's measurements, for detections that contain none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorNoise {
    /// Position per axis.
    pub position_m: f64,
    /// Heading.
    pub heading_rad: f64,
    /// Speed along the heading.
    pub speed_mps: f64,
}

/// How agents of one type are expected to move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionNoise {
    /// Spectral density of the acceleration per axis, m²/s³, for the constant-velocity filter.
    pub density: f64,
    /// Standard deviation of the acceleration in 80 ms, for the bicycle.
    pub acceleration_mps2: f64,
    /// Standard deviation of the slip rate in 80 ms, for the bicycle.
    pub slip_rate_radps: f64,
    /// Rate at which the slip angle decays, for the bicycle.
    pub slip_decay_per_s: f64,
}

impl MotionNoise {
    /// The constants at this share of the way from one input to another.
    fn between(from: &Self, to: &Self, share: f64) -> Self {
        Self {
            density: mix_log(from.density, to.density, share),
            acceleration_mps2: mix_log(from.acceleration_mps2, to.acceleration_mps2, share),
            slip_rate_radps: mix_log(from.slip_rate_radps, to.slip_rate_radps, share),
            slip_decay_per_s: mix(from.slip_decay_per_s, to.slip_decay_per_s, share),
        }
    }
}

fn mix(from: f64, to: f64, share: f64) -> f64 {
    if share == 0.0 { from } else { from + share * (to - from) }
}

/// Like [`mix`], on a logarithmic scale.
fn mix_log(from: f64, to: f64, share: f64) -> f64 {
    if share == 0.0 { from } else { from * (to / from).powf(share) }
}

/// How far forecasts are trusted as a prior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForecastTrust {
    /// Minimum weight of the process model when a forecast arrives, within \[0, 1\]. The weight is larger
    /// until forecasts have proved accurate, and again when they fail.
    pub kinematic_weight: f64,
    /// Factor on the covariances of a forecast's controls.
    pub covariance_scale: f64,
    /// Share of the process model's noise (standard deviations) that the forecast's modes keep when their
    /// controls act at full gain.
    pub noise_share: f64,
    /// Standard deviation of a vehicle's speed at which the gain of its acceleration control is one half.
    pub half_gain_speed_mps: f64,
    /// Standard deviation of a vehicle's heading at which the gain of its slip-rate control is one half.
    pub half_gain_heading_rad: f64,
    /// Time constant with which a vehicle's acceleration and slip rate fade in, because the estimated state
    /// is the better predictor at first. With 0, they act at once.
    pub control_fade_in_s: f64,
    /// The same time constant for displacements.
    pub displacement_fade_in_s: f64,
}

impl ForecastTrust {
    /// The constants at this share of the way from one input to another.
    fn between(from: &Self, to: &Self, share: f64) -> Self {
        let of = |constant: fn(&Self) -> f64| mix(constant(from), constant(to), share);
        Self {
            kinematic_weight: of(|trust| trust.kinematic_weight),
            covariance_scale: of(|trust| trust.covariance_scale),
            noise_share: of(|trust| trust.noise_share),
            half_gain_speed_mps: of(|trust| trust.half_gain_speed_mps),
            half_gain_heading_rad: of(|trust| trust.half_gain_heading_rad),
            control_fade_in_s: of(|trust| trust.control_fade_in_s),
            displacement_fade_in_s: of(|trust| trust.displacement_fade_in_s),
        }
    }
}

/// What the tracker assumes of one kind of input, by agent type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputModel {
    /// Measurement noise.
    pub sensor: [SensorNoise; 3],
    /// Factor on the deviations of positions that detections report themselves.
    pub reported_factor: [f64; 3],
    /// Factors on the deviations of positions by the view from the sensor.
    pub by_view: ViewFactors,
    /// Factors on the nominal deviations of positions by the sensor, if there are several.
    pub by_sensor: SensorFactors,
    /// Process noise.
    pub motion: [MotionNoise; 3],
    /// How far forecasts are trusted when they are the prior.
    pub trust: [ForecastTrust; 3],
    /// Weight of the steady motion if it predicts as well as the free one does, within \[0, 1\].
    pub steadiness: [f64; 3],
    /// Coast time. A track ends after this time without a detection, in frames that observed its type.
    pub coast_ns: u64,
    /// Highest speed of each type. A higher reported speed counts as unknown.
    pub speed_limits: SpeedLimits,
}

/// Settings of a tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerOptions {
    /// Steps of the history window, T_h, at most [`HISTORY_MAX`].
    pub history_len: usize,
    /// Spacing of the window's steps, Δt.
    pub step_ns: u64,
    /// Maximum number of tracks, including tentative ones. At this number, detections start no new tracks.
    pub tracks_max: usize,
    /// Associates by position even if the detections carry identities.
    pub associate: bool,
    /// What predicts tracks between two detections.
    pub prior: Prior,
    /// How detections without identities correct tracks.
    pub association: Association,
    /// Field of view of the sensor, for frames that are detected from the ego; `None` for no limits.
    pub fov: Option<FieldOfView>,
    /// Number of consecutive frames with the same detections at which the source counts as frozen; 0 for
    /// never.
    pub frozen_frames: u32,
    /// Highest speed of each type.
    pub speed_limits: SpeedLimits,
    /// Model of noisy inputs, and the prior of the noise.
    pub detector: InputModel,
    /// Model of annotated or smoothed recordings, whose positions are nearly free of noise.
    pub smooth: InputModel,
    /// Probability that an agent in view is detected.
    pub detection_probability: f64,
    /// False detections per m² and frame.
    pub clutter_density: f64,
    /// Cost of leaving a track without detection, on the scale of −2 ln of a likelihood per m².
    pub miss_cost: f64,
    /// A track always ends after this time without a detection: the forecast's horizon. Out-of-sequence
    /// frames that are later than this are refused.
    pub horizon_ns: u64,
    /// History is not interpolated over longer gaps between states.
    pub gap_max_ns: u64,
}

/// Chosen by the errors of tracks and of their forecasts. If positions are nearly free of noise, the modes
/// track best with the full noise of the process model. If positions are noisy, the modes' controls explain
/// most of that noise. The half-gain deviations were chosen on the validation recordings of INTERACTION,
/// under noise of 0.02, 0.1 and 0.3 m.
const TRUST: ForecastTrust = ForecastTrust {
    kinematic_weight: 0.05,
    covariance_scale: 1.0,
    noise_share: 1.0,
    half_gain_speed_mps: 0.7,
    half_gain_heading_rad: 0.02,
    control_fade_in_s: 0.0,
    displacement_fade_in_s: 0.5,
};

/// The noise of vehicles was chosen with the kinematic prior on the validation recordings of INTERACTION. The
/// criteria were errors and identity switches under noise of 0.1 and 0.3 m. The slip decay also lowers errors
/// under noise of 0.02 m. A faster decay would narrow the gate until identities switch more often.
const DETECTOR: InputModel = InputModel {
    sensor: [
        SensorNoise { position_m: 0.25, heading_rad: 0.12, speed_mps: 1.0 },
        SensorNoise { position_m: 0.2, heading_rad: 0.25, speed_mps: 0.7 },
        SensorNoise { position_m: 0.15, heading_rad: 0.5, speed_mps: 0.5 },
    ],
    motion: [
        MotionNoise { density: 4.0, acceleration_mps2: 2.8, slip_rate_radps: 0.1, slip_decay_per_s: 0.15 },
        MotionNoise { density: 2.0, acceleration_mps2: 2.0, slip_rate_radps: 0.5, slip_decay_per_s: 0.0 },
        MotionNoise { density: 0.5, acceleration_mps2: 1.0, slip_rate_radps: 0.5, slip_decay_per_s: 0.0 },
    ],
    reported_factor: [1.0; 3],
    by_view: ViewFactors::NONE,
    by_sensor: SensorFactors::NONE,
    trust: [ForecastTrust { noise_share: 0.3, ..TRUST }; 3],
    steadiness: [1.0; 3],
    coast_ns: 2_000_000_000,
    speed_limits: SpeedLimits::USUAL,
};

/// Standard deviation of the positions of smooth recordings, and the least that is assumed of positions without
/// a reported deviation.
pub const SMOOTH_M: f64 = 0.03;

/// Chosen so that the filtered state, extrapolated for 0.8 s at its velocity, comes nearest to the agent's
/// true position. It comes nearer than with the recording's velocity or with the backward difference of
/// positions.
const SMOOTH: InputModel = InputModel {
    sensor: [
        SensorNoise { position_m: SMOOTH_M, heading_rad: 0.05, speed_mps: 0.1 },
        SensorNoise { position_m: SMOOTH_M, heading_rad: 0.05, speed_mps: 0.1 },
        SensorNoise { position_m: SMOOTH_M, heading_rad: 0.1, speed_mps: 0.1 },
    ],
    motion: [
        MotionNoise { density: 4.0, acceleration_mps2: 6.0, slip_rate_radps: 0.5, slip_decay_per_s: 0.0 },
        MotionNoise { density: 2.0, acceleration_mps2: 3.0, slip_rate_radps: 0.7, slip_decay_per_s: 0.0 },
        MotionNoise { density: 0.3, acceleration_mps2: 1.0, slip_rate_radps: 0.5, slip_decay_per_s: 0.0 },
    ],
    // Chosen by the errors of tracks across gaps, on driving recordings from other sources, under noise of
    // 0.1 m.
    reported_factor: [1.0; 3],
    by_view: ViewFactors::NONE,
    by_sensor: SensorFactors::NONE,
    trust: [ForecastTrust { control_fade_in_s: 0.2, ..TRUST }; 3],
    steadiness: [0.0; 3],
    coast_ns: 1_000_000_000,
    speed_limits: SpeedLimits::USUAL,
};

impl Default for TrackerOptions {
    fn default() -> Self {
        Self {
            history_len: HISTORY_MAX,
            step_ns: 400_000_000,
            tracks_max: 512,
            associate: false,
            prior: Prior::default(),
            association: Association::default(),
            fov: None,
            frozen_frames: 0,
            speed_limits: SpeedLimits::default(),
            detector: DETECTOR,
            smooth: SMOOTH,
            detection_probability: 0.9,
            clutter_density: 1e-3,
            miss_cost: 14.5,
            horizon_ns: 4_800_000_000,
            gap_max_ns: 2_000_000_000,
        }
    }
}

impl TrackerOptions {
    /// Coast time of tracks in this frame. An upstream tracker that sends identities has its own.
    pub(crate) fn coast_ns(&self, header: &Header) -> u64 {
        if self.has_own_identities(header) { self.smooth.coast_ns } else { self.detector.coast_ns }
    }

    /// Whether the frame's detections come with identities that replace association.
    pub(crate) fn has_own_identities(&self, header: &Header) -> bool {
        header.has(flags::HAS_IDENTITIES) && !self.associate
    }

    /// Whether the identities of the detections replace association.
    pub(crate) fn trusts(&self, header: &Header, detections: &[Detection]) -> bool {
        self.has_own_identities(header) && detections.iter().all(|d| d.has(detection_flags::HAS_ID))
    }
}

/// The noise of positions from which an input counts as noisy. In between, the constants are interpolated on
/// a logarithmic scale.
pub const NOISY_M: f64 = 0.1;

/// The noise of positions from which steady motion and smoothing count fully.
const STEADY_FROM_M: f64 = 0.05;

/// 0 for positions with the noise of a smooth recording, 1 from `most_m` on, logarithmic in between.
pub fn noisiness(noise_m: f64, most_m: f64) -> f64 {
    ((noise_m / SMOOTH_M).ln() / (most_m / SMOOTH_M).ln()).clamp(0.0, 1.0)
}

/// Distance from reference point to rear axle, as a share of the length.
const REAR_AXLE_RATIO: f64 = 0.26;
/// Lengths by agent type, for tracks of unknown length.
const LENGTH_M: [f64; 3] = [4.5, 1.8, 1.8];

impl InputModel {
    /// The model of the options before anything is learned.
    pub(crate) fn of_options(header: &Header, options: &TrackerOptions) -> Self {
        let (coast_ns, speed_limits) = (options.coast_ns(header), options.speed_limits);
        Self { coast_ns, speed_limits, ..options.detector }
    }

    /// Sets the motion and the trust of a type for positions with this noise: the constants of `smooth` inputs
    /// up to their noise, and the constants of `noisy` inputs from [`NOISY_M`] on.
    pub(crate) fn set_motion(&mut self, agent_type: AgentType, noise_m: f64, smooth: &Self, noisy: &Self) {
        let i = agent_type.index();
        let share_of = |most_m: f64| noisiness(noise_m, most_m);
        let share = share_of(NOISY_M);
        self.motion[i] = MotionNoise::between(&smooth.motion[i], &noisy.motion[i], share);
        self.trust[i] = ForecastTrust::between(&smooth.trust[i], &noisy.trust[i], share);
        self.steadiness[i] = mix(smooth.steadiness[i], noisy.steadiness[i], share_of(STEADY_FROM_M));
    }

    /// The process models of an agent of this type and length. A length of 0 means unknown.
    #[must_use]
    pub fn models(&self, agent_type: AgentType, length_m: f64) -> Models {
        let noise = &self.motion[agent_type.index()];
        let length_m = if length_m > 0.0 { length_m } else { LENGTH_M[agent_type.index()] };
        Models {
            constant_velocity: ConstantVelocity { density: noise.density },
            bicycle: Bicycle {
                integrator: Integrator::Euler,
                rear_axle_m: REAR_AXLE_RATIO * length_m.clamp(1.0, 25.0),
                acceleration_mps2: noise.acceleration_mps2,
                slip_rate_radps: noise.slip_rate_radps,
                slip_decay_per_s: noise.slip_decay_per_s,
                floor: [1e-4, 1e-4, 1e-5, 0.0, 0.0],
                slip_max_rad: 0.5,
            },
        }
    }
}
