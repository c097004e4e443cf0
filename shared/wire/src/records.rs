mod check;

use bytemuck::{Pod, Zeroable};

use crate::{
    EDGE_ATTRIBUTES, HISTORY_MAX, HORIZON_MAX, MODES_MAX, NODE_ATTRIBUTES, Rejected, STATE_FEATURES, TEMPORAL,
};

/// Bits of [`Detection::flags`].
pub mod detection_flags {
    /// `id` is valid.
    pub const HAS_ID: u32 = 1;
    /// `heading_rad` is valid.
    pub const HAS_HEADING: u32 = 1 << 1;
    /// `speed_mps` is valid: along the heading, negative in reverse.
    pub const HAS_SPEED: u32 = 1 << 2;
    /// `length_m` and `width_m` are valid.
    pub const HAS_SIZE: u32 = 1 << 3;
}

/// One detected object: element of the topic `detections`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Detection {
    /// Identity given by the sensor or recording; see [`detection_flags::HAS_ID`].
    pub id: u64,
    /// Position in the world frame.
    pub x_m: f32,
    /// Position in the world frame.
    pub y_m: f32,
    /// Heading, counter-clockwise from +x.
    pub heading_rad: f32,
    /// Speed along the heading.
    pub speed_mps: f32,
    /// Extent along the heading.
    pub length_m: f32,
    /// Extent across the heading.
    pub width_m: f32,
    /// The detector's confidence, greater is surer; 1 where it tells none.
    pub score: f32,
    /// Standard deviation of the position per axis; 0 takes the tracker's own for the type.
    pub sigma_m: f32,
    /// [`crate::AgentType`] as a number.
    pub agent_type: u32,
    /// Bits of [`detection_flags`].
    pub flags: u32,
}

/// A step of a track's history.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct HistoryState {
    /// Position in the world frame.
    pub x_m: f32,
    /// Position in the world frame.
    pub y_m: f32,
    /// Velocity in the world frame.
    pub vx_mps: f32,
    /// Velocity in the world frame.
    pub vy_mps: f32,
    /// Heading; defined also at rest.
    pub heading_rad: f32,
    /// 1 where the track has a state at this step, else 0 and all others 0.
    pub present: u32,
}

/// Whether a track was seen in the newest frame that could have seen it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum TrackStatus {
    /// Updated by a detection of the newest frame that observed its type.
    Confirmed = 0,
    /// Predicted over one or more frames without a detection.
    Coasting = 1,
}

/// A confirmed or coasting track: element of the topic `tracks` and first section of `context`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Track {
    /// The track's identity; never reused within a run.
    pub id: u64,
    /// The detections' own identity where they carry one, else 0.
    pub source_id: u64,
    /// Stamp of the track's first state.
    pub born_ns: i64,
    /// Time since the last detection that updated the track.
    pub unseen_ns: u64,
    /// [`crate::AgentType`] as a number.
    pub agent_type: u32,
    /// [`TrackStatus`] as a number.
    pub status: u32,
    /// Rows of the covariance in use: 5 for \[x, y, ψ, v, β\], 4 for \[x, y, vx, vy\].
    pub state_len: u32,
    /// 1 once the track is Δt old and has two states in its history, else 0.
    pub forecastable: u32,
    /// Filtered position.
    pub x_m: f32,
    /// Filtered position.
    pub y_m: f32,
    /// Filtered heading; turns by at most 60° from one frame to the next, also where the front is found to be the back.
    pub heading_rad: f32,
    /// Filtered speed along the heading; negative in reverse.
    pub speed_mps: f32,
    /// Filtered slip angle; 0 where the state has none.
    pub slip_rad: f32,
    /// Filtered velocity in the world frame.
    pub vx_mps: f32,
    /// Filtered velocity in the world frame.
    pub vy_mps: f32,
    /// Extent along the heading; 0 where unknown.
    pub length_m: f32,
    /// Extent across the heading; 0 where unknown.
    pub width_m: f32,
    /// Probability that the object exists.
    pub existence: f32,
    /// Probability of each [`crate::AgentType`].
    pub type_probability: [f32; 3],
    /// Covariance of the filtered state, row-major, `state_len` × `state_len`, the rest 0.
    pub covariance: [f32; 25],
    /// States at now − (T_h − 1 − k) Δt, oldest first, in the first `history_len` entries. Once published for a
    /// stamp, a state is never rewritten.
    pub history: [HistoryState; HISTORY_MAX],
    /// [`Quality`] of what moved the state to this stamp, as a number: a forecast, one that is older than Δt, or the
    /// process model alone.
    pub prior: u32,
    /// Zero.
    pub reserved: u32,
    /// Time since the stamp of that forecast's controls; 0 where there is none.
    pub prior_age_ns: u64,
    /// Weight of each of its modes, and last that of the process model alone; they sum to 1.
    pub prior_weights: [f32; MODES_MAX + 1],
    /// Zero.
    pub reserved_end: [u32; 5],
}

/// What the extractor tells of an agent: first section of the topic `features`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct AgentFeatures {
    /// The track.
    pub id: u64,
    /// [`crate::AgentType`] as a number.
    pub agent_type: u32,
    /// As in [`Track::forecastable`].
    pub forecastable: u32,
    /// Bit k is set where the agent has a state at history step k.
    pub present: u32,
    /// Length where known, else 0; sets the rear axle of the bicycle.
    pub length_m: f32,
    /// State features s, scaled as the model wants them; zero rows where absent.
    pub state: [[f32; STATE_FEATURES]; HISTORY_MAX],
    /// Node attributes v = \[SE ‖ CE\]; zero rows where absent.
    pub node: [[f32; NODE_ATTRIBUTES]; HISTORY_MAX],
    /// Zero.
    pub reserved: [u32; 10],
}

/// The graph dual attention's summary of an agent: element of the topic `encodings`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct AgentEncoding {
    /// The track.
    pub id: u64,
    /// [`crate::AgentType`] as a number.
    pub agent_type: u32,
    /// As in [`Track::forecastable`].
    pub forecastable: u32,
    /// Bit k is set where the agent has a state at history step k.
    pub present: u32,
    /// Length where known, else 0.
    pub length_m: f32,
    /// State features s as in [`AgentFeatures`]: the decoder's burn-in and the base control read them.
    pub state: [[f32; STATE_FEATURES]; HISTORY_MAX],
    /// The temporal summary ṽ_h.
    pub temporal: [f32; TEMPORAL],
}

/// The Gaussian of a control u = μ + L ε.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ControlGaussian {
    /// Mean μ, see [`Steering`].
    pub mean: [f32; 2],
    /// Lower Cholesky factor L as \[l11, l21, l22\].
    pub cholesky: [f32; 3],
}

/// The controls of an agent that is forecast: element of the topic `controls`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct AgentControls {
    /// The track.
    pub id: u64,
    /// [`crate::AgentType`] as a number.
    pub agent_type: u32,
    /// Valid modes, at most [`MODES_MAX`].
    pub modes_len: u32,
    /// Probability of each mode; they sum to 1.
    pub probability: [f32; MODES_MAX],
    /// Controls of each mode and step, before saturation: of a vehicle acceleration and slip rate, else displacements.
    pub modes: [[ControlGaussian; HORIZON_MAX]; MODES_MAX],
    /// Controls of the single best forecast (K = 1).
    pub best: [ControlGaussian; HORIZON_MAX],
}

/// Where a forecast comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Quality {
    /// The model's forecast of this tick.
    Learned = 0,
    /// The model's forecast of an earlier tick, moved on to now.
    Held = 1,
    /// Zero control with growing covariance.
    Kinematic = 2,
}

/// What the controls of a forecast stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Steering {
    /// There are none.
    None = 0,
    /// Acceleration in m/s² and slip rate in rad/s of a kinematic bicycle.
    Bicycle = 1,
    /// Displacement of the step beyond that of the velocity at the forecast's start, in m along and across the agent.
    Displacement = 2,
}

/// Why a forecast is not [`Quality::Learned`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Cause {
    /// Nothing is wrong.
    None = 0,
    /// The controls of this tick had not come at the deadline.
    Late = 1,
    /// The controls of this tick were refused as not finite or impossible.
    Rejected = 2,
    /// The controls of this tick do not name the track.
    Missing = 3,
    /// The track has too short a history for the model.
    Young = 4,
}

impl Quality {
    /// All qualities in the order of their numbers.
    pub const ALL: [Self; 3] = [Self::Learned, Self::Held, Self::Kinematic];

    /// The name used in files and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Learned => "learned",
            Self::Held => "held",
            Self::Kinematic => "kinematic",
        }
    }
}

impl TryFrom<u32> for Quality {
    type Error = Rejected;

    fn try_from(number: u32) -> Result<Self, Rejected> {
        let known = Self::ALL.get(number as usize).copied();
        known.ok_or(Rejected::Impossible { field: "quality", value: f64::from(number) })
    }
}

impl TryFrom<u32> for Steering {
    type Error = Rejected;

    fn try_from(number: u32) -> Result<Self, Rejected> {
        let known = [Self::None, Self::Bicycle, Self::Displacement];
        let known = known.get(number as usize).copied();
        known.ok_or(Rejected::Impossible { field: "steering", value: f64::from(number) })
    }
}

impl Cause {
    /// All causes in the order of their numbers.
    pub const ALL: [Self; 5] = [Self::None, Self::Late, Self::Rejected, Self::Missing, Self::Young];

    /// The name used in files and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Late => "late",
            Self::Rejected => "rejected",
            Self::Missing => "missing",
            Self::Young => "young",
        }
    }
}

/// The forecast of an agent: element of the topic `forecasts`. Step k lies (k + 1) Δt after the frame's stamp.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Forecast {
    /// The track.
    pub id: u64,
    /// The detections' own identity where they carry one, else 0.
    pub source_id: u64,
    /// Time between the stamp of the controls and this frame's stamp; 0 for learned forecasts.
    pub age_ns: u64,
    /// As in [`Track::prior_age_ns`].
    pub prior_age_ns: u64,
    /// [`crate::AgentType`] as a number.
    pub agent_type: u32,
    /// [`Quality`] as a number.
    pub quality: u32,
    /// [`Cause`] as a number.
    pub cause: u32,
    /// Valid modes, at most [`MODES_MAX`].
    pub modes_len: u32,
    /// Position at the stamp.
    pub x_m: f32,
    /// Position at the stamp.
    pub y_m: f32,
    /// Velocity at the stamp.
    pub vx_mps: f32,
    /// Velocity at the stamp.
    pub vy_mps: f32,
    /// Heading at the stamp.
    pub heading_rad: f32,
    /// Extent along the heading; 0 where unknown.
    pub length_m: f32,
    /// Extent across the heading; 0 where unknown.
    pub width_m: f32,
    /// As in [`Track::prior`].
    pub prior: u32,
    /// [`Steering`] as a number.
    pub steering: u32,
    /// Direction of the axes of displacements: the agent's heading at the stamp of the controls.
    pub frame_heading_rad: f32,
    /// Probability of each mode; they sum to 1.
    pub probability: [f32; MODES_MAX],
    /// Mean positions (x, y) of each mode and step in the world frame, m.
    pub modes: [[[f32; 2]; HORIZON_MAX]; MODES_MAX],
    /// The single best forecast (K = 1).
    pub best: [[f32; 2]; HORIZON_MAX],
    /// Mean of the mixture of all modes.
    pub mean: [[f32; 2]; HORIZON_MAX],
    /// Covariance of the mixture of all modes as (xx, xy, yy), m².
    pub covariance: [[f32; 3]; HORIZON_MAX],
    /// The controls that lead to `modes`, as they act (after saturation), their first step at the stamp of the controls;
    /// zeros where `steering` says that there are none.
    pub controls: [[ControlGaussian; HORIZON_MAX]; MODES_MAX],
}

/// What was really there at the stamp of a frame: element of the topic `truth`, which the recorder alone reads.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Truth {
    /// Identity in the recording.
    pub id: u64,
    /// [`crate::AgentType`] as a number.
    pub agent_type: u32,
    /// Position in the world frame.
    pub x_m: f32,
    /// Position in the world frame.
    pub y_m: f32,
    /// Zero.
    pub reserved: u32,
}

/// A stage's sign of life: element of the topic `heartbeats`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Heartbeat {
    /// The stage's number.
    pub stage: u32,
    /// How often the stage had been started before.
    pub incarnation: u32,
    /// Operating system's number of the process.
    pub pid: u32,
    /// 1 once a frame has passed from the stage's input to its output, else 0.
    pub linked: u32,
    /// Counts the stage's heartbeats.
    pub beat: u64,
    /// Number of the newest tick that the stage finished.
    pub seq: u64,
    /// Frames finished.
    pub frames_len: u64,
    /// Frames refused.
    pub rejected_len: u64,
    /// Frames that never arrived, by gaps in `seq`.
    pub dropped_len: u64,
    /// `CLOCK_MONOTONIC` at sending.
    pub sent_ns: u64,
}

const _: () = {
    assert!(size_of::<Detection>() == 48);
    assert!(size_of::<HistoryState>() == 24);
    assert!(size_of::<Track>() == 512);
    assert!(size_of::<AgentFeatures>() == 2304);
    assert!(size_of::<AgentEncoding>() == 472);
    assert!(size_of::<ControlGaussian>() == 20);
    assert!(size_of::<AgentControls>() == 5136);
    assert!(size_of::<Forecast>() == 7224);
    assert!(size_of::<Truth>() == 24);
    assert!(size_of::<Heartbeat>() == 64);
    assert!(EDGE_ATTRIBUTES * 4 == 64);
};
