use audit::Found;
use serde::Serialize;
use wire::{Detection, Truth};

use crate::{FrameRate, Lines};

/// Pose of the ego vehicle in the world frame, or the scene's centre for a fixed sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ego {
    /// Position (x, y).
    pub position_m: [f32; 2],
    /// Heading, counter-clockwise from +x.
    pub heading_rad: f32,
    /// Whether the sensor is at this pose, so that agents can occlude others. If not (a view from above, or
    /// an unknown pose), the pose is the scene's centre.
    pub is_sensor: bool,
}

/// The detections of one sweep.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Time of the newest detection on the recording's clock. Each detection has its own time:
    /// [`Detection::offset_ns`] is 0 or negative.
    pub stamp_ns: i64,
    /// Bits ([`wire::AgentType::bit`]) of the types that the sensor can detect in this frame.
    pub observed_types: u32,
    /// Pose of the sensor.
    pub ego: Ego,
    /// The detections, sorted by (type, id) so that no result depends on the order of rows in a file.
    pub detections: Vec<Detection>,
    /// The true positions; empty if unknown.
    pub truth: Vec<Truth>,
    /// The lines of the detections in the files.
    pub lines: Lines,
}

impl Frame {
    /// The detection at an index as written in its file, with a heading that is not wrapped.
    #[must_use]
    pub fn written(&self, place: usize) -> Option<Detection> {
        let detection = *self.detections.get(place)?;
        let line = self.lines.get(place);
        Some(line.map_or(detection, |line| Detection { heading_rad: line.heading_written, ..detection }))
    }
}

/// Rows of a file that are not detections by the rules of its format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// The reason, in the format's words. It begins with *with* if only values of these rows are left out.
    pub reason: String,
    /// Number of rows.
    pub row_count: usize,
}

/// A topic of a bag.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BagTopic {
    /// The name.
    pub name: String,
    /// The type of its messages.
    #[serde(rename = "type")]
    pub schema: String,
    /// Number of its messages.
    pub messages: usize,
    /// Whether the recording consists of its objects.
    pub is_read: bool,
}

/// A recording or a generated scene: frames in time order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Name for reports.
    pub name: String,
    /// SHA-256 of the files read, empty for generated scenes; identifies recordings that training used.
    pub sha256: String,
    /// Nominal interval between frames.
    pub interval_ns: u64,
    /// Whether the detections carry identities that a tracker may trust.
    pub has_identities: bool,
    /// The frames, strictly increasing in `stamp_ns`.
    pub frames: Vec<Frame>,
    /// The rows that the format leaves out, by reason.
    pub left_out: Vec<LeftOut>,
    /// Findings of the reader, such as speeds that the motion contradicts. The detections do not have such values.
    pub findings: Vec<Found>,
    /// The topics of a bag, first those that are read.
    pub topics: Vec<BagTopic>,
    /// The rate of the files' frame numbers; `None` if the files contain their times.
    pub frame_rate: Option<FrameRate>,
    /// Whether the rows have their own stamps, so that the frames can be of several sensors. Otherwise the
    /// frames are numbered and of one sensor.
    pub own_stamps: bool,
    /// Frames without a pose of a moving sensor near enough in time. They have the last pose before them and
    /// count as not seen from it.
    pub poses_missing: usize,
    /// Metres per pixel of the recording's video, if the data set's errors are published in pixels.
    pub pixel_m: Option<f64>,
}
