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
//!
//! The objects become rows of [`crate::formats::csv`], which checks their values.

mod transforms;

use std::collections::HashMap;
use std::fmt::Write as _;

use interop::autoware::EGO;
use interop::cdr::{Cdr, from_bytes};
use interop::messages::{
    DetectedObject, DetectedObjects, Header, ObjectClassification, Pose, Shape, TfMessage, TrackedObject,
    TrackedObjects, label,
};
use nalgebra::{Isometry3, Vector3};
use recording::{BagMessage, bag_messages};
use wire::AgentType;

use self::transforms::Transforms;
use crate::formats::csv;
use crate::input::need;
use crate::recording::LeftOut;
use crate::{Input, ReadError, Recording, Role};

/// `orientation_availability` of an orientation whose sign is known.
const AVAILABLE: u8 = 2;
/// Topics that are read if several have objects.
const USUAL: [&str; 3] = [
    "/perception/object_recognition/detection/objects",
    "/perception/object_recognition/tracking/objects",
    "/perception/object_recognition/detection/detection_by_tracker/objects",
];
/// Schemas of objects, the preferred one first.
const OBJECTS: [&str; 2] = [DetectedObjects::DEFINITION.name, TrackedObjects::DEFINITION.name];

/// A message with objects.
struct Message {
    number: usize,
    topic: String,
    header: Header,
    objects: Vec<Object>,
}

/// What both kinds of objects have.
struct Object {
    id: Option<[u8; 16]>,
    score: f32,
    class: u8,
    pose: Pose,
    has_heading: bool,
    speed_mps: Option<f64>,
    sigma_m: Option<f64>,
    size_m: [f64; 2],
}

/// A problem of the bag, or of one message.
struct Problem(Option<usize>, String);

impl From<String> for Problem {
    fn from(problem: String) -> Self {
        Self(None, problem)
    }
}

/// Reads a bag.
pub(crate) fn parse(inputs: &[Input]) -> Result<Recording, ReadError> {
    let input = need(inputs, Role::Rows)?;
    let failed = |Problem(message, problem): Problem| {
        let problem = message.map_or(problem.clone(), |number| format!("message {number}: {problem}"));
        ReadError::Bag { path: input.path.clone(), problem }
    };
    let (messages, transforms) = read(&input.bytes).map_err(failed)?;
    let mut table = Table::new();
    for message in &messages {
        table.add(message, &transforms).map_err(failed)?;
    }
    let Table { text, numbers, other, .. } = table;
    let rows = Input { bytes: text.into_bytes(), ..input.clone() };
    let mut recording = csv::parse(&[rows]).map_err(|error| in_message(error, &numbers))?;
    for frame in &mut recording.frames {
        for mut line in frame.lines.take() {
            line.line = number_of(&numbers, line.line);
            frame.lines.push(line);
        }
    }
    if other > 0 {
        let reason = "objects of a class that is neither vehicle, cyclist nor pedestrian".to_owned();
        recording.left_out.push(LeftOut { reason, row_count: other });
    }
    Ok(recording)
}

/// The messages of the topic that is played, and all transforms.
fn read(bytes: &[u8]) -> Result<(Vec<Message>, Transforms), Problem> {
    let (mut messages, mut transforms, mut schemas) =
        (Vec::new(), Transforms::default(), Vec::<String>::new());
    bag_messages(bytes, |message: BagMessage<'_>| -> Result<(), Problem> {
        if !schemas.iter().any(|schema| schema == message.schema) {
            schemas.push(message.schema.to_owned());
        }
        if message.schema == TfMessage::DEFINITION.name {
            let is_static = message.topic.ends_with("_static");
            decode::<TfMessage>(&message)?
                .transforms
                .iter()
                .for_each(|found| transforms.add(found, is_static));
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
                Message { number: message.number, topic: message.topic.to_owned(), header, objects },
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
    let mut topics: Vec<String> = messages.iter().map(|message| message.topic.clone()).collect();
    topics.sort();
    topics.dedup();
    if let [_, _, ..] = &topics[..] {
        let Some(usual) = USUAL.into_iter().find(|usual| topics.iter().any(|topic| topic == usual)) else {
            return Err(format!(
                "objects on several topics: {}; keep one of them, as with `mcap filter`",
                topics.join(", ")
            )
            .into());
        };
        messages.retain(|message| message.topic == usual);
    }
    Ok((messages, transforms))
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

fn class(classification: &[ObjectClassification]) -> u8 {
    // The first of equally probable ones, as in Autoware.
    let best = classification.iter().rev().max_by(|a, b| a.probability.total_cmp(&b.probability));
    best.map_or(label::UNKNOWN, |best| best.label)
}

fn size_m(shape: &Shape) -> [f64; 2] {
    [shape.dimensions.x, shape.dimensions.y]
}

impl From<DetectedObject> for Object {
    fn from(object: DetectedObject) -> Self {
        let kinematics = object.kinematics;
        let covariance = kinematics.pose_with_covariance.covariance.0;
        let has_heading = kinematics.orientation_availability == AVAILABLE;
        Self {
            id: None,
            score: object.existence_probability,
            class: class(&object.classification),
            pose: kinematics.pose_with_covariance.pose,
            has_heading,
            speed_mps: kinematics.has_twist.then_some(kinematics.twist_with_covariance.twist.linear.x),
            sigma_m: kinematics
                .has_position_covariance
                .then(|| ((covariance[0] + covariance[7]) / 2.0).sqrt()),
            size_m: size_m(&object.shape),
        }
    }
}

impl From<TrackedObject> for Object {
    fn from(object: TrackedObject) -> Self {
        let kinematics = object.kinematics;
        Self {
            id: Some(object.object_id.uuid),
            score: object.existence_probability,
            class: class(&object.classification),
            pose: kinematics.pose_with_covariance.pose,
            has_heading: kinematics.orientation_availability == AVAILABLE,
            speed_mps: Some(kinematics.twist_with_covariance.twist.linear.x),
            // The uncertainty of a track is not the one of a measurement.
            sigma_m: None,
            size_m: size_m(&object.shape),
        }
    }
}

/// The objects as rows of the project's own CSV.
struct Table {
    text: String,
    /// The message of each line.
    numbers: Vec<usize>,
    ids: HashMap<[u8; 16], usize>,
    /// Objects of other classes.
    other: usize,
    /// Stamp of the last ego pose.
    ego_ns: Option<i64>,
}

impl Table {
    fn new() -> Self {
        let text =
            "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m,score,sigma_m\n".to_owned();
        Self { text, numbers: vec![0], ids: HashMap::new(), other: 0, ego_ns: None }
    }

    fn add(&mut self, message: &Message, transforms: &Transforms) -> Result<(), Problem> {
        let stamp = &message.header.stamp;
        let stamp_ns = i64::from(stamp.sec) * 1_000_000_000 + i64::from(stamp.nanosec);
        let sign = if stamp_ns < 0 { "-" } else { "" };
        let at = stamp_ns.unsigned_abs();
        let stamp_s = format!("{sign}{}.{:09}", at / 1_000_000_000, at % 1_000_000_000);
        let of_message = |problem| Problem(Some(message.number), problem);
        let frame = message.header.frame_id.trim_start_matches('/');
        let world_from_frame = transforms.to_root(frame, stamp_ns).map_err(of_message)?;
        if frame == EGO && !transforms.has(EGO) {
            return Err(of_message(format!("objects in the frame {EGO}, and no transform of it in /tf")));
        }
        if transforms.has(EGO)
            && self.ego_ns != Some(stamp_ns)
            && let Ok(ego) = transforms.to_root(EGO, stamp_ns)
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
        let agent_type = match object.class {
            label::CAR | label::TRUCK | label::BUS | label::TRAILER | label::MOTORCYCLE => AgentType::Vehicle,
            label::BICYCLE => AgentType::Cyclist,
            label::PEDESTRIAN => AgentType::Pedestrian,
            _ => return self.other += 1,
        };
        let next = self.ids.len() + 1;
        let id = object.id.map(|uuid| *self.ids.entry(uuid).or_insert(next));
        let pose = world_from_frame * transforms::pose(&object.pose);
        let given = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        let heading = object.has_heading.then(|| heading_rad(&pose));
        let [length_m, width_m] = object.size_m.map(Some);
        let has_size = object.size_m.iter().all(|size_m| *size_m > 0.0);
        let position = pose.translation.vector;
        let row = format!(
            "{stamp_s},{},{},{},{},{},{},{},{},{},{}",
            id.map_or_else(String::new, |id| id.to_string()),
            agent_type.name(),
            position.x,
            position.y,
            given(heading),
            // A speed is along the heading.
            given(object.speed_mps.filter(|_| object.has_heading)),
            given(length_m.filter(|_| has_size)),
            given(width_m.filter(|_| has_size)),
            object.score,
            given(object.sigma_m),
        );
        self.row(message, &row);
    }

    fn row(&mut self, message: &Message, row: &str) {
        let _ = writeln!(self.text, "{row}");
        self.numbers.push(message.number);
    }
}

/// The direction of the x axis on the ground.
fn heading_rad(pose: &Isometry3<f64>) -> f64 {
    let along = pose.rotation * Vector3::x();
    along.y.atan2(along.x)
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
            ReadError::Bag { path, problem: "its messages have no vehicle, cyclist or pedestrian".to_owned() }
        }
        other => other,
    }
}
