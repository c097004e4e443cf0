//! levelX highD: vehicles on motorways, 25 Hz, metres in the image's frame, whose y points down.
//!
//! | file | columns that are read; other columns are allowed |
//! |---|---|
//! | `NN_tracks.csv` | `frame,id,x,y,width,height,xVelocity,yVelocity` |
//! | `NN_tracksMeta.csv` | `id,class,drivingDirection` |
//! | `NN_recordingMeta.csv` | `frameRate` |
//!
//! `x`, `y` is the upper left corner of a vehicle's box, `width` its length along the road, and `height` its
//! width. The reader takes the middle of the box and negates y, so that the world is right-handed. The
//! heading is the direction of the velocity, or the driving direction below 0.1 m/s: 1 is towards −x, 2
//! towards +x.

use std::collections::BTreeMap;
use std::f32::consts::PI;

use wire::{AgentType, Detection, detection_flags};

use super::levelx::{agent_type, attributes, frame_rate, rows_of};
use crate::input::need;
use crate::rows::{self, HEADING_SPEED_MPS, Rows};
use crate::text::{Field, Line, Separator};
use crate::{FrameRate, Input, ReadError, Recording, Role, sweeps};

const TRACKS: [&str; 8] = ["frame", "id", "x", "y", "width", "height", "xVelocity", "yVelocity"];
const TRACKS_META: [&str; 3] = ["id", "class", "drivingDirection"];

/// Whether the line is a header of this format's rows.
pub(crate) fn is_header(line: &Line<'_>) -> bool {
    let has = |wanted: &&str| line.pieces(Separator::Comma).any(|(_, name)| name == *wanted);
    TRACKS.iter().all(has)
}

/// Reads the three files of a recording.
pub(crate) fn parse(inputs: &[Input]) -> Result<Recording, ReadError> {
    let tracks = need(inputs, Role::Rows)?;
    let meta = need(inputs, Role::TracksMeta)?;
    let rate = frame_rate(need(inputs, Role::RecordingMeta)?)?;
    let mut known: BTreeMap<u64, (AgentType, f32)> = BTreeMap::new();
    for fields in rows_of(meta, &TRACKS_META)? {
        let (_, [id, class, direction]) = fields?;
        let direction_rad = match direction.integer()? {
            1 => PI,
            2 => 0.0,
            _ => return Err(direction.error("expected 1 or 2")),
        };
        known.insert(id.id_below(u64::MAX)?, (agent_type(class)?, direction_rad));
    }
    let mut rows = Rows::default();
    for fields in rows_of(tracks, &TRACKS)? {
        let (line, fields) = fields?;
        let (stamp_ns, detection) = row(fields, &known, &meta.path, rate)?;
        rows.push(&line, stamp_ns, detection)?;
    }
    let frames = sweeps::numbered(&rows.sorted(tracks)?, AgentType::Vehicle.bit());
    Ok(Recording { interval_ns: rate.interval_ns(1), has_identities: true, frames, ..Recording::default() })
}

fn row(
    [frame, id, x, y, length, width, vx, vy]: [Field<'_>; 8],
    known: &BTreeMap<u64, (AgentType, f32)>,
    meta_path: &str,
    rate: FrameRate,
) -> Result<(i64, Detection), ReadError> {
    let (number, (agent_type, direction_rad)) = attributes(id, known, meta_path)?;
    let [length_m, width_m] = [length.extent_m()?, width.extent_m()?];
    let [left_m, top_m] = [x.position_m()?, y.position_m()?];
    let [vx_mps, vy_mps] = [vx.speed_mps()?, -vy.speed_mps()?];
    let speed_mps = vx.speed_of(vx_mps.hypot(vy_mps))?;
    let moves = speed_mps >= HEADING_SPEED_MPS;
    let detection = rows::identified(agent_type, [left_m + length_m / 2.0, -(top_m + width_m / 2.0)], number);
    let detection = Detection {
        heading_rad: if moves { vy_mps.atan2(vx_mps) } else { direction_rad },
        speed_mps,
        length_m,
        width_m,
        flags: detection.flags
            | detection_flags::HAS_HEADING
            | detection_flags::HAS_SPEED
            | detection_flags::HAS_SIZE,
        ..detection
    };
    // The middle of a box can be outside the world although its corner is inside.
    if !(detection.x_m.abs() <= wire::POSITION_MAX_M && detection.y_m.abs() <= wire::POSITION_MAX_M) {
        return Err(x.error("the middle of the box lies outside the world"));
    }
    Ok((frame.stamp_ns(rate)?, detection))
}
