//! The project's own format, for users' recordings: comma-separated, with a header line.
//!
//! ```csv
//! stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m,score,sigma_m
//! 0.00,,ego,0.0,0.0,1.57,,,,,
//! 0.00,7,vehicle,12.5,-3.2,3.10,8.4,4.5,1.8,0.97,0.2
//! 0.00,8,pedestrian,4.0,2.1,,,,,,
//! 0.08,7,vehicle,11.8,-3.2,3.10,8.4,4.5,1.8,0.98,0.2
//! ```
//!
//! | column | | meaning |
//! |---|---|---|
//! | `stamp_s` | needed | time of the measurement in seconds on any clock, rounded to the nanosecond |
//! | `type` | needed | `vehicle`, `cyclist`, `pedestrian`; or `ego` or `above`, see below |
//! | `x_m`, `y_m` | needed | position within ±32,768 m in a right-handed world frame (z up) |
//! | `id` | | identity, a whole number from 0; if all rows have one, the tracker may trust them |
//! | `heading_rad` | | counter-clockwise from +x |
//! | `speed_mps` | | along the heading, negative in reverse |
//! | `length_m`, `width_m` | | extent along and across the heading; both or neither |
//! | `score` | | the detector's confidence, larger is more confident |
//! | `sigma_m` | | standard deviation of the position per axis |
//! | `sensor` | | number of the sensor, from 1 to 8; 0 if it is unknown |
//! | `vx_mps`, `vy_mps` | | velocity in the world frame |
//! | `status`, `unseen_s` | | `confirmed` or `coasting`; seconds since the agent was last detected |
//! | `xx_m2`, `xy_m2`, `yy_m2` | | covariance of the position |
//! | `prior`, `prior_age_s` | | prior of the state: `learned`, `held`, `kinematic`; age of its forecast, s |
//!
//! A row of type `ego` is the pose of a sensor whose view agents occlude. A row of type `above` is the centre
//! of a view from above, without occlusion.
//!
//! [`TrackWriter`](crate::TrackWriter) adds the columns from `vx_mps` on. The reader checks them and leaves
//! them out of the recording, so tracks can be played as detections with identities.
//!
//! Columns are separated by commas, semicolons or tabs. Names and values may be in quotes, with spaces around
//! them. The reader also accepts names in capitals, and a few other names of the same meaning and unit, such
//! as `track_id` and `yaw_rad`. Decimals have a point.
//!
//! Columns and rows can be in any order. Columns that are not needed can be missing or empty. NaN
//! counts as empty, and so does a negative size or deviation. Lines that begin with `#` are comments.
//!
//! The rows of a frame need not have equal stamps. The reader joins the detections of each sweep to a frame,
//! whose stamp is that of its newest detection. A pose of the sensor makes no frame. It is interpolated to
//! the frames' stamps. Before the first pose, the sensor's position is the mean position of the first frame's
//! detections.

use wire::{AgentType, Detection, Quality, SENSORS_MAX, detection_flags};

use crate::egos::Egos;
use crate::input::need;
use crate::recording::LeftOut;
use crate::rows::{self, Rows};
use crate::stamp::stamp_ns;
use crate::sweeps::{self, Sweeps};
use crate::text::{self, Field, Line, Separator};
use crate::{Ego, Input, ReadError, Recording, Role};

pub(crate) const NAMES: [&str; 21] = [
    "stamp_s",
    "id",
    "type",
    "x_m",
    "y_m",
    "heading_rad",
    "speed_mps",
    "length_m",
    "width_m",
    "score",
    "sigma_m",
    "sensor",
    "vx_mps",
    "vy_mps",
    "status",
    "unseen_s",
    "xx_m2",
    "xy_m2",
    "yy_m2",
    "prior",
    "prior_age_s",
];
/// Columns whose numbers cannot be negative.
const NOT_NEGATIVE: [&str; 3] = ["length_m", "width_m", "sigma_m"];
/// The values of the column `status`.
pub(crate) const STATUS: [&str; 2] = ["confirmed", "coasting"];
const STAMP: usize = 0;
const NEEDED: [usize; 4] = [STAMP, 2, 3, 4];
/// The interval of a recording with a single frame.
const INTERVAL_NS: u64 = wire::TICK_NS;

/// The content of a row: a detection, or the pose of the sensor.
enum Content {
    /// A detection, and its heading as written, not wrapped.
    Detection(Detection, f32),
    Ego(Ego),
}

/// The type of a row with the pose of a sensor.
pub(crate) const EGO: &str = "ego";
/// The type of a row with the centre of a view from above.
pub(crate) const ABOVE: &str = "above";

/// The first line of a file.
struct Header {
    separator: Separator,
    /// For each of [`NAMES`] the index of its column in the file; `None` if the file does not have the
    /// column.
    places: [Option<usize>; NAMES.len()],
}

/// Separators of columns, the usual one first.
const SEPARATORS: [Separator; 3] = [Separator::Comma, Separator::Semicolon, Separator::Tab];
/// Other names of columns, with the same meaning and unit.
const SYNONYMS: [(&str, &str); 16] = [
    ("time_s", "stamp_s"),
    ("timestamp_s", "stamp_s"),
    ("t_s", "stamp_s"),
    ("track_id", "id"),
    ("trackid", "id"),
    ("object_id", "id"),
    ("agent_id", "id"),
    ("agent_type", "type"),
    ("object_type", "type"),
    ("class", "type"),
    ("yaw_rad", "heading_rad"),
    ("psi_rad", "heading_rad"),
    ("speed_m_s", "speed_mps"),
    ("vx_m_s", "vx_mps"),
    ("vy_m_s", "vy_mps"),
    ("confidence", "score"),
];
/// Names that may mean a column but have another unit or none. The error suggests the column.
const SUGGESTED: [(&str, &[&str]); 10] = [
    (
        "stamp_s",
        &[
            "t",
            "ts",
            "time",
            "stamp",
            "timestamp",
            "timestamp_ms",
            "timestamp_ns",
            "time_ms",
            "stamp_ns",
            "sec",
        ],
    ),
    ("id", &["track", "object", "agent", "identity", "obj_id"]),
    ("type", &["label", "category", "kind", "cls"]),
    ("x_m", &["x", "pos_x", "position_x", "xcenter", "x_center", "x_px", "easting", "east_m"]),
    ("y_m", &["y", "pos_y", "position_y", "ycenter", "y_center", "y_px", "northing", "north_m"]),
    ("heading_rad", &["heading", "yaw", "psi", "theta", "heading_deg", "yaw_deg"]),
    ("speed_mps", &["speed", "velocity", "v", "speed_kmh", "speed_kph"]),
    ("length_m", &["length", "l"]),
    ("width_m", &["width", "w"]),
    ("sigma_m", &["sigma", "std", "std_m"]),
];

/// A name or a value without its quotes.
fn unquoted(text: &str) -> &str {
    text.strip_prefix('"').and_then(|rest| rest.strip_suffix('"')).map_or(text, str::trim)
}

/// The column of a name in a header.
fn column(name: &str) -> Option<usize> {
    let name = unquoted(name).to_ascii_lowercase();
    let name = SYNONYMS.iter().find(|(other, _)| *other == name).map_or(&*name, |(_, column)| column);
    NAMES.iter().position(|&known| known == name)
}

/// The column that a name with another unit, or without a unit, may mean.
fn suggestion(name: &str) -> Option<&'static str> {
    let name = unquoted(name).to_ascii_lowercase();
    SUGGESTED.iter().find(|(_, others)| others.contains(&&*name)).map(|(column, _)| *column)
}

/// Finds the column that a name means, as the header of a file is read.
///
/// # Errors
/// The column that the name may mean, with another unit or without one; `None` for any other name.
pub fn column_of(name: &str) -> Result<&'static str, Option<&'static str>> {
    column(name).map(|place| NAMES[place]).ok_or_else(|| suggestion(name))
}

/// The separator between the names of a header: the one that gives the most known columns.
fn separator(line: &Line<'_>) -> Separator {
    let known =
        |separator: &Separator| line.pieces(*separator).filter(|(_, name)| column(name).is_some()).count();
    let parts = |separator: &Separator| line.pieces(*separator).count();
    let most = SEPARATORS.into_iter().rev().max_by_key(|separator| (known(separator), parts(separator)));
    most.unwrap_or(Separator::Comma)
}

/// Whether the line is a header of this format.
pub(crate) fn is_header(line: &Line<'_>) -> bool {
    line.pieces(separator(line)).any(|(_, name)| column(name) == Some(STAMP))
}

/// Whether the line is probably meant as a header of this format: it has a time and a position under any
/// name.
pub(crate) fn is_meant_as_header(line: &Line<'_>) -> bool {
    let means = |needed: usize| {
        let is_meant = |name: &str| column(name) == Some(needed) || suggestion(name) == Some(NAMES[needed]);
        line.pieces(separator(line)).any(|(_, name)| is_meant(name))
    };
    [STAMP, 3, 4].into_iter().all(means)
}

/// Reads such a file.
pub(crate) fn parse(inputs: &[Input]) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    let mut lines = text::lines(input).filter(|line| !matches!(line, Ok(line) if line.text.starts_with('#')));
    let empty = || ReadError::Empty { path: input.path.clone() };
    let header = Header::parse(&lines.next().ok_or_else(empty)??)?;

    let mut rows = Rows::default();
    let mut egos = Egos::default();
    let mut unknown = 0;
    for line in lines {
        let line = line?;
        let fields = header.fields(&line)?;
        unknown += fields.iter().filter(|field| is_unknown(field)).count();
        let stamp_ns = stamp_ns(fields[STAMP])?;
        match content(&fields)? {
            Content::Detection(detection, heading) => {
                rows.push_written(&line, stamp_ns, detection, heading)?;
            }
            Content::Ego(ego) => egos.insert(stamp_ns, ego, line.number).map_err(|first| {
                fields[STAMP].error(format!("has an {EGO} or {ABOVE} row already, in line {first}"))
            })?,
        }
    }
    let Sweeps { frames, interval_ns, poses_missing } = sweeps::measured(&rows.sorted(input)?, &egos);
    let has_id = |detection: &Detection| detection.has(detection_flags::HAS_ID);
    let nan = LeftOut {
        reason: "with values that are NaN or impossible and count as unknown".to_owned(),
        row_count: unknown,
    };
    Ok(Recording {
        interval_ns: interval_ns.unwrap_or(INTERVAL_NS),
        has_identities: frames.iter().flat_map(|frame| &frame.detections).all(has_id),
        frames,
        own_stamps: true,
        poses_missing,
        left_out: if unknown > 0 { vec![nan] } else { Vec::new() },
        ..Recording::default()
    })
}

impl Header {
    fn parse(line: &Line<'_>) -> Result<Self, ReadError> {
        let mut places = [None; NAMES.len()];
        let separator = separator(line);
        for (place, (at, name)) in line.pieces(separator).enumerate() {
            let field = line.field("header", at, name);
            let known = column(name).ok_or_else(|| {
                let number = place + 1;
                field.error(match suggestion(name) {
                    Some(meant) => format!("column {number} is {name:?}: did you mean {meant}?"),
                    None => format!("no such column; known are {}", NAMES.join(",")),
                })
            })?;
            if places[known].replace(place).is_some() {
                return Err(field.error("stands twice"));
            }
        }
        match NEEDED.into_iter().find(|&needed| places[needed].is_none()) {
            Some(needed) => {
                Err(line.field("header", 1, line.text).error(format!("needs a column {}", NAMES[needed])))
            }
            None => Ok(Self { separator, places }),
        }
    }

    /// The values of a row by column name; empty if the file does not have the column.
    fn fields<'a>(&self, line: &Line<'a>) -> Result<[Field<'a>; NAMES.len()], ReadError> {
        let mut found = 0;
        let mut fields = NAMES.map(|name| line.field(name, 1, ""));
        for (place, (column, text)) in line.pieces(self.separator).enumerate() {
            let text = unquoted(text);
            if let Some(known) = self.places.iter().position(|&at| at == Some(place)) {
                fields[known] = line.field(NAMES[known], column, text);
                if text.contains(',') {
                    return Err(fields[known].error("a comma in a value: write decimals with a point"));
                }
            }
            found += 1;
        }
        let expected = self.places.iter().flatten().count();
        if found == expected { Ok(fields) } else { Err(line.columns_error(found, expected)) }
    }
}

fn content(fields: &[Field<'_>; NAMES.len()]) -> Result<Content, ReadError> {
    let &[_, id, kind, x, y, heading, speed, length, width, score, sigma, sensor, ref unused @ ..] = fields;
    check_unused(unused)?;
    let position_m = text::position_m([x, y])?;
    let heading_rad = given(heading, Field::angle_rad)?;
    let kind_name = kind.text.to_ascii_lowercase();
    if [EGO, ABOVE].contains(&&*kind_name) {
        let heading_rad = heading_rad.unwrap_or(0.0);
        return Ok(Content::Ego(Ego { position_m, heading_rad, is_sensor: kind_name == EGO }));
    }
    let agent_type: AgentType =
        kind_name.parse().map_err(|_| kind.error("expected vehicle, cyclist, pedestrian, ego or above"))?;
    let id = given(id, |id| id.id_below(u64::MAX))?;
    let speed_mps = given(speed, Field::speed_mps)?;
    let size = match (given(length, Field::extent_m)?, given(width, Field::extent_m)?) {
        (Some(length_m), Some(width_m)) => Some((length_m, width_m)),
        (None, None) => None,
        (Some(_), None) => return Err(width.error("stands empty beside a length_m")),
        (None, Some(_)) => return Err(length.error("stands empty beside a width_m")),
    };
    let flags = [
        (id.is_some(), detection_flags::HAS_ID),
        (heading_rad.is_some(), detection_flags::HAS_HEADING),
        (speed_mps.is_some(), detection_flags::HAS_SPEED),
        (size.is_some(), detection_flags::HAS_SIZE),
    ];
    let (length_m, width_m) = size.unwrap_or_default();
    let heading_written = given(heading, Field::number)?.unwrap_or(0.0) as f32;
    let detection = Detection {
        id: id.unwrap_or(0),
        heading_rad: heading_rad.unwrap_or(0.0),
        speed_mps: speed_mps.unwrap_or(0.0),
        length_m,
        width_m,
        score: given(score, |score| score.number_in(-1e6..=1e6))?.map_or(1.0, |score| score as f32),
        sigma_m: given(sigma, Field::extent_m)?.unwrap_or(0.0),
        sensor: given(sensor, sensor_number)?.unwrap_or(0),
        flags: flags.into_iter().filter(|(is_given, _)| *is_given).fold(0, |bits, (_, bit)| bits | bit),
        ..rows::detection(agent_type, position_m)
    };
    Ok(Content::Detection(detection, heading_written))
}

/// The number of a sensor; 0 if it is unknown.
fn sensor_number(field: &Field<'_>) -> Result<u8, ReadError> {
    let number = u8::try_from(field.integer()?).ok().filter(|number| usize::from(*number) <= SENSORS_MAX);
    number.ok_or_else(|| {
        field.error(format!("expected a sensor from 1 to {SENSORS_MAX}, or 0 if it is unknown"))
    })
}

/// Refuses values of the track columns that no [`TrackWriter`](crate::TrackWriter) writes.
fn check_unused(&[vx, vy, status, unseen, xx, xy, yy, prior, age]: &[Field<'_>; 9]) -> Result<(), ReadError> {
    for number in [vx, vy, unseen, xx, xy, yy, age] {
        given(number, Field::number)?;
    }
    for (word, known) in [(status, &STATUS[..]), (prior, &Quality::ALL.map(Quality::name))] {
        if !word.text.is_empty() && !known.contains(&word.text) {
            return Err(word.error(format!("expected {}", known.join(" or "))));
        }
    }
    Ok(())
}

/// The value of a field that may be empty.
fn given<'a, T>(
    field: Field<'a>,
    read: impl Fn(&Field<'a>) -> Result<T, ReadError>,
) -> Result<Option<T>, ReadError> {
    if field.text.is_empty() || is_unknown(&field) { Ok(None) } else { read(&field).map(Some) }
}

/// Whether a value stands for an unknown one: NaN, or the negative size or deviation that detectors write for it.
fn is_unknown(field: &Field<'_>) -> bool {
    let is_nan = field.text.trim_start_matches(['-', '+']).eq_ignore_ascii_case("nan");
    is_nan || (NOT_NEGATIVE.contains(&field.name) && field.text.parse().is_ok_and(|value: f64| value < 0.0))
}
