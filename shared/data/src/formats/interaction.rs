//! INTERACTION: vehicles at 10 Hz, and pedestrians and cyclists of the same recording on the same clock.
//!
//! | file | columns, in metres and m/s |
//! |---|---|
//! | vehicles | `track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width` |
//! | pedestrians and cyclists, as published | `track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy` |
//! | the same without velocities | `track_id,frame_id,timestamp_ms,agent_type,x,y` |
//!
//! Pedestrians and cyclists have ids `P1`, `P2`, …; the reader turns `P7` into 1,000,000,007. A velocity
//! gives the speed, and from 0.1 m/s on the heading.
//!
//! **Observed types.** The published files have a row in every frame of the vehicles' 10 Hz, so every frame
//! observes pedestrians and cyclists. Files that were thinned to every fourth frame (2.5 Hz) are recognised
//! by their stamps, because most of these are whole multiples of 0.4 s. In such files, pedestrians and
//! cyclists are observed only by frames at those multiples and by frames with a row of them.
//!
//! **Cyclists.** The data have one class `pedestrian/bicycle`. An agent counts as a pedestrian until the
//! running median of its speeds exceeds 2.5 m/s. After that, it counts as a cyclist. The median is over at
//! least three speeds and at least 1.2 s. So the class at a time does not depend on later rows. The speeds
//! are the file's, or are computed from row to row if the file has none.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use wire::{AgentType, Detection, detection_flags};

use crate::input::{find, need_any};
use crate::row::Row;
use crate::rows::{self, PEDESTRIAN_IDS, Rows};
use crate::text::{self, Field, Line, Separator};
use crate::{Frame, Input, ReadError, Recording, Role, sweeps};

const VEHICLE_NAMES: [&str; 11] = [
    "track_id",
    "frame_id",
    "timestamp_ms",
    "agent_type",
    "x",
    "y",
    "vx",
    "vy",
    "psi_rad",
    "length",
    "width",
];
/// Columns of pedestrians and cyclists, as published.
const PEDESTRIAN_NAMES: [&str; 8] =
    ["track_id", "frame_id", "timestamp_ms", "agent_type", "x", "y", "vx", "vy"];
/// The same without velocities.
const PEDESTRIAN_POSITIONS_NAMES: [&str; 6] =
    ["track_id", "frame_id", "timestamp_ms", "agent_type", "x", "y"];
/// Interval between frames, as published.
const INTERVAL_NS: u64 = 100_000_000;
/// Interval between frames of pedestrians and cyclists that were thinned to every fourth one.
const THINNED_INTERVAL_NS: u64 = 400_000_000;
/// Median speed above which an agent counts as a cyclist.
const CYCLIST_SPEED_MPS: f32 = 2.5;
/// Minimum number of speeds for a median.
const CYCLIST_SPEEDS_MIN: usize = 3;
/// Shortest time for a median: that of three speeds from row to row at 2.5 Hz.
const CYCLIST_SPAN_NS: i64 = 1_200_000_000;
/// Latest time of a row: about 30 years.
const STAMP_MAX_MS: i64 = 1_000_000_000_000;

/// The stamp and content of a row.
type ReadRow = Result<(i64, Detection), ReadError>;

/// Reads vehicles, pedestrians and cyclists, or both together.
pub(crate) fn parse(inputs: &[Input]) -> Result<Recording, ReadError> {
    let first = need_any(inputs, &[Role::Vehicles, Role::Pedestrians])?;
    let mut rows = Rows::default();
    let vehicles = find(inputs, Role::Vehicles);
    let pedestrians = find(inputs, Role::Pedestrians);
    if let Some(input) = vehicles {
        read(input, &VEHICLE_NAMES, vehicle, &mut rows)?;
    }
    if let Some(input) = pedestrians {
        read_pedestrians(input, &mut rows)?;
    }
    let mut rows = rows.sorted(first)?;
    classify_cyclists(&mut rows);
    let observed = if vehicles.is_some() { AgentType::Vehicle.bit() } else { 0 };
    let pedestrian_interval_ns = pedestrian_interval_ns(&rows);
    let mut frames = sweeps::numbered(&rows, observed);
    let observes =
        |frame: &Frame| pedestrians.is_some() && observes_pedestrians(frame, pedestrian_interval_ns);
    for frame in frames.iter_mut().filter(|frame| observes(frame)) {
        frame.observed_types |= AgentType::Pedestrian.bit() | AgentType::Cyclist.bit();
    }
    let interval_ns = if vehicles.is_some() { INTERVAL_NS } else { pedestrian_interval_ns };
    Ok(Recording { interval_ns, has_identities: true, frames, ..Recording::default() })
}

/// The role of a file, by its first line.
pub(crate) fn role_of(first: &Line<'_>) -> Option<Role> {
    let is = |names: &[&str]| first.is_header_of(names);
    let pedestrians =
        || (is(&PEDESTRIAN_NAMES) || is(&PEDESTRIAN_POSITIONS_NAMES)).then_some(Role::Pedestrians);
    is(&VEHICLE_NAMES).then_some(Role::Vehicles).or_else(pedestrians)
}

/// Reads both layouts. If the first line is of neither, the error shows the published one.
fn read_pedestrians<'a>(input: &'a Input, rows: &mut Rows<'a>) -> Result<(), ReadError> {
    let first = text::lines(input).next().transpose()?;
    match first.is_some_and(|line| line.is_header_of(&PEDESTRIAN_POSITIONS_NAMES)) {
        true => read(input, &PEDESTRIAN_POSITIONS_NAMES, pedestrian_at_position, rows),
        false => read(input, &PEDESTRIAN_NAMES, pedestrian, rows),
    }
}

fn read<'a, const N: usize>(
    input: &'a Input,
    names: &[&'static str; N],
    row: fn([Field<'a>; N]) -> ReadRow,
    rows: &mut Rows<'a>,
) -> Result<(), ReadError> {
    rows.read(text::lines_below(input, names), Separator::Comma, names, row)
}

fn vehicle(fields: [Field<'_>; 11]) -> ReadRow {
    let [id, frame, stamp, kind, x, y, vx, vy, psi, length, width] = fields;
    if kind.text != "car" {
        return Err(kind.error("expected car"));
    }
    frame.frame()?;
    let heading_rad = psi.angle_rad()?;
    let [vx_mps, vy_mps] = [vx.speed_mps()?, vy.speed_mps()?];
    let detection = Detection {
        heading_rad,
        speed_mps: vx.speed_of(vx_mps * heading_rad.cos() + vy_mps * heading_rad.sin())?,
        length_m: length.extent_m()?,
        width_m: width.extent_m()?,
        flags: detection_flags::HAS_ID
            | detection_flags::HAS_HEADING
            | detection_flags::HAS_SPEED
            | detection_flags::HAS_SIZE,
        ..rows::identified(AgentType::Vehicle, text::position_m([x, y])?, id.id_below(PEDESTRIAN_IDS)?)
    };
    Ok((stamp_ns(stamp)?, detection))
}

fn pedestrian([id, frame, stamp, kind, x, y, vx, vy]: [Field<'_>; 8]) -> ReadRow {
    let (stamp_ns, detection) = pedestrian_at_position([id, frame, stamp, kind, x, y])?;
    Ok((stamp_ns, rows::with_velocity(detection, vx, vy)?))
}

fn pedestrian_at_position([id, frame, stamp, kind, x, y]: [Field<'_>; 6]) -> ReadRow {
    if kind.text != "pedestrian/bicycle" {
        return Err(kind.error("expected pedestrian/bicycle"));
    }
    frame.frame()?;
    let digits = id.text.strip_prefix('P').filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()));
    let number: Option<u64> = digits.and_then(|digits| digits.parse().ok());
    let number = number
        .filter(|&number| number < PEDESTRIAN_IDS)
        .ok_or_else(|| id.error("expected P and a number"))?;
    let position_m = text::position_m([x, y])?;
    Ok((stamp_ns(stamp)?, rows::identified(AgentType::Pedestrian, position_m, PEDESTRIAN_IDS + number)))
}

fn stamp_ns(field: Field<'_>) -> Result<i64, ReadError> {
    let stamp_ms = field.integer()?;
    if (0..=STAMP_MAX_MS).contains(&stamp_ms) {
        return Ok(stamp_ms * 1_000_000);
    }
    Err(field.error(format!("expected 0 to {STAMP_MAX_MS}")))
}

/// Whether a row is from the file of pedestrians and cyclists.
fn is_pedestrian(detection: &Detection) -> bool {
    detection.id >= PEDESTRIAN_IDS
}

/// The interval of the file of pedestrians and cyclists: 0.4 s if most of its stamps are whole multiples of
/// that.
fn pedestrian_interval_ns(rows: &[Row<'_>]) -> u64 {
    let stamps_ns = || rows.iter().filter(|row| is_pedestrian(&row.detection)).map(|row| row.stamp_ns);
    let multiple_count = stamps_ns().filter(|stamp_ns| stamp_ns % THINNED_INTERVAL_NS as i64 == 0).count();
    let is_thinned = 2 * multiple_count >= stamps_ns().count();
    if is_thinned { THINNED_INTERVAL_NS } else { INTERVAL_NS }
}

/// Whether a frame observed pedestrians and cyclists: at the ticks of their clock, and if the frame has one
/// of them.
fn observes_pedestrians(frame: &Frame, interval_ns: u64) -> bool {
    frame.stamp_ns % interval_ns as i64 == 0 || frame.detections.iter().any(is_pedestrian)
}

/// Sets the type of agents that ride to cyclist. `rows` are in time order.
fn classify_cyclists(rows: &mut [Row<'_>]) {
    let mut speeds: BTreeMap<u64, RunningSpeed> = BTreeMap::new();
    for row in rows.iter_mut().filter(|row| is_pedestrian(&row.detection)) {
        let running = speeds.entry(row.detection.id).or_default();
        running.observe(row.stamp_ns, &row.detection);
        if running.is_cyclist {
            row.detection.agent_type = AgentType::Cyclist as u32;
        }
    }
}

/// The speeds of an agent so far.
#[derive(Default)]
struct RunningSpeed {
    first_ns: Option<i64>,
    last: Option<(i64, [f32; 2])>,
    is_cyclist: bool,
    /// The slower half of the speeds, plus one if their number is odd. They are stored as bits, which have
    /// the same order as the speeds.
    slower: BinaryHeap<u32>,
    /// The faster half of the speeds.
    faster: BinaryHeap<Reverse<u32>>,
}

impl RunningSpeed {
    fn observe(&mut self, stamp_ns: i64, detection: &Detection) {
        let position_m = [detection.x_m, detection.y_m];
        let last = self.last.replace((stamp_ns, position_m));
        let first_ns = *self.first_ns.get_or_insert(stamp_ns);
        if self.is_cyclist {
            return;
        }
        let difference_mps = last.map(|(last_ns, last_m)| {
            let dt_s = ((stamp_ns - last_ns) as f64 * 1e-9) as f32;
            (position_m[0] - last_m[0]).hypot(position_m[1] - last_m[1]) / dt_s
        });
        let given_mps = detection.has(detection_flags::HAS_SPEED).then_some(detection.speed_mps);
        if let Some(speed_mps) = given_mps.or(difference_mps) {
            self.insert(speed_mps);
        }
        let speed_count = self.slower.len() + self.faster.len();
        let enough = speed_count >= CYCLIST_SPEEDS_MIN && stamp_ns - first_ns >= CYCLIST_SPAN_NS;
        self.is_cyclist = enough && self.median_mps() > CYCLIST_SPEED_MPS;
    }

    fn insert(&mut self, speed_mps: f32) {
        self.slower.push(speed_mps.to_bits());
        if let Some(fastest) = self.slower.pop() {
            self.faster.push(Reverse(fastest));
        }
        if self.faster.len() > self.slower.len()
            && let Some(Reverse(slowest)) = self.faster.pop()
        {
            self.slower.push(slowest);
        }
    }

    /// The median so far; the lower one if there are two.
    fn median_mps(&self) -> f32 {
        self.slower.peek().map_or(0.0, |&bits| f32::from_bits(bits))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether an agent counts as a cyclist after each row. A row's speed is the speed since the previous
    /// row.
    fn classified(interval_ms: i64, speeds_mps: &[f32], has_speed: bool) -> Vec<bool> {
        let mut running = RunningSpeed::default();
        let mut x_m = 0.0;
        let rows = speeds_mps.iter().enumerate();
        rows.map(|(step, &speed_mps)| {
            x_m += speed_mps * interval_ms as f32 * 1e-3;
            let mut detection = rows::identified(AgentType::Pedestrian, [x_m, 0.0], PEDESTRIAN_IDS);
            if has_speed {
                detection.speed_mps = speed_mps;
                detection.flags |= detection_flags::HAS_SPEED;
            }
            running.observe(step as i64 * interval_ms * 1_000_000, &detection);
            running.is_cyclist
        })
        .collect()
    }

    #[test]
    fn cyclist_from_running_median_of_differences_and_for_good() {
        let is_cyclist = classified(400, &[0.0, 1.0, 4.0, 4.0, 4.0, 0.0, 0.0], false);
        assert_eq!(is_cyclist, [false, false, false, true, true, true, true]);
    }

    #[test]
    fn cyclist_from_given_speeds_after_as_long_a_time() {
        let is_cyclist = classified(100, &[4.0; 14], true);
        assert_eq!(is_cyclist.iter().position(|&is_cyclist| is_cyclist), Some(12));
        let sprint = [vec![4.0; 6], vec![1.0; 12]].concat();
        assert!(!classified(100, &sprint, true).contains(&true), "the median of the first 1.2 s is 1 m/s");
    }
}
