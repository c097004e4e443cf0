//! levelX drone recordings inD, rounD, exiD and uniD: road users at crossings, roundabouts and ramps, 25 Hz,
//! in metres in a local frame with x east and y north. [`highd`](super::highd) has its own layout.
//!
//! | file | columns that are read; other columns are allowed |
//! |---|---|
//! | `NN_tracks.csv` | `trackId,frame,xCenter,yCenter,heading,width,length,xVelocity,yVelocity` |
//! | `NN_tracksMeta.csv` | `trackId,class` |
//! | `NN_recordingMeta.csv` | `frameRate` |
//!
//! Headings are in degrees counter-clockwise from +x. Width and length are 0 if they are unknown, as for
//! pedestrians. Cars, vans, trucks, buses, trailers and motorcycles are vehicles, and bicycles are cyclists.
//! A pedestrian's heading is the direction of its velocity, from 0.1 m/s on.

use std::collections::BTreeMap;

use wire::{AgentType, Detection, detection_flags};

use crate::input::need;
use crate::rows::{self, ALL_TYPES, Rows};
use crate::text::{self, Columns, Field, Line, Separator};
use crate::{FrameRate, Input, ReadError, Recording, Role, sweeps};

const TRACKS: [&str; 9] =
    ["trackId", "frame", "xCenter", "yCenter", "heading", "width", "length", "xVelocity", "yVelocity"];
const TRACKS_META: [&str; 2] = ["trackId", "class"];

/// Whether the line is a header of this format's rows.
pub(crate) fn is_header(line: &Line<'_>) -> bool {
    let has = |wanted: &str| line.pieces(Separator::Comma).any(|(_, name)| name == wanted);
    has("trackId") && has("xCenter")
}

/// Reads the three files of a recording.
pub(crate) fn parse(inputs: &[Input]) -> Result<Recording, ReadError> {
    let tracks = need(inputs, Role::Rows)?;
    let meta = need(inputs, Role::TracksMeta)?;
    let rate = frame_rate(need(inputs, Role::RecordingMeta)?)?;
    let mut types: BTreeMap<u64, AgentType> = BTreeMap::new();
    for fields in rows_of(meta, &TRACKS_META)? {
        let (_, [id, class]) = fields?;
        types.insert(id.id_below(u64::MAX)?, agent_type(class)?);
    }
    let mut rows = Rows::default();
    for fields in rows_of(tracks, &TRACKS)? {
        let (line, fields) = fields?;
        let (stamp_ns, detection) = row(fields, &types, &meta.path, rate)?;
        rows.push(&line, stamp_ns, detection)?;
    }
    let frames = sweeps::numbered(&rows.sorted(tracks)?, ALL_TYPES);
    Ok(Recording { interval_ns: rate.interval_ns(1), has_identities: true, frames, ..Recording::default() })
}

type NamedRow<'a, const N: usize> = Result<(Line<'a>, [Field<'a>; N]), ReadError>;

/// The rows below a header, with values by column name.
pub(super) fn rows_of<'a, const N: usize>(
    input: &'a Input,
    names: &'static [&'static str; N],
) -> Result<impl Iterator<Item = NamedRow<'a, N>>, ReadError> {
    let mut lines = text::lines(input);
    let first = lines.next().ok_or_else(|| ReadError::Empty { path: input.path.clone() })??;
    let columns = Columns::of_header(&first, names)?;
    Ok(lines.map(move |line| {
        let line = line?;
        Ok((line, columns.fields(&line)?))
    }))
}

/// The frame rate in the file of the recording's attributes.
pub(super) fn frame_rate(meta: &Input) -> Result<FrameRate, ReadError> {
    let mut rows = rows_of(meta, &["frameRate"])?;
    let (_, [rate]) = rows.next().ok_or_else(|| ReadError::Empty { path: meta.path.clone() })??;
    FrameRate::new(rate.number()?).map_err(|error| rate.error(error.to_string()))
}

/// The type of a class, in any capitalisation.
pub(super) fn agent_type(class: Field<'_>) -> Result<AgentType, ReadError> {
    match class.text.to_ascii_lowercase().as_str() {
        "car" | "van" | "truck" | "bus" | "truck_bus" | "trailer" | "motorcycle" => Ok(AgentType::Vehicle),
        "bicycle" => Ok(AgentType::Cyclist),
        "pedestrian" => Ok(AgentType::Pedestrian),
        _ => Err(class
            .error("expected car, van, truck, bus, truck_bus, trailer, motorcycle, bicycle or pedestrian")),
    }
}

/// The attributes of a track. An identity without attributes is an error.
pub(super) fn attributes<T: Copy>(
    id: Field<'_>,
    known: &BTreeMap<u64, T>,
    meta_path: &str,
) -> Result<(u64, T), ReadError> {
    let number = id.id_below(u64::MAX)?;
    let of_track = known.get(&number).ok_or_else(|| id.error(format!("has no row in {meta_path}")))?;
    Ok((number, *of_track))
}

fn row(
    [id, frame, x, y, heading, width, length, vx, vy]: [Field<'_>; 9],
    types: &BTreeMap<u64, AgentType>,
    meta_path: &str,
    rate: FrameRate,
) -> Result<(i64, Detection), ReadError> {
    let (number, agent_type) = attributes(id, types, meta_path)?;
    let detection = rows::identified(agent_type, text::position_m([x, y])?, number);
    let heading_rad = text::wrapped(heading.number()?.to_radians()) as f32;
    let [length_m, width_m] = [length.extent_m()?, width.extent_m()?];
    let detection = match agent_type {
        AgentType::Pedestrian => rows::with_velocity(detection, vx, vy)?,
        _ => {
            let [vx_mps, vy_mps] = [vx.speed_mps()?, vy.speed_mps()?];
            Detection {
                heading_rad,
                speed_mps: vx.speed_of(vx_mps * heading_rad.cos() + vy_mps * heading_rad.sin())?,
                flags: detection.flags | detection_flags::HAS_HEADING | detection_flags::HAS_SPEED,
                ..detection
            }
        }
    };
    let detection = match length_m > 0.0 && width_m > 0.0 {
        true => {
            Detection { length_m, width_m, flags: detection.flags | detection_flags::HAS_SIZE, ..detection }
        }
        false => detection,
    };
    Ok((frame.stamp_ns(rate)?, detection))
}
