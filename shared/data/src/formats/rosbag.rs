//! rosbag2 of ROS 2 as MCAP, with Autoware's `DetectedObjects` or `TrackedObjects`, and `tf`.
//!
//! * Detections are preferred to tracks. If several topics have them, the topic of Autoware's own detections or
//!   tracks is read, or else all of them, as the live bridge merges its topics.
//! * A bag that is split into files, or a folder of rosbag2, is one recording. Files may be compressed as a whole.
//! * The stamp of an object is the stamp of its message's header.
//! * Objects are moved into `map`, or else into the root of the frames, by the transforms of `/tf` and `/tf_static`.
//!   Dynamic transforms are interpolated. A message whose transform is missing is left out. A frame that may move, or
//!   that has two parents or two senders, is a doubt.
//! * The pose of `base_link` at each message is the ego vehicle's pose.
//! * Cars, trucks, buses, trailers and motorcycles are vehicles, bicycles are cyclists. Other classes are left out
//!   and counted.
//! * The identities of tracks are numbered in their order.
//! * A value that no agent can have, such as NaN or a quaternion of zeros, is unknown. An object whose position is
//!   not a number is left out, as are messages that can't be decoded. All are counted.
//!
//! The objects become rows of [`crate::formats::csv`], which checks their values.

mod objects;
mod predicted;
mod sensors;
mod transforms;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt::Write as _;
use std::sync::Arc;

use audit::{DOUBT_SHARE, Found};
use interop::autoware::EGO;
use interop::cdr::{Cdr, from_bytes};
use interop::messages::{DetectedObjects, Header, TfMessage, Time, TrackedObjects};
use nalgebra::Isometry3;
use recording::{BagMessage, Damage, bag_messages};
use wire::{POSITION_MAX_M, WorldOrigin};

use self::objects::heading_rad;
pub use self::objects::{Object, Placed};
pub use self::predicted::{PredictedAgent, PredictedFrame, PredictedPath, predicted_objects};
pub use self::sensors::sensor_of;
pub use self::transforms::Transforms;
use self::transforms::bare;
use crate::damage::{cut_finding, damage_finding, doubt};
use crate::formats::csv;
use crate::input::need;
use crate::recording::LeftOut;
use crate::{BagTopic, Input, ReadError, Recording, Role};

/// Topics that are read if several have objects.
const USUAL: [&str; 3] = [
    "/perception/object_recognition/detection/objects",
    "/perception/object_recognition/tracking/objects",
    "/perception/object_recognition/detection/detection_by_tracker/objects",
];
/// Schemas of objects, the preferred one first.
const OBJECTS: [&str; 2] = [DetectedObjects::DEFINITION.name, TrackedObjects::DEFINITION.name];

/// Reason of [`LeftOut`] for values that are unknown.
const IMPOSSIBLE: &str =
    "with headings, speeds, sizes, scores or deviations that are NaN or impossible and count as unknown";

/// Smallest number of objects' messages with a stamp of 0 that is a fault. A simulated clock begins at 0.
const ZERO_STAMPS_MIN: usize = 2;

/// A message of a bag: the part of the bag, and the place among all messages of the part, from 1.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    part: usize,
    number: usize,
}

/// A message with objects.
struct Message {
    place: Place,
    /// When it was recorded, in Unix time.
    log_ns: u64,
    topic: Arc<str>,
    header: Header,
    objects: Vec<Object>,
}

/// A problem of the bag, or of one message.
struct Problem(Option<Place>, String);

impl From<String> for Problem {
    fn from(problem: String) -> Self {
        Self(None, problem)
    }
}

impl Problem {
    fn of(self, parts: &[&Input]) -> ReadError {
        let Self(place, problem) = self;
        let path = parts.get(place.unwrap_or_default().part).map_or("", |input| &input.path);
        let problem =
            place.map_or(problem.clone(), |Place { number, .. }| format!("message {number}: {problem}"));
        ReadError::file(path, problem)
    }
}

/// Reads a bag. Its parts are in order.
pub(crate) fn parse(inputs: &[Input]) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    let parts: Vec<&Input> = inputs.iter().filter(|input| input.role == Role::Rows).collect();
    let failed = |problem: Problem| problem.of(&parts);
    let Bag { mut messages, transforms, damage, undecoded, ignored, topics, sensors } =
        read(&parts, &input.topics).map_err(failed)?;
    let zero_stamps = replace_zero_stamps(&mut messages);
    let mut frames: Vec<&str> = messages.iter().map(|message| bare(&message.header.frame_id)).collect();
    let first = messages.first().map(|message| message.place);
    let world =
        transforms.world(frames.iter().copied()).map_err(|problem| failed(Problem(first, problem)))?;
    let mut table = Table::new(input.origin, sensors);
    for message in &messages {
        table.add(message, &transforms, world);
    }
    let Table { text, places, other, impossible, unplaced, repeated, far, lost, .. } = table;
    let row_count = places.len() - 1;
    if row_count == 0
        && let Some((_, problem)) = lost
    {
        return Err(failed(problem));
    }
    if let Some((far_count, problem)) = &far
        && 2 * far_count > row_count
    {
        return Err(failed(Problem(problem.0, problem.1.clone())));
    }
    let rows = Input { bytes: text.into_bytes(), ..input.clone() };
    let mut recording = csv::parse(&[rows]).map_err(|error| in_message(error, &parts, &places))?;
    let paths: Vec<Arc<str>> = parts.iter().map(|part| part.path.as_str().into()).collect();
    for frame in &mut recording.frames {
        for mut line in frame.lines.take() {
            let Place { part, number } = place_of(&places, line.line);
            (line.path, line.line) = (Arc::clone(&paths[part]), number);
            frame.lines.push(line);
        }
    }
    recording.topics = topics;
    recording.findings.extend(zero_stamps);
    for (part, Damage { cut, chunks }) in damage {
        let cut = cut.map(|at| cut_finding(parts[part], at, &recording));
        recording.findings.extend(cut.into_iter().chain(damage_finding(parts[part], &chunks)));
    }
    if let Some((of_message, Problem(place, problem))) = lost {
        let (rows, of) = (of_message, messages.len() as u64);
        let share = rows as f64 / of as f64;
        let Place { part, number } = place.unwrap_or_default();
        recording.findings.push(Found {
            kind: "transform_is_missing".to_owned(),
            sentence: format!("{problem}: {rows} of {of} messages with objects are left out"),
            first: Some(format!("{}:{number}", paths[part])),
            doubtful: share > DOUBT_SHARE,
            ..Found::default()
        });
    }
    frames.push(EGO);
    frames.sort_unstable();
    frames.dedup();
    let ambiguities = transforms.ambiguities(&frames, world).into_iter();
    recording.findings.extend(
        ambiguities
            .map(|(sentence, doubtful)| Found { doubtful, ..doubt("transforms_are_ambiguous", sentence) }),
    );
    recording.findings.extend(ignored);
    let counts = [
        (other, "objects of a class that is neither vehicle, cyclist nor pedestrian"),
        (unplaced, "objects whose position is not a number"),
        (far.map_or(0, |(count, _)| count), "objects too far from the origin"),
        (repeated, "objects whose identity is in a message of the same stamp already"),
        (undecoded, "messages that can't be decoded"),
        (impossible, IMPOSSIBLE),
    ];
    for (row_count, reason) in counts.into_iter().filter(|(count, _)| *count > 0) {
        recording.left_out.push(LeftOut { reason: reason.to_owned(), row_count });
    }
    Ok(recording)
}

/// Replaces stamps of 0 by the times at which the messages were recorded, and returns the doubt about them.
fn replace_zero_stamps(messages: &mut [Message]) -> Option<Found> {
    let is_zero = |message: &&mut Message| stamp_ns(&message.header.stamp) == 0 && message.log_ns > 0;
    let of = messages.len();
    let zeros: Vec<&mut Message> = messages.iter_mut().filter(is_zero).collect();
    let rows = zeros.len();
    if rows < ZERO_STAMPS_MIN {
        return None;
    }
    for message in zeros {
        let [sec, nanosec] = [message.log_ns / 1_000_000_000, message.log_ns % 1_000_000_000];
        message.header.stamp = Time { sec: i32::try_from(sec).unwrap_or(i32::MAX), nanosec: nanosec as u32 };
    }
    let sentence = format!(
        "the stamps in {rows} of {of} headers are 0: the times at which the messages were recorded are used"
    );
    Some(doubt("stamps_are_zero", sentence))
}

/// The content of a bag.
struct Bag {
    /// Messages of the topics that are played.
    messages: Vec<Message>,
    transforms: Transforms,
    /// The damage of each part.
    damage: Vec<(usize, Damage)>,
    /// Messages that can't be decoded.
    undecoded: usize,
    /// The note about topics with objects that are not played, or that are merged.
    ignored: Option<Found>,
    /// All topics.
    topics: Vec<BagTopic>,
    /// The topics that are played, in the order of their sensors' numbers; none if there is only one.
    sensors: Vec<Arc<str>>,
}

/// Reads the parts of a bag, and the objects of the `chosen` topics.
fn read(parts: &[&Input], chosen: &[String]) -> Result<Bag, Problem> {
    let (mut messages, mut transforms) = (Vec::new(), Transforms::default());
    let mut all: BTreeMap<(String, String), usize> = BTreeMap::new();
    let mut topics: BTreeMap<(usize, Arc<str>), usize> = BTreeMap::new();
    let (mut damage, mut undecoded, mut first_problem) = (Vec::new(), 0, None);
    for (part, input) in parts.iter().enumerate() {
        let damaged = bag_messages(&input.bytes, |message: BagMessage<'_>| -> Result<(), Problem> {
            *all.entry((message.topic.to_owned(), message.schema.to_owned())).or_default() += 1;
            let decoded = if message.schema == TfMessage::DEFINITION.name {
                add_transforms(part, &message, &mut transforms).map(|()| None)
            } else {
                objects(part, &message)
            };
            match decoded {
                Ok(Some((kind, message))) => {
                    *topics.entry((kind, Arc::clone(&message.topic))).or_default() += 1;
                    messages.push((kind, message));
                }
                Ok(None) => {}
                Err(problem) => {
                    undecoded += 1;
                    first_problem.get_or_insert(problem);
                }
            }
            Ok(())
        });
        let damaged =
            damaged.map_err(|Problem(_, problem)| Problem(Some(Place { part, number: 0 }), problem))?;
        damage.push((part, damaged));
    }
    if let Some(missing) = chosen.iter().find(|name| !topics.keys().any(|(_, topic)| topic[..] == name[..])) {
        let mut known: Vec<&str> = topics.keys().map(|(_, topic)| &topic[..]).collect();
        known.dedup();
        return Err(format!(
            "has no objects on the topic {missing}; it has objects on: {}",
            known.join(", ")
        )
        .into());
    }
    let Some(kind) = messages.iter().map(|(kind, _)| *kind).min() else {
        if let Some(problem) = first_problem {
            return Err(problem);
        }
        let mut schemas: Vec<&str> = all.keys().map(|(_, schema)| schema.as_str()).collect();
        schemas.sort_unstable();
        schemas.dedup();
        let found = if schemas.is_empty() { "no message".to_owned() } else { schemas.join(", ") };
        return Err(format!("needs {} or {}, and has {found}; a recording of a run is passed through the stages by `stgdat replay`", OBJECTS[0], OBJECTS[1]).into());
    };
    let names = topics.keys().filter(|(of, _)| *of == kind).map(|(_, topic)| topic.to_string()).collect();
    let usual = usual(names, &USUAL);
    let is_played = |of: usize, topic: &str| match chosen {
        [] => of == kind && usual.is_none_or(|usual| topic == usual),
        chosen => chosen.iter().any(|chosen| chosen == topic),
    };
    let ignored = ignored(&topics, is_played);
    let sensors = sensors::sensors(&topics, chosen, is_played);
    messages.retain(|(of, message)| is_played(*of, &message.topic));
    let messages = messages.into_iter().map(|(_, message)| message).collect();
    let of_schema = |schema: &str| OBJECTS.iter().position(|of| *of == schema);
    let all = all.into_iter().map(|((name, schema), messages)| {
        let is_read = of_schema(&schema).is_some_and(|kind| is_played(kind, &name));
        BagTopic { name, schema, messages, is_read }
    });
    let mut topics: Vec<BagTopic> = all.collect();
    topics.sort_by_key(|topic| !topic.is_read);
    Ok(Bag { messages, transforms, damage, undecoded, ignored, topics, sensors })
}

/// The note about the topics with objects, if there are several.
fn ignored(
    topics: &BTreeMap<(usize, Arc<str>), usize>,
    is_played: impl Fn(usize, &str) -> bool,
) -> Option<Found> {
    let (played, ignored): (Vec<_>, Vec<_>) =
        topics.iter().partition(|((kind, topic), _)| is_played(*kind, topic));
    if played.len() + ignored.len() < 2 {
        return None;
    }
    let words = |topics: &[(&(usize, Arc<str>), &usize)]| {
        let words = topics.iter().map(|((_, topic), count)| format!("{topic} ({count} messages)"));
        words.collect::<Vec<_>>().join(", ")
    };
    let mut sentence = format!("the objects are those of {}", words(&played));
    if !ignored.is_empty() {
        sentence += &format!("; {} ignored", words(&ignored));
    }
    Some(Found { doubtful: false, ..doubt("several_topics", sentence) })
}

/// A message with objects, and its kind: its index in [`OBJECTS`]. `None` for other messages.
fn objects(part: usize, message: &BagMessage<'_>) -> Result<Option<(usize, Message)>, Problem> {
    let Some(kind) = OBJECTS.iter().position(|schema| *schema == message.schema) else { return Ok(None) };
    let (header, objects) = if kind == 0 {
        let DetectedObjects { header, objects } = decode(part, message)?;
        (header, objects.into_iter().map(Object::from).collect())
    } else {
        let TrackedObjects { header, objects } = decode(part, message)?;
        (header, objects.into_iter().map(Object::from).collect())
    };
    let place = Place { part, number: message.number };
    let (log_ns, topic) = (message.log_ns, message.topic.into());
    Ok(Some((kind, Message { place, log_ns, topic, header, objects })))
}

/// The usual topic if there are several; `None` if there is one, or no usual one.
fn usual(mut topics: Vec<String>, known: &[&'static str]) -> Option<&'static str> {
    topics.sort();
    topics.dedup();
    let usual = known.iter().find(|usual| topics.iter().any(|topic| topic == *usual));
    usual.copied().filter(|_| topics.len() > 1)
}

/// Adds the transforms of a message of `/tf` or `/tf_static`.
fn add_transforms(part: usize, message: &BagMessage<'_>, transforms: &mut Transforms) -> Result<(), Problem> {
    let is_static = message.topic.ends_with("_static");
    decode::<TfMessage>(part, message)?.transforms.iter().for_each(|found| transforms.add(found, is_static));
    Ok(())
}

fn stamp_ns(stamp: &Time) -> i64 {
    i64::from(stamp.sec) * 1_000_000_000 + i64::from(stamp.nanosec)
}

fn decode<M: Cdr>(part: usize, message: &BagMessage<'_>) -> Result<M, Problem> {
    let place = Some(Place { part, number: message.number });
    if message.encoding != "cdr" {
        return Err(Problem(place, format!("encoding \"{}\": expected cdr", message.encoding)));
    }
    from_bytes(message.data).map_err(|error| Problem(place, format!("{}: {error}", message.topic)))
}

/// The objects as rows of the project's own CSV.
struct Table {
    text: String,
    /// The topics of several sensors, in the order of their numbers.
    sensors: Vec<Arc<str>>,
    /// The message of each line.
    places: Vec<Place>,
    ids: HashMap<[u8; 16], usize>,
    /// Stamps and identities of the rows.
    known: HashSet<(i64, usize)>,
    origin: WorldOrigin,
    /// Objects of other classes.
    other: usize,
    /// Objects whose position is not a number.
    unplaced: usize,
    /// Objects whose identity has a row of this stamp already.
    repeated: usize,
    /// Values that no agent can have.
    impossible: usize,
    /// Objects beyond the world frame, and the first problem.
    far: Option<(usize, Problem)>,
    /// Messages without a transform, and the first problem.
    lost: Option<(u64, Problem)>,
    /// Stamps of the ego poses.
    egos: HashSet<i64>,
}

impl Table {
    fn new(origin: WorldOrigin, sensors: Vec<Arc<str>>) -> Self {
        let text = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m,score,sigma_m,sensor\n"
            .to_owned();
        Self {
            text,
            sensors,
            places: vec![Place::default()],
            ids: HashMap::new(),
            known: HashSet::new(),
            origin,
            other: 0,
            unplaced: 0,
            repeated: 0,
            impossible: 0,
            far: None,
            lost: None,
            egos: HashSet::new(),
        }
    }

    fn add(&mut self, message: &Message, transforms: &Transforms, world: &str) {
        let stamp_ns = stamp_ns(&message.header.stamp);
        let sign = if stamp_ns < 0 { "-" } else { "" };
        let at = stamp_ns.unsigned_abs();
        let stamp_s = format!("{sign}{}.{:09}", at / 1_000_000_000, at % 1_000_000_000);
        let world_from_frame = match transforms.to_world(bare(&message.header.frame_id), world, stamp_ns) {
            Ok(world_from_frame) => world_from_frame,
            Err(problem) => {
                self.lost.get_or_insert((0, Problem(Some(message.place), problem))).0 += 1;
                return;
            }
        };
        if let Ok(ego) = transforms.to_world(EGO, world, stamp_ns)
            && self.egos.insert(stamp_ns)
        {
            let (position, heading_rad) = (ego.translation.vector, heading_rad(&ego));
            self.row(message, &format!("{stamp_s},,ego,{},{},{heading_rad},,,,,,", position.x, position.y));
        }
        for object in &message.objects {
            self.object(message, object, &stamp_s, &world_from_frame);
        }
    }

    fn object(
        &mut self,
        message: &Message,
        object: &Object,
        stamp_s: &str,
        world_from_frame: &Isometry3<f64>,
    ) {
        let Some(placed) = object.placed(world_from_frame) else { return self.other += 1 };
        if placed.position_m.iter().any(|coordinate_m| !coordinate_m.is_finite()) {
            return self.unplaced += 1;
        }
        if self.origin.world_m(placed.position_m).is_none() {
            let [x, y] = placed.position_m;
            let origin = self.origin;
            let problem = format!(
                "an object at ({x}, {y}), beyond ±{POSITION_MAX_M} m of the origin {origin}: see --origin"
            );
            self.far.get_or_insert((0, Problem(Some(message.place), problem))).0 += 1;
            return;
        }
        let next = self.ids.len() + 1;
        let id = object.id.map(|uuid| *self.ids.entry(uuid).or_insert(next));
        if let Some(id) = id
            && !self.known.insert((stamp_ns(&message.header.stamp), id))
        {
            return self.repeated += 1;
        }
        self.impossible += object.impossible_values();
        let given = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        let [x_m, y_m] = placed.position_m;
        let [length_m, width_m] = [0, 1].map(|axis| placed.size_m.map(|size_m| size_m[axis]));
        let row = format!(
            "{stamp_s},{},{},{x_m},{y_m},{},{},{},{},{},{},{}",
            id.map_or_else(String::new, |id| id.to_string()),
            placed.agent_type.name(),
            given(placed.heading_rad),
            given(placed.speed_mps),
            given(length_m),
            given(width_m),
            placed.score,
            given(placed.sigma_m),
            sensor_of(self.sensors.iter().position(|topic| *topic == message.topic)),
        );
        self.row(message, &row);
    }

    fn row(&mut self, message: &Message, row: &str) {
        let _ = writeln!(self.text, "{row}");
        self.places.push(message.place);
    }
}

/// The message of a line, from 1.
fn place_of(places: &[Place], line: usize) -> Place {
    line.checked_sub(1).and_then(|line| places.get(line)).copied().unwrap_or_default()
}

/// An error about rows as an error about the messages that they came from.
fn in_message(error: ReadError, parts: &[&Input], places: &[Place]) -> ReadError {
    let of = |line: usize, field: &'static str, value: String, problem: String| {
        let Place { part, number: message } = place_of(places, line);
        ReadError::Message { path: parts[part].path.clone(), message, field, value, problem }
    };
    match error {
        ReadError::Value { line, field, value, problem, .. } => of(line, field, value, problem),
        ReadError::TimeGoesBack { line, stamp_s, before_s, .. } => {
            let problem = format!("time goes back, after {before_s:.3}");
            of(line, "header.stamp", format!("{stamp_s:.3}"), problem)
        }
        ReadError::Empty { path } => {
            ReadError::file(path, "its messages have no vehicle, cyclist or pedestrian")
        }
        other => other,
    }
}
