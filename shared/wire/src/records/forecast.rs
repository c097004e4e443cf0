use std::borrow::Cow;

use super::ControlGaussian;
use crate::declare::{numbers, record};
use crate::{AgentType, CONFLICTS_MAX, EXPERTS_MAX, HORIZON_MAX, MODES_MAX, Rejected};

numbers! {
    /// The origin of a forecast.
    pub enum Quality {
        /// The model's forecast of this tick.
        Learned = 0 => "learned",
        /// The model's forecast of an earlier tick, shifted to the current time.
        Held = 1 => "held",
        /// Zero control with growing covariance.
        Kinematic = 2 => "kinematic",
    }
}

/// What the name of a number that this version does not know begins with.
const UNKNOWN: &str = "number ";

numbers! {
    /// Why a forecast is not [`Quality::Learned`].
    ///
    /// Numbers up to 31, each with a bit in [`Forecast::causes`]. These are reserved for future causes: 7
    /// detections missing, 8 stage restarted, 9 integrity check failed, 10 out of distribution, 11 source
    /// frozen.
    pub enum Cause {
        /// Nothing is wrong.
        None = 0 => "none",
        /// The controls of this tick had not arrived at the deadline.
        Late = 1 => "late",
        /// The controls of this tick were refused as not finite or impossible.
        Rejected = 2 => "rejected",
        /// The controls of this tick do not contain the track.
        Missing = 3 => "missing",
        /// The track has too short a history for the model.
        Young = 4 => "young",
        /// Constant velocity has more than half of the weight: the other experts proved to be worse.
        Outdone = 5 => "outdone",
        /// The agent was left out of this tick, which did not have time for all agents.
        Shed = 6 => "shed",
    }
}

numbers! {
    /// The meaning of a forecast's controls.
    pub enum Steering {
        /// There are no controls.
        None = 0 => "none",
        /// Acceleration in m/s² and slip rate in rad/s of a kinematic bicycle.
        Bicycle = 1 => "bicycle",
        /// Displacement of the step relative to constant velocity from the forecast's start, in m along and
        /// across the agent.
        Displacement = 2 => "displacement",
    }
}

numbers! {
    /// The origin of a mode; numbers below [`EXPERTS_MAX`] are slots of [`Forecast::expert_weights`].
    pub enum Expert {
        /// The network.
        Network = 0 => "network",
        /// The model's base control alone.
        Base = 1 => "base",
        /// Constant velocity.
        ConstantVelocity = 2 => "constant velocity",
        /// A decaying turn.
        DecayingTurn = 3 => "decaying turn",
        /// The tracker's process model: zero control.
        ProcessModel = 4 => "process model",
        /// A decaying acceleration.
        DecayingAcceleration = 5 => "decaying acceleration",
        /// A decaying turn with a decaying acceleration, behind the vehicle ahead; of a pedestrian: no motion.
        Following = 6 => "following",
        /// The lane nearest to the decaying turn, with a decaying acceleration, behind the vehicle ahead; of a
        /// pedestrian: the mean velocity of the last 1.6 s.
        Lane = 7 => "lane",
        /// A centre between constant velocity and the single best forecast, plus a typical residual of
        /// similar agents.
        Fan = 254 => "fan",
        /// The network's best forecast with residuals of other agents at the same place, from the retrieval
        /// memory.
        Retrieval = 255 => "retrieval",
    }
}

impl Expert {
    /// The name for agents of a type. Pedestrians follow neither vehicles nor lanes, so two slots have other
    /// experts.
    #[must_use]
    pub const fn name_for(self, agent_type: AgentType) -> &'static str {
        match (self, agent_type) {
            (Self::Following, AgentType::Pedestrian) => "standing",
            (Self::Lane, AgentType::Pedestrian) => "mean velocity",
            _ => self.name(),
        }
    }
}

record! {
    /// A conflict that forecasts foretell: two agents whose outlines may come closer than 0.5 m within the
    /// horizon.
    pub struct ForeseenConflict: 24 bytes {
        /// The other track.
        0 => other_id: u64,
        /// Probability that the conflict happens: the share of such pairs on recordings.
        8 => probability: f32,
        /// Probability by the modes, as if neither agent reacted to the other.
        12 => if_nobody_reacts: f32,
        /// Mean time until it happens, s.
        16 => in_s: f32,
        /// Zero.
        20 => reserved: u32,
    }
}

record! {
    /// The forecast of an agent: element of the topic `forecasts`. Step k is (k + 1) Δt after the frame's
    /// stamp.
    pub struct Forecast: 10304 bytes {
        /// The track.
        0 => id: u64,
        /// The detections' own identity if they have one, else 0.
        8 => source_id: u64,
        /// Time between the stamp of the controls and this frame's stamp; 0 for learned forecasts.
        16 => age_ns: u64,
        /// As in [`crate::Track::prior_age_ns`].
        24 => prior_age_ns: u64,
        /// [`crate::AgentType`] as a number.
        32 => agent_type: u32,
        /// [`Quality`] as a number.
        36 => quality: u32,
        /// [`Cause`] as a number: the first one that applies.
        40 => cause: u32,
        /// Bits of all causes that apply, see [`Cause::bit`]; 0 if there are none.
        44 => causes: u32,
        /// Valid modes, at most [`MODES_MAX`].
        48 => modes_len: u32,
        /// As in [`crate::Track::prior`].
        52 => prior: u32,
        /// [`Steering`] as a number.
        56 => steering: u32,
        /// Direction of the axes of displacements: the agent's heading at the stamp of the controls.
        60 => frame_heading_rad: f32,
        /// Position at the stamp.
        64 => x_m: f32,
        /// Position at the stamp.
        68 => y_m: f32,
        /// Velocity at the stamp.
        72 => vx_mps: f32,
        /// Velocity at the stamp.
        76 => vy_mps: f32,
        /// Heading at the stamp.
        80 => heading_rad: f32,
        /// Extent along the heading; 0 if unknown.
        84 => length_m: f32,
        /// Extent across the heading; 0 if unknown.
        88 => width_m: f32,
        /// Distance of the agent's history from the model's training data, relative to their width; 0 inside,
        /// and if it is not reported. At 0.25 the network's part is halved.
        92 => out_of_distribution: f32,
        /// Weight of each [`Expert`] by its number: network, base, constant velocity, decaying turn, process
        /// model, decaying acceleration, following or standing, lane or mean velocity; zeros if they are not
        /// reported.
        96 => expert_weights: [f32; EXPERTS_MAX],
        /// Probability of each mode; they sum to 1.
        128 => probability: [f32; MODES_MAX],
        /// [`Expert`] of each mode as a number.
        208 => mode_expert: [u8; MODES_MAX],
        /// 1 if the forecast follows lanes of the map, 2 if a moving vehicle is not on a lane; 0 without a
        /// map, for all other agents, and if it is not reported.
        228 => lanes: u32,
        /// As in [`crate::Track::noise_m`].
        232 => noise_m: f32,
        /// As in [`crate::Track::noise_heading_rad`].
        236 => noise_heading_rad: f32,
        /// As in [`crate::Track::noise_speed_mps`].
        240 => noise_speed_mps: f32,
        /// Conflicts in `conflicts`.
        244 => conflicts_len: u32,
        /// The agent's most probable conflicts, the most probable first; none if the sampler is not asked for them.
        248 => conflicts: [ForeseenConflict; CONFLICTS_MAX],
        /// Zero.
        296 => reserved: [u8; 8],
        /// Covariance of the mixture of all modes as (xx, xy, yy), m².
        304 => covariance: [[f32; 3]; HORIZON_MAX],
        /// The single best forecast (K = 1).
        448 => best: [[f32; 2]; HORIZON_MAX],
        /// Mean of the mixture of all modes.
        544 => mean: [[f32; 2]; HORIZON_MAX],
        /// Mean positions (x, y) of each mode and step in the world frame, m.
        640 => modes: [[[f32; 2]; HORIZON_MAX]; MODES_MAX],
        /// Covariance of the position of each mode and step as (xx, xy, yy), m².
        2560 => mode_covariance: [[[f32; 3]; HORIZON_MAX]; MODES_MAX],
        /// The controls that lead to `modes`, as applied (after saturation), with their first step at the
        /// stamp of the controls; zeros if `steering` is 0, none.
        5440 => controls: [[ControlGaussian; HORIZON_MAX]; MODES_MAX],
        /// Zero. They make the size an odd number of cache lines. At a multiple of 2 KiB, the same field of
        /// many forecasts would share few sets of a cache.
        10240 => reserved_end: [u8; 64],
    }
}

impl Forecast {
    /// Value of [`Forecast::lanes`]: the forecast follows lanes.
    pub const ALONG_LANES: u32 = 1;
    /// Value of [`Forecast::lanes`]: a moving vehicle is not on a lane.
    pub const OFF_LANES: u32 = 2;

    /// Whether the forecast uses controls of its own tick. This includes forecasts that are not called
    /// learned because constant velocity was known to be nearer.
    pub const fn is_served(&self) -> bool {
        self.quality == Quality::Learned as u32 || self.cause == Cause::Outdone as u32
    }
}

impl TryFrom<u32> for Quality {
    type Error = Rejected;

    fn try_from(number: u32) -> Result<Self, Rejected> {
        let unknown = Rejected::Impossible { field: "quality", value: f64::from(number) };
        Self::from_number(number).ok_or(unknown)
    }
}

impl TryFrom<u32> for Steering {
    type Error = Rejected;

    fn try_from(number: u32) -> Result<Self, Rejected> {
        let unknown = Rejected::Impossible { field: "steering", value: f64::from(number) };
        Self::from_number(number).ok_or(unknown)
    }
}

impl Cause {
    /// The cause's bit in [`Forecast::causes`]; [`Cause::None`] has no bit.
    pub const fn bit(self) -> u32 {
        1 << self as u32 & !1
    }

    /// The name of the cause with this number; `number 17` if this version does not know it.
    #[must_use]
    pub fn name_of(number: u32) -> Cow<'static, str> {
        Self::from_number(number)
            .map_or_else(|| format!("{UNKNOWN}{number}").into(), |cause| cause.name().into())
    }

    /// The number of the cause with this name, as [`Self::name_of`] returns it; `None` for any other name.
    #[must_use]
    pub fn number_of(name: &str) -> Option<u32> {
        match Self::ALL.into_iter().find(|cause| cause.name() == name) {
            Some(cause) => Some(cause as u32),
            None => name.strip_prefix(UNKNOWN)?.parse().ok(),
        }
    }
}
