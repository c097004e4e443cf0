//! KITTI tracking: a detector's output or the true tracks, 10 Hz, from a moving car.
//!
//! * Detections have one file per class and no identities:
//!   `frame,type,x1,y1,x2,y2,score,h,w,l,x,y,z,rot_y,alpha`. Type 1 is pedestrian, 2 car, 3 cyclist. Labels
//!   of the same sequence, if they exist, are the truth.
//! * Labels: `frame id type truncated occluded alpha x1 y1 x2 y2 h w l x y z rot_y`. `DontCare` marks regions
//!   of the image, and `Misc` objects that are not agents (such as trailers). Both are left out and counted.
//!   Vans, trucks and trams are vehicles, and sitting people are pedestrians. A tracker's results have a
//!   further column `score` and are read as labels.
//!
//! Both are in the camera frame. [`WorldFromCamera`] transforms them by `oxts` and `calib` of the same
//! sequence to a world frame (m, rad). Its x points east and y north, and its origin is the car's first
//! position. Each row of `oxts` makes a frame, even if the frame has no detections. [`Annotations`] contains
//! the part of the labels that the evaluation of a tracker needs.

mod annotations;
pub(crate) mod files;
mod geometry;

use wire::{AgentType, Detection, Truth, detection_flags};

pub use annotations::{AnnotatedFrame, AnnotatedObject, Annotations};
pub use geometry::WorldFromCamera;

use crate::input::{find, need, need_any};
use crate::lines::{Paths, RowLine};
use crate::rows::{self, ALL_TYPES, PEDESTRIAN_IDS, Rows};
use crate::text::{self, Field, Line, Separator};
use crate::{Frame, Input, LeftOut, ReadError, Recording, Role};

const DETECTION_NAMES: [&str; 15] =
    ["frame", "type", "x1", "y1", "x2", "y2", "score", "h", "w", "l", "x", "y", "z", "rot_y", "alpha"];
const RESULT_NAMES: [&str; 18] = [
    "frame",
    "id",
    "type",
    "truncated",
    "occluded",
    "alpha",
    "x1",
    "y1",
    "x2",
    "y2",
    "h",
    "w",
    "l",
    "x",
    "y",
    "z",
    "rot_y",
    "score",
];
const LABEL_NAMES: [&str; 17] = {
    let [names @ .., _] = RESULT_NAMES;
    names
};
/// Interval between frames.
pub const INTERVAL_NS: u64 = 100_000_000;

/// Mean height of the labelled objects of a type.
pub(crate) const fn height_m(agent_type: AgentType) -> f64 {
    match agent_type {
        AgentType::Vehicle => 1.6,
        AgentType::Cyclist | AgentType::Pedestrian => 1.75,
    }
}

/// An object's box in the camera frame: the seven columns that both files have.
struct CameraBox<'a> {
    length: Field<'a>,
    width: Field<'a>,
    centre: [Field<'a>; 3],
    rotation: Field<'a>,
}

/// Reads the detectors' output.
pub(crate) fn parse_detections(inputs: &[Input]) -> Result<Recording, ReadError> {
    let poses = WorldFromCamera::parse(need(inputs, Role::Calibration)?, need(inputs, Role::EgoMotion)?)?;
    need_any(inputs, &[Role::Vehicles, Role::Pedestrians, Role::Cyclists])?;
    let classes = [
        (Role::Vehicles, AgentType::Vehicle),
        (Role::Pedestrians, AgentType::Pedestrian),
        (Role::Cyclists, AgentType::Cyclist),
    ];
    let present = classes.into_iter().filter(|(role, _)| find(inputs, *role).is_some());
    let observed_types = present.fold(0, |bits, (_, agent_type)| bits | agent_type.bit());
    let mut frames = empty_frames(&poses, observed_types);
    let mut row_count = 0;
    let mut paths = Paths::default();
    for (input, agent_type) in classes.into_iter().filter_map(|(role, t)| Some((find(inputs, role)?, t))) {
        for line in text::lines(input) {
            let line = line?;
            let (frame, detection) =
                detection(line.split(Separator::Comma, &DETECTION_NAMES)?, agent_type, &poses)?;
            row_count += 1;
            crate::rows::limit(row_count, &line)?;
            let (path, heading_written) = (paths.path(line.path), detection.heading_rad);
            frames[frame].detections.push(detection);
            frames[frame].lines.push(RowLine { path, line: line.number, heading_written });
        }
    }
    let mut left_out = Vec::new();
    if let Some(input) = find(inputs, Role::Labels) {
        let labels = Labels::parse(input, &poses)?;
        for row in labels.rows.sorted_or_none()? {
            frames[(row.stamp_ns / INTERVAL_NS as i64) as usize].truth.push(rows::truth_of(&row.detection));
        }
        left_out = labels.left_out;
    }
    Ok(recording(frames, false, left_out))
}

/// Reads the true tracks.
pub(crate) fn parse_labels(inputs: &[Input]) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    let poses = WorldFromCamera::parse(need(inputs, Role::Calibration)?, need(inputs, Role::EgoMotion)?)?;
    let labels = Labels::parse(input, &poses)?;
    let mut frames = empty_frames(&poses, ALL_TYPES);
    let mut paths = Paths::default();
    for row in labels.rows.sorted_or_none()? {
        let frame = &mut frames[(row.stamp_ns / INTERVAL_NS as i64) as usize];
        frame.detections.push(row.detection);
        frame.lines.push(paths.line(&row));
        frame.truth.push(rows::truth_of(&row.detection));
    }
    Ok(recording(frames, true, labels.left_out))
}

fn recording(mut frames: Vec<Frame>, has_identities: bool, left_out: Vec<LeftOut>) -> Recording {
    for frame in &mut frames {
        rows::sort(&mut frame.detections, &mut frame.lines);
        frame.truth.sort_by_key(|truth: &Truth| (truth.agent_type, truth.id));
    }
    Recording { interval_ns: INTERVAL_NS, has_identities, frames, left_out, ..Recording::default() }
}

fn empty_frames(poses: &WorldFromCamera, observed_types: u32) -> Vec<Frame> {
    let frame = |(index, ego)| Frame {
        stamp_ns: index as i64 * INTERVAL_NS as i64,
        observed_types,
        ego,
        ..Frame::default()
    };
    poses.egos().enumerate().map(frame).collect()
}

fn frame_index(field: Field<'_>, poses: &WorldFromCamera) -> Result<usize, ReadError> {
    let frames_len = poses.frames_len();
    let frame = usize::try_from(field.frame()?).ok().filter(|&frame| frame < frames_len);
    frame.ok_or_else(|| field.error(format!("ego motion is known of frames 0 to {}", frames_len - 1)))
}

fn detection(
    fields: [Field<'_>; 15],
    agent_type: AgentType,
    poses: &WorldFromCamera,
) -> Result<(usize, Detection), ReadError> {
    let [frame, kind, x1, y1, x2, y2, score, h, width, length, x, y, z, rotation, alpha] = fields;
    let expected = match agent_type {
        AgentType::Pedestrian => 1,
        AgentType::Vehicle => 2,
        AgentType::Cyclist => 3,
    };
    if kind.integer()? != expected {
        return Err(kind.error(format!("expected {expected}, as in every row for a {}", agent_type.name())));
    }
    for unused in [x1, y1, x2, y2, h, alpha] {
        unused.number()?;
    }
    let frame = frame_index(frame, poses)?;
    let seen = CameraBox { length, width, centre: [x, y, z], rotation };
    let score = score.number_in(-1e6..=1e6)? as f32;
    Ok((frame, Detection { score, ..seen.in_world(frame, agent_type, poses)? }))
}

impl CameraBox<'_> {
    /// Transforms the object to the world frame.
    fn in_world(
        &self,
        frame: usize,
        agent_type: AgentType,
        poses: &WorldFromCamera,
    ) -> Result<Detection, ReadError> {
        let [x, y, z] = self.centre;
        let centre_m = [x.number()?, y.number()?, z.number()?];
        let (position_m, heading_rad) = poses.object(frame, centre_m, self.rotation.angle_rad()?);
        // NaN fails the comparison as well.
        let near = position_m.iter().all(|x| x.abs() <= f64::from(wire::POSITION_MAX_M));
        if !near || !heading_rad.is_finite() {
            return Err(x.error("stands nowhere near the car's first position"));
        }
        let extents = detection_flags::HAS_HEADING | detection_flags::HAS_SIZE;
        Ok(Detection {
            heading_rad: heading_rad as f32,
            length_m: self.length.extent_m()?,
            width_m: self.width.extent_m()?,
            flags: extents,
            ..rows::detection(agent_type, position_m.map(|x| x as f32))
        })
    }
}

/// A label file.
struct Labels<'a> {
    rows: Rows<'a>,
    left_out: Vec<LeftOut>,
}

impl<'a> Labels<'a> {
    fn parse(input: &'a Input, poses: &WorldFromCamera) -> Result<Self, ReadError> {
        let mut rows = Rows::default();
        let mut left_out = ["DontCare", "Misc"].map(|kind| (kind, 0));
        for line in text::lines(input) {
            let line = line?;
            let fields = label_fields(&line)?;
            if let Some((_, row_count)) = left_out.iter_mut().find(|(kind, _)| *kind == fields[2].text) {
                for number in fields[..2].iter().chain(&fields[3..]) {
                    number.number()?;
                }
                *row_count += 1;
                continue;
            }
            let (frame, detection) = label(fields, poses)?;
            rows.push(&line, frame as i64 * INTERVAL_NS as i64, detection)?;
        }
        let counted = left_out.into_iter().filter(|(_, row_count)| *row_count > 0);
        let left_out =
            counted.map(|(kind, row_count)| LeftOut { reason: kind.to_owned(), row_count }).collect();
        Ok(Self { rows, left_out })
    }
}

/// The columns of a label, or of a result with its score.
fn label_fields<'a>(line: &Line<'a>) -> Result<[Field<'a>; 17], ReadError> {
    if line.pieces(Separator::Space).count() != RESULT_NAMES.len() {
        return line.split(Separator::Space, &LABEL_NAMES);
    }
    let [fields @ .., score] = line.split(Separator::Space, &RESULT_NAMES)?;
    score.number()?;
    Ok(fields)
}

fn label(fields: [Field<'_>; 17], poses: &WorldFromCamera) -> Result<(usize, Detection), ReadError> {
    let [frame, id, kind, truncated, occluded, alpha, x1, y1, x2, y2, h, width, length, x, y, z, rotation] =
        fields;
    for unused in [truncated, occluded, alpha, x1, y1, x2, y2, h] {
        unused.number()?;
    }
    let agent_type = match kind.text {
        "Car" | "Van" | "Truck" | "Tram" => AgentType::Vehicle,
        "Pedestrian" | "Person_sitting" | "Person" => AgentType::Pedestrian,
        "Cyclist" => AgentType::Cyclist,
        _ => return Err(kind.error("not a class of KITTI tracking")),
    };
    let frame = frame_index(frame, poses)?;
    let seen = CameraBox { length, width, centre: [x, y, z], rotation };
    let detection = seen.in_world(frame, agent_type, poses)?;
    let id = id.id_below(PEDESTRIAN_IDS)?;
    Ok((frame, Detection { id, flags: detection.flags | detection_flags::HAS_ID, ..detection }))
}
