//! rosbag2 of ROS 2 as MCAP, with Autoware's `DetectedObjects` or `TrackedObjects`, and `tf`.
//!
//! * Detections are preferred to tracks. If several topics have them, the topic of Autoware's own detections or
//!   tracks is read.
//! * The stamp of an object is the stamp of its message's header.
//! * Objects are moved into the root of the frames (`map`) by the transforms of `/tf` and `/tf_static`. Dynamic
//!   transforms are interpolated.
//! * The pose of `base_link` at each message is the ego vehicle's pose.
//! * Cars, trucks, buses, trailers and motorcycles are vehicles, bicycles are cyclists. Other classes are left out
//!   and counted.
//! * The identities of tracks are numbered in their order.
//! * A value that no agent can have, such as NaN or a quaternion of zeros, is unknown. An object whose position is
//!   not a number is left out. Both are counted.
//!
//! The objects become rows of [`crate::formats::csv`], which checks their values.

mod objects;
mod predicted;
mod transforms;

use std::collections::HashMap;
use std::fmt::Write as _;

use audit::Found;
use interop::autoware::EGO;
use interop::cdr::{Cdr, from_bytes};
use interop::messages::{DetectedObjects, Header, TfMessage, Time, TrackedObjects};
use nalgebra::Isometry3;
use recording::{BagMessage, bag_messages};

use self::objects::heading_rad;
pub use self::objects::{Object, Placed};
pub use self::predicted::{PredictedAgent, PredictedFrame, PredictedPath, predicted_objects};
pub use self::transforms::Transforms;
use crate::formats::csv;
use crate::input::need;
use crate::recording::LeftOut;
use crate::{Input, ReadError, Recording, Role};

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
    "headings, speeds, sizes, scores or deviations that are NaN or impossible (they count as unknown)";

/// Smallest number of objects' messages with a stamp of 0 that is a fault. A simulated clock begins at 0.
const ZERO_STAMPS_MIN: usize = 2;

/// A message with objects.
struct Message {
    number: usize,
    /// When it was recorded, in Unix time.
    log_ns: u64,
    topic: String,
    header: Header,
    objects: Vec<Object>,
}

/// A problem of the bag, or of one message.
struct Problem(Option<usize>, String);

impl From<String> for Problem {
    fn from(problem: String) -> Self {
        Self(None, problem)
    }
}

impl Problem {
    fn of(self, path: &str) -> ReadError {
        let Self(message, problem) = self;
        let problem = message.map_or(problem.clone(), |number| format!("message {number}: {problem}"));
        ReadError::file(path, problem)
    }
}

/// Reads a bag.
pub(crate) fn parse(inputs: &[Input]) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    let failed = |problem: Problem| problem.of(&input.path);
    let Bag { mut messages, transforms, cut } = read(&input.bytes).map_err(failed)?;
    let zero_stamps = replace_zero_stamps(&mut messages);
    let mut table = Table::new();
    for message in &messages {
        table.add(message, &transforms).map_err(failed)?;
    }
    let Table { text, numbers, other, impossible, unplaced, .. } = table;
    let rows = Input { bytes: text.into_bytes(), ..input.clone() };
    let mut recording = csv::parse(&[rows]).map_err(|error| in_message(error, &numbers))?;
    for frame in &mut recording.frames {
        for mut line in frame.lines.take() {
            line.line = number_of(&numbers, line.line);
            frame.lines.push(line);
        }
    }
    recording.findings.extend(zero_stamps);
    recording.findings.extend(cut.map(|at| cut_finding(at, input.bytes.len(), &recording)));
    let counts = [
        (other, "objects of a class that is neither vehicle, cyclist nor pedestrian"),
        (unplaced, "objects whose position is not a number"),
        (impossible, IMPOSSIBLE),
    ];
    for (row_count, reason) in counts.into_iter().filter(|(count, _)| *count > 0) {
        recording.left_out.push(LeftOut { reason: reason.to_owned(), row_count });
    }
    Ok(recording)
}

/// A doubt about the file as a whole.
fn doubt(kind: &str, sentence: String) -> Found {
    Found { kind: kind.to_owned(), sentence, doubtful: true, ..Found::default() }
}

/// The doubt about a file that ends in the middle.
fn cut_finding(at: usize, len: usize, recording: &Recording) -> Found {
    let stamps_ns = || recording.frames.iter().map(|frame| frame.stamp_ns);
    let last_ns = stamps_ns().next_back().unwrap_or(0);
    let span_s = (last_ns - stamps_ns().next().unwrap_or(0)) as f64 * 1e-9;
    let last_s = last_ns as f64 * 1e-9;
    let sentence = format!(
        "the file is cut off at byte {at} of {len}: it is played up to {span_s:.3} s, stamp {last_s:.3}, and what \
         followed is missing"
    );
    doubt("cut_off", sentence)
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
    /// Messages of the topic that is played.
    messages: Vec<Message>,
    transforms: Transforms,
    /// The byte at which the file was cut off.
    cut: Option<usize>,
}

fn read(bytes: &[u8]) -> Result<Bag, Problem> {
    let (mut messages, mut transforms, mut schemas) =
        (Vec::new(), Transforms::default(), Vec::<String>::new());
    let cut = bag_messages(bytes, |message: BagMessage<'_>| -> Result<(), Problem> {
        if !schemas.iter().any(|schema| schema == message.schema) {
            schemas.push(message.schema.to_owned());
        }
        if message.schema == TfMessage::DEFINITION.name {
            add_transforms(&message, &mut transforms)?;
        } else if let Some(kind) = OBJECTS.iter().position(|schema| *schema == message.schema) {
            let (header, objects) = if kind == 0 {
                let DetectedObjects { header, objects } = decode(&message)?;
                (header, objects.into_iter().map(Object::from).collect())
            } else {
                let TrackedObjects { header, objects } = decode(&message)?;
                (header, objects.into_iter().map(Object::from).collect())
            };
            messages.push((
                kind,
                Message {
                    number: message.number,
                    log_ns: message.log_ns,
                    topic: message.topic.to_owned(),
                    header,
                    objects,
                },
            ));
        }
        Ok(())
    })?;
    let Some(kind) = messages.iter().map(|(kind, _)| *kind).min() else {
        let found = if schemas.is_empty() { "no message".to_owned() } else { schemas.join(", ") };
        return Err(format!("needs {} or {}, and has {found}; a recording of a run is passed through the stages by `stgdat replay`", OBJECTS[0], OBJECTS[1]).into());
    };
    let mut messages: Vec<Message> =
        messages.into_iter().filter(|(of, _)| *of == kind).map(|(_, message)| message).collect();
    let topics = messages.iter().map(|message| message.topic.clone()).collect();
    if let Some(usual) = usual(topics, &USUAL)? {
        messages.retain(|message| message.topic == usual);
    }
    Ok(Bag { messages, transforms, cut })
}

/// The topic to read if there are several; `None` if there is one.
fn usual(mut topics: Vec<String>, known: &[&'static str]) -> Result<Option<&'static str>, Problem> {
    topics.sort();
    topics.dedup();
    if topics.len() < 2 {
        return Ok(None);
    }
    let usual = known.iter().find(|usual| topics.iter().any(|topic| topic == *usual));
    usual.copied().map(Some).ok_or_else(|| {
        let topics = topics.join(", ");
        format!("objects on several topics: {topics}; keep one of them, as with `mcap filter`").into()
    })
}

/// Adds the transforms of a message of `/tf` or `/tf_static`.
fn add_transforms(message: &BagMessage<'_>, transforms: &mut Transforms) -> Result<(), Problem> {
    let is_static = message.topic.ends_with("_static");
    decode::<TfMessage>(message)?.transforms.iter().for_each(|found| transforms.add(found, is_static));
    Ok(())
}

/// The transform from a message's frame to the root, at its stamp.
fn to_root(header: &Header, transforms: &Transforms, stamp_ns: i64) -> Result<Isometry3<f64>, String> {
    let frame = header.frame_id.trim_start_matches('/');
    if frame == EGO && !transforms.has(EGO) {
        return Err(format!("objects in the frame {EGO}, and no transform of it in /tf"));
    }
    transforms.to_root(frame, None, stamp_ns)
}

fn stamp_ns(stamp: &Time) -> i64 {
    i64::from(stamp.sec) * 1_000_000_000 + i64::from(stamp.nanosec)
}

fn decode<M: Cdr>(message: &BagMessage<'_>) -> Result<M, Problem> {
    if message.encoding != "cdr" {
        return Err(Problem(
            Some(message.number),
            format!("encoding \"{}\": expected cdr", message.encoding),
        ));
    }
    from_bytes(message.data)
        .map_err(|error| Problem(Some(message.number), format!("{}: {error}", message.topic)))
}

/// The objects as rows of the project's own CSV.
struct Table {
    text: String,
    /// The message of each line.
    numbers: Vec<usize>,
    ids: HashMap<[u8; 16], usize>,
    /// Objects of other classes.
    other: usize,
    /// Objects whose position is not a number.
    unplaced: usize,
    /// Values that no agent can have.
    impossible: usize,
    /// Stamp of the last ego pose.
    ego_ns: Option<i64>,
}

impl Table {
    fn new() -> Self {
        let text =
            "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m,score,sigma_m\n".to_owned();
        Self {
            text,
            numbers: vec![0],
            ids: HashMap::new(),
            other: 0,
            unplaced: 0,
            impossible: 0,
            ego_ns: None,
        }
    }

    fn add(&mut self, message: &Message, transforms: &Transforms) -> Result<(), Problem> {
        let stamp_ns = stamp_ns(&message.header.stamp);
        let sign = if stamp_ns < 0 { "-" } else { "" };
        let at = stamp_ns.unsigned_abs();
        let stamp_s = format!("{sign}{}.{:09}", at / 1_000_000_000, at % 1_000_000_000);
        let of_message = |problem| Problem(Some(message.number), problem);
        let world_from_frame = to_root(&message.header, transforms, stamp_ns).map_err(of_message)?;
        if transforms.has(EGO)
            && self.ego_ns != Some(stamp_ns)
            && let Ok(ego) = transforms.to_root(EGO, None, stamp_ns)
        {
            self.ego_ns = Some(stamp_ns);
            let (position, heading_rad) = (ego.translation.vector, heading_rad(&ego));
            self.row(message, &format!("{stamp_s},,ego,{},{},{heading_rad},,,,,", position.x, position.y));
        }
        for object in &message.objects {
            self.object(message, object, &stamp_s, &world_from_frame);
        }
        Ok(())
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
        self.impossible += object.impossible_values();
        let next = self.ids.len() + 1;
        let id = object.id.map(|uuid| *self.ids.entry(uuid).or_insert(next));
        let given = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        let [x_m, y_m] = placed.position_m;
        let [length_m, width_m] = [0, 1].map(|axis| placed.size_m.map(|size_m| size_m[axis]));
        let row = format!(
            "{stamp_s},{},{},{x_m},{y_m},{},{},{},{},{},{}",
            id.map_or_else(String::new, |id| id.to_string()),
            placed.agent_type.name(),
            given(placed.heading_rad),
            given(placed.speed_mps),
            given(length_m),
            given(width_m),
            placed.score,
            given(placed.sigma_m),
        );
        self.row(message, &row);
    }

    fn row(&mut self, message: &Message, row: &str) {
        let _ = writeln!(self.text, "{row}");
        self.numbers.push(message.number);
    }
}

/// The message of a line, from 1.
fn number_of(numbers: &[usize], line: usize) -> usize {
    line.checked_sub(1).and_then(|place| numbers.get(place)).copied().unwrap_or(0)
}

/// An error about rows as an error about the messages that they came from.
fn in_message(error: ReadError, numbers: &[usize]) -> ReadError {
    match error {
        ReadError::Value { path, line, field, value, problem, .. } => {
            ReadError::Message { path, message: number_of(numbers, line), field, value, problem }
        }
        ReadError::Duplicate { path, line, id, .. } => {
            let (message, value) = (number_of(numbers, line), id.to_string());
            let problem = "the object is in a message of this stamp already".to_owned();
            ReadError::Message { path, message, field: "object_id", value, problem }
        }
        ReadError::TimeGoesBack { path, line, stamp_s, before_s, .. } => {
            let problem = format!("time goes back, after {before_s:.3}");
            let (message, value) = (number_of(numbers, line), format!("{stamp_s:.3}"));
            ReadError::Message { path, message, field: "header.stamp", value, problem }
        }
        ReadError::Empty { path } => {
            ReadError::file(path, "its messages have no vehicle, cyclist or pedestrian")
        }
        other => other,
    }
}
