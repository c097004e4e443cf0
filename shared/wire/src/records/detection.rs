use crate::declare::{constants, record};

/// Bits of [`Detection::flags`].
pub mod detection_flags {
    use super::constants;

    constants! {
        /// `id` is valid.
        pub const HAS_ID: u32 = 1;
        /// `heading_rad` is valid.
        pub const HAS_HEADING: u32 = 1 << 1;
        /// `speed_mps` is valid: along the heading, negative in reverse.
        pub const HAS_SPEED: u32 = 1 << 2;
        /// `length_m` and `width_m` are valid.
        pub const HAS_SIZE: u32 = 1 << 3;
    }
}

record! {
    /// One detected object: element of the topic `detections`.
    pub struct Detection: 64 bytes {
        /// Identity given by the sensor or recording; see [`detection_flags::HAS_ID`].
        0 => id: u64,
        /// Position in the world frame.
        8 => x_m: f32,
        /// Position in the world frame.
        12 => y_m: f32,
        /// Heading, counter-clockwise from +x.
        16 => heading_rad: f32,
        /// Speed along the heading.
        20 => speed_mps: f32,
        /// Extent along the heading.
        24 => length_m: f32,
        /// Extent across the heading.
        28 => width_m: f32,
        /// The detector's confidence, higher is more confident; 1 if it reports none.
        32 => score: f32,
        /// Standard deviation of the position per axis; 0 for the tracker's value for the type.
        36 => sigma_m: f32,
        /// [`crate::AgentType`] as a number.
        40 => agent_type: u32,
        /// Bits of [`detection_flags`].
        44 => flags: u32,
        /// Time of the measurement minus the frame's stamp, at most [`OFFSET_MAX_NS`](crate::OFFSET_MAX_NS)
        /// in magnitude; 0 if it was made at the stamp.
        48 => offset_ns: i64,
        /// The sensor that made the measurement, from 1 to [`SENSORS_MAX`](crate::SENSORS_MAX); 0 if it is not
        /// reported.
        56 => sensor: u8,
        /// Zero.
        57 => reserved: [u8; 7],
    }
}

record! {
    /// The true state at the stamp of a frame: element of the topic `truth`, which only the recorder reads.
    pub struct Truth: 32 bytes {
        /// Identity in the recording.
        0 => id: u64,
        /// [`crate::AgentType`] as a number.
        8 => agent_type: u32,
        /// Position in the world frame.
        12 => x_m: f32,
        /// Position in the world frame.
        16 => y_m: f32,
        /// Zero.
        20 => reserved: [u8; 4],
        /// Time of the position minus the frame's stamp.
        24 => offset_ns: i64,
    }
}
