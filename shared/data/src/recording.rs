use wire::{Detection, Truth};

/// Pose of the ego vehicle in the world frame, or the scene's centre for a fixed sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ego {
    /// Position (x, y).
    pub position_m: [f32; 2],
    /// Heading, counter-clockwise from +x.
    pub heading_rad: f32,
    /// Whether the sensor sees from there, so that agents hide others; a view from above, or an unknown one, has a centre only.
    pub is_sensor: bool,
}

/// What the sensor saw at one time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Time of validity on the recording's clock.
    pub stamp_ns: i64,
    /// Bits ([`wire::AgentType::bit`]) of the types that the sensor looked for in this frame.
    pub observed_types: u32,
    /// Where the sensor was.
    pub ego: Ego,
    /// What it saw, sorted by (type, id) so that no result depends on the order of rows in a file.
    pub detections: Vec<Detection>,
    /// Where the agents really were; empty where nobody knows.
    pub truth: Vec<Truth>,
}

/// Rows of a file that by the rules of its format stand for no detection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// Why, in the format's words.
    pub reason: String,
    /// How many rows.
    pub rows_len: usize,
}

/// A recording or a generated scene: frames in time order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Name for reports.
    pub name: String,
    /// SHA-256 of the files read, empty for generated scenes; tells whether a recording was seen in training.
    pub sha256: String,
    /// Nominal interval between frames.
    pub interval_ns: u64,
    /// Whether the detections carry identities that a tracker may trust.
    pub has_identities: bool,
    /// The frames, strictly increasing in `stamp_ns`.
    pub frames: Vec<Frame>,
    /// What the format told to leave out, so that nothing is skipped in silence.
    pub left_out: Vec<LeftOut>,
    /// Metres per pixel of the video where the recording comes from one whose errors are published in pixels.
    pub pixel_m: Option<f64>,
}
