use crate::declare::{numbers, record};
use crate::{HISTORY_MAX, MODES_MAX};

record! {
    /// A step of a track's history.
    pub struct HistoryState: 24 bytes {
        /// Position in the world frame.
        0 => x_m: f32,
        /// Position in the world frame.
        4 => y_m: f32,
        /// Velocity in the world frame.
        8 => vx_mps: f32,
        /// Velocity in the world frame.
        12 => vy_mps: f32,
        /// Heading, also defined at rest.
        16 => heading_rad: f32,
        /// 1 if the track has a state at this step, else 0, with all other fields 0.
        20 => present: u32,
    }
}

numbers! {
    /// Whether a track was detected in the newest frame that could contain it.
    pub enum TrackStatus {
        /// Updated by a detection of the newest frame that observed its type.
        Confirmed = 0 => "confirmed",
        /// Predicted over one or more frames without a detection.
        Coasting = 1 => "coasting",
    }
}

record! {
    /// A confirmed or coasting track: element of the topic `tracks` and first section of `context`.
    pub struct Track: 512 bytes {
        /// The track's identity; never reused within a run.
        0 => id: u64,
        /// The detections' own identity if they have one, else 0.
        8 => source_id: u64,
        /// Stamp of the track's first state.
        16 => born_ns: i64,
        /// Time since the last detection that updated the track.
        24 => unseen_ns: u64,
        /// [`crate::AgentType`] as a number.
        32 => agent_type: u32,
        /// [`TrackStatus`] as a number.
        36 => status: u32,
        /// Rows of the covariance in use: 5 for \[x, y, ψ, v, β\], 4 for \[x, y, vx, vy\].
        40 => state_len: u32,
        /// 1 if the track is at least Δt old and has two states in its history, else 0.
        44 => forecastable: u32,
        /// Filtered position.
        48 => x_m: f32,
        /// Filtered position.
        52 => y_m: f32,
        /// Filtered heading. It turns by at most 60° between frames, also if front and back are exchanged.
        56 => heading_rad: f32,
        /// Filtered speed along the heading; negative in reverse.
        60 => speed_mps: f32,
        /// Filtered slip angle; 0 if the state has none.
        64 => slip_rad: f32,
        /// Filtered velocity in the world frame.
        68 => vx_mps: f32,
        /// Filtered velocity in the world frame.
        72 => vy_mps: f32,
        /// Extent along the heading; 0 if unknown.
        76 => length_m: f32,
        /// Extent across the heading; 0 if unknown.
        80 => width_m: f32,
        /// Probability that the object exists.
        84 => existence: f32,
        /// Probability of each [`crate::AgentType`].
        88 => type_probability: [f32; 3],
        /// Covariance of the filtered state, row-major, `state_len` × `state_len`, the rest 0.
        100 => covariance: [f32; 25],
        /// States at now − (T_h − 1 − k) Δt, oldest first, in the first `history_len` entries. A published
        /// state is never changed later. Of noisy detections, the older states are smoothed.
        200 => history: [HistoryState; HISTORY_MAX],
        /// [`crate::Quality`] of the prediction to this stamp, as a number: a forecast, one that is older
        /// than Δt, or the process model alone.
        392 => prior: u32,
        /// Standard deviation per axis of the positions that the detector reports for the track's type, as the
        /// tracker has learned it; 0 without enough evidence, and if it is not reported.
        396 => noise_m: f32,
        /// Time since the stamp of that forecast's controls; 0 if there is none.
        400 => prior_age_ns: u64,
        /// Weight of each of its modes, and last the weight of the process model; they sum to 1.
        408 => prior_weights: [f32; MODES_MAX + 1],
        /// The same of the headings, modulo a half turn.
        492 => noise_heading_rad: f32,
        /// Time between the stamp of the controls of the track's newest learned forecast that the tracker has
        /// received and this frame's; 0 if there is none, or it is not reported.
        496 => learned_age_ns: u64,
        /// The same of the speeds.
        504 => noise_speed_mps: f32,
        /// Zero.
        508 => reserved: [u8; 4],
    }
}
