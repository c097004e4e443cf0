//! INTERACTION: vehicles at 10 Hz and, where there is such a file, pedestrians and cyclists at 2.5 Hz on the same clock.
//!
//! `track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width` for vehicles,
//! `track_id,frame_id,timestamp_ms,agent_type,x,y` with ids `P1`, `P2`, … for the others; metres. `P7` comes out as
//! 1,000,000,007. The data know one class `pedestrian/bicycle`: an agent counts as a pedestrian until the running
//! median of its speeds (at least three of them) exceeds 2.5 m/s, and as a cyclist from then on, so that the class
//! at a time depends on nothing later. The 2.5 Hz clock ticks at whole multiples of 0.4 s; frames in between that have
//! no pedestrian or cyclist observed vehicles only.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use wire::{AgentType, Detection, detection_flags};

use crate::input::{find, need_any};
use crate::rows::{self, PEDESTRIAN_IDS, Row, Rows};
use crate::text::{self, Field, Line, Separator};
use crate::{Frame, Input, ReadError, Recording, Role};

/// First line of a vehicle file.
pub(crate) const VEHICLE_HEADER: &str =
    "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width";
/// First line of a file of pedestrians and cyclists.
pub(crate) const PEDESTRIAN_HEADER: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y";
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
const PEDESTRIAN_NAMES: [&str; 6] = ["track_id", "frame_id", "timestamp_ms", "agent_type", "x", "y"];
/// Interval between frames of vehicles.
const VEHICLE_INTERVAL_NS: u64 = 100_000_000;
/// Interval between frames of pedestrians and cyclists.
const PEDESTRIAN_INTERVAL_NS: u64 = 400_000_000;
/// Median speed above which someone is riding.
const CYCLIST_SPEED_MPS: f32 = 2.5;
/// Speeds without which there is no telling.
const CYCLIST_SPEEDS_MIN: usize = 3;
/// Latest time of a row: about 30 years.
const STAMP_MAX_MS: i64 = 1_000_000_000_000;

/// The stamp and content of a row.
type ReadRow = Result<(i64, Detection), ReadError>;

/// Reads vehicles, pedestrians and cyclists, or both together.
///
/// # Errors
/// [`ReadError`] with file, line, column and value.
pub fn parse(inputs: &[Input]) -> Result<Recording, ReadError> {
    let first = need_any(inputs, &[Role::Vehicles, Role::Pedestrians])?;
    let mut rows = Rows::default();
    let vehicles = find(inputs, Role::Vehicles);
    let pedestrians = find(inputs, Role::Pedestrians);
    if let Some(input) = vehicles {
        read(input, VEHICLE_HEADER, &VEHICLE_NAMES, vehicle, &mut rows)?;
    }
    if let Some(input) = pedestrians {
        read(input, PEDESTRIAN_HEADER, &PEDESTRIAN_NAMES, pedestrian, &mut rows)?;
    }
    let mut rows = rows.sorted(first)?;
    tell_cyclists(&mut rows);
    let observed = if vehicles.is_some() { AgentType::Vehicle.bit() } else { 0 };
    let mut frames = rows::frames(&rows, observed);
    for frame in frames.iter_mut().filter(|frame| pedestrians.is_some() && sees_pedestrians(frame)) {
        frame.observed_types |= AgentType::Pedestrian.bit() | AgentType::Cyclist.bit();
    }
    let interval_ns = if vehicles.is_some() { VEHICLE_INTERVAL_NS } else { PEDESTRIAN_INTERVAL_NS };
    Ok(Recording { interval_ns, has_identities: true, frames, ..Recording::default() })
}

/// Which of the pair a file is, by its first line.
pub(crate) fn role_of(first: &Line<'_>) -> Option<Role> {
    match first.text.trim() {
        VEHICLE_HEADER => Some(Role::Vehicles),
        PEDESTRIAN_HEADER => Some(Role::Pedestrians),
        _ => None,
    }
}

fn read<'a, const N: usize>(
    input: &'a Input,
    header: &'static str,
    names: &[&'static str; N],
    row: fn([Field<'a>; N]) -> ReadRow,
    rows: &mut Rows<'a>,
) -> Result<(), ReadError> {
    for line in text::lines_below(input, header) {
        let line = line?;
        let (stamp_ns, detection) = row(line.split(Separator::Comma, names)?)?;
        rows.push(&line, stamp_ns, detection)?;
    }
    Ok(())
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
        ..rows::identified(
            AgentType::Vehicle,
            [x.position_m()?, y.position_m()?],
            id.id_below(PEDESTRIAN_IDS)?,
        )
    };
    Ok((stamp_ns(stamp)?, detection))
}

fn pedestrian([id, frame, stamp, kind, x, y]: [Field<'_>; 6]) -> ReadRow {
    if kind.text != "pedestrian/bicycle" {
        return Err(kind.error("expected pedestrian/bicycle"));
    }
    frame.frame()?;
    let digits = id.text.strip_prefix('P').filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()));
    let number: Option<u64> = digits.and_then(|digits| digits.parse().ok());
    let number = number
        .filter(|&number| number < PEDESTRIAN_IDS)
        .ok_or_else(|| id.error("expected P and a number"))?;
    let position_m = [x.position_m()?, y.position_m()?];
    Ok((stamp_ns(stamp)?, rows::identified(AgentType::Pedestrian, position_m, PEDESTRIAN_IDS + number)))
}

fn stamp_ns(field: Field<'_>) -> Result<i64, ReadError> {
    let stamp_ms = field.integer()?;
    if (0..=STAMP_MAX_MS).contains(&stamp_ms) {
        return Ok(stamp_ms * 1_000_000);
    }
    Err(field.error(format!("expected 0 to {STAMP_MAX_MS}")))
}

/// Whether pedestrians and cyclists were looked for: at the ticks of their clock, and wherever there is one of them.
fn sees_pedestrians(frame: &Frame) -> bool {
    frame.stamp_ns % PEDESTRIAN_INTERVAL_NS as i64 == 0
        || frame.detections.iter().any(|detection| detection.id >= PEDESTRIAN_IDS)
}

/// Turns those who ride into cyclists; `rows` are in time order.
fn tell_cyclists(rows: &mut [Row<'_>]) {
    let mut gaits: BTreeMap<u64, Gait> = BTreeMap::new();
    for row in rows.iter_mut().filter(|row| row.detection.id >= PEDESTRIAN_IDS) {
        let gait = gaits.entry(row.detection.id).or_default();
        gait.see(row.stamp_ns, [row.detection.x_m, row.detection.y_m]);
        if gait.rides {
            row.detection.agent_type = AgentType::Cyclist as u32;
        }
    }
}

/// How fast someone has gone so far.
#[derive(Default)]
struct Gait {
    last: Option<(i64, [f32; 2])>,
    rides: bool,
    /// The slower half of the speeds, and one more where their number is odd; as bits, which order as the speeds do.
    slower: BinaryHeap<u32>,
    /// The faster half of the speeds.
    faster: BinaryHeap<Reverse<u32>>,
}

impl Gait {
    fn see(&mut self, stamp_ns: i64, position_m: [f32; 2]) {
        if let Some((last_ns, last_m)) = self.last.replace((stamp_ns, position_m))
            && !self.rides
        {
            let dt_s = ((stamp_ns - last_ns) as f64 * 1e-9) as f32;
            self.keep((position_m[0] - last_m[0]).hypot(position_m[1] - last_m[1]) / dt_s);
            let enough = self.slower.len() + self.faster.len() >= CYCLIST_SPEEDS_MIN;
            self.rides = enough && self.median_mps() > CYCLIST_SPEED_MPS;
        }
    }

    fn keep(&mut self, speed_mps: f32) {
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

    /// The median so far, the lower of two.
    fn median_mps(&self) -> f32 {
        self.slower.peek().map_or(0.0, |&bits| f32::from_bits(bits))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rider_is_told_by_the_running_median_and_stays_one() {
        let mut gait = Gait::default();
        let mut x_m = 0.0;
        let mut rides = Vec::new();
        for (step, speed_mps) in [0.0, 1.0, 4.0, 4.0, 4.0, 0.0, 0.0].into_iter().enumerate() {
            x_m += speed_mps * 0.4;
            gait.see(step as i64 * 400_000_000, [x_m, 0.0]);
            rides.push(gait.rides);
        }
        assert_eq!(rides, [false, false, false, true, true, true, true]);
    }
}
