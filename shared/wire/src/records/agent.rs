use crate::declare::record;
use crate::{HISTORY_MAX, HORIZON_MAX, MODES_MAX, NODE_ATTRIBUTES, STATE_FEATURES, TEMPORAL};

record! {
    /// The extractor's output for an agent: first section of the topic `features`.
    pub struct AgentFeatures: 2304 bytes {
        /// The track.
        0 => id: u64,
        /// [`crate::AgentType`] as a number.
        8 => agent_type: u32,
        /// As in [`crate::Track::forecastable`].
        12 => forecastable: u32,
        /// Bit k is set if the agent has a state at history step k.
        16 => present: u32,
        /// Length if known, else 0; determines the rear axle of the bicycle.
        20 => length_m: f32,
        /// State features s in the model's scale; zero rows for absent steps.
        24 => state: [[f32; STATE_FEATURES]; HISTORY_MAX],
        /// Node attributes v = \[SE ‖ CE\]; zero rows for absent steps.
        216 => node: [[f32; NODE_ATTRIBUTES]; HISTORY_MAX],
        /// Its turn from 1, if a tick does not have time for all agents; 0 for the order of the frame.
        2264 => turn: u32,
        /// 1 if the agent is left out of this tick to save time: it is present only for its neighbours.
        2268 => shed: u32,
        /// Zero.
        2272 => reserved: [u8; 32],
    }
}

record! {
    /// The graph dual attention's summary of an agent: element of the topic `encodings`.
    pub struct AgentEncoding: 512 bytes {
        /// The track.
        0 => id: u64,
        /// [`crate::AgentType`] as a number.
        8 => agent_type: u32,
        /// As in [`crate::Track::forecastable`].
        12 => forecastable: u32,
        /// Bit k is set if the agent has a state at history step k.
        16 => present: u32,
        /// Length if known, else 0.
        20 => length_m: f32,
        /// State features s as in [`AgentFeatures`]: the decoder's burn-in and the base control read them.
        24 => state: [[f32; STATE_FEATURES]; HISTORY_MAX],
        /// The temporal summary ṽ_h.
        216 => temporal: [f32; TEMPORAL],
        /// Its turn from 1, if a tick does not have time for all agents; 0 for the order of the frame.
        472 => turn: u32,
        /// 1 if the agent is left out of this tick to save time: it is present only for its neighbours.
        476 => shed: u32,
        /// Zero.
        480 => reserved: [u8; 32],
    }
}

record! {
    /// The Gaussian of a control u = μ + L ε.
    pub struct ControlGaussian: 20 bytes {
        /// Mean μ, see [`crate::Steering`].
        0 => mean: [f32; 2],
        /// Lower Cholesky factor L as \[l11, l21, l22\].
        8 => cholesky: [f32; 3],
    }
}

record! {
    /// The controls of an agent with a forecast: element of the topic `controls`.
    pub struct AgentControls: 5312 bytes {
        /// The track.
        0 => id: u64,
        /// [`crate::AgentType`] as a number.
        8 => agent_type: u32,
        /// Valid modes, at most [`MODES_MAX`].
        12 => modes_len: u32,
        /// Probability of each mode; they sum to 1.
        16 => probability: [f32; MODES_MAX],
        /// Controls of each mode and step, before saturation: acceleration and slip rate for a vehicle,
        /// otherwise displacements.
        96 => modes: [[ControlGaussian; HORIZON_MAX]; MODES_MAX],
        /// Controls of the single best forecast (K = 1).
        4896 => best: [ControlGaussian; HORIZON_MAX],
        /// The model's base control for the single best forecast, without the network's part; zeros if the
        /// model has no base.
        5136 => base: [[f32; 2]; HORIZON_MAX],
        /// Distance of the history from the data that the base control was fitted to, relative to its width;
        /// 0 inside, and if the model does not report it.
        5232 => out_of_distribution: f32,
        /// Zero.
        5236 => reserved: [u8; 76],
    }
}
