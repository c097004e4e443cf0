//! `PredictedObjects` of a bag: the forecasts of another system.

use std::path::Path;

use interop::messages::{PredictedObject, PredictedObjects, TfMessage};
use nalgebra::Isometry3;
use recording::{BagMessage, bag_messages};
use wire::{AgentType, WorldOrigin};

use super::objects::{agent_type, class};
use super::transforms::bare;
use super::transforms::{self, Transforms};
use super::{Place, Problem, add_transforms, decode, stamp_ns, usual};
use crate::open::read;
use crate::{ReadError, Role};

/// The topic that is read if several have predicted objects.
const USUAL: [&str; 1] = ["/perception/object_recognition/objects"];
const NAME: &str = PredictedObjects::DEFINITION.name;

/// The forecasts of a message, in the order of the bag.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PredictedFrame {
    /// Stamp of the message's header.
    pub stamp_ns: i64,
    /// Its vehicles, cyclists and pedestrians.
    pub objects: Vec<PredictedAgent>,
    /// Number of objects of other classes.
    pub other_len: usize,
}

/// The forecast of an object.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedAgent {
    /// Type of its most probable class.
    pub agent_type: AgentType,
    /// Position at the stamp.
    pub position_m: [f32; 2],
    /// Paths, in the order of the message.
    pub paths: Vec<PredictedPath>,
}

/// A path that an object may take.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedPath {
    /// Time between two points. The first point is at the stamp.
    pub step_ns: i64,
    /// Confidence of the other system.
    pub confidence: f32,
    /// Positions.
    pub points_m: Vec<[f32; 2]>,
}

/// Reads the `PredictedObjects` of a bag, in the root of its frames less `origin`.
///
/// # Errors
/// [`ReadError::File`] with the message's number if the bag has none, or a value can't be used.
pub fn predicted_objects(path: &Path, origin: WorldOrigin) -> Result<Vec<PredictedFrame>, ReadError> {
    let input = read(path, Role::Rows)?;
    let failed = |problem: Problem| problem.of(&[&input]);
    let (mut messages, mut transforms) = (Vec::new(), Transforms::default());
    let each = bag_messages(&input.bytes, |message: BagMessage<'_>| -> Result<(), Problem> {
        if message.schema == TfMessage::DEFINITION.name {
            add_transforms(0, &message, &mut transforms)?;
        } else if message.schema == NAME {
            let found: PredictedObjects = decode(0, &message)?;
            messages.push((message.number, message.topic.to_owned(), found));
        }
        Ok(())
    });
    each.map_err(failed)?;
    if messages.is_empty() {
        return Err(failed(format!("has no {NAME}").into()));
    }
    let mut topics: Vec<String> = messages.iter().map(|(_, topic, _)| topic.clone()).collect();
    let topic = usual(topics.clone(), &USUAL);
    topics.sort();
    topics.dedup();
    if topic.is_none() && topics.len() > 1 {
        let topics = topics.join(", ");
        return Err(failed(
            format!("objects on several topics: {topics}; keep one of them, as with `mcap filter`").into(),
        ));
    }
    messages.retain(|(_, of, _)| topic.is_none_or(|topic| of == topic));
    let frames = messages.iter().map(|(_, _, message)| bare(&message.header.frame_id));
    let first = messages.first().map(|(number, ..)| Place { part: 0, number: *number });
    let world = transforms.world(frames).map_err(|problem| failed(Problem(first, problem)))?;
    let frames = messages.iter().map(|(number, _, message)| {
        let place = Some(Place { part: 0, number: *number });
        frame(message, &transforms, world, origin).map_err(|problem| failed(Problem(place, problem)))
    });
    frames.collect()
}

fn frame(
    message: &PredictedObjects,
    transforms: &Transforms,
    world: &str,
    origin: WorldOrigin,
) -> Result<PredictedFrame, String> {
    let stamp_ns = stamp_ns(&message.header.stamp);
    let world_from_frame = transforms.to_world(bare(&message.header.frame_id), world, stamp_ns)?;
    let mut frame = PredictedFrame { stamp_ns, ..PredictedFrame::default() };
    for object in &message.objects {
        match agent_type(class(&object.classification)) {
            Some(agent_type) => frame.objects.push(agent(object, agent_type, &world_from_frame, origin)?),
            None => frame.other_len += 1,
        }
    }
    Ok(frame)
}

fn agent(
    object: &PredictedObject,
    agent_type: AgentType,
    world_from_frame: &Isometry3<f64>,
    origin: WorldOrigin,
) -> Result<PredictedAgent, String> {
    let point = |pose: &_| {
        let position = (world_from_frame * transforms::pose(pose)).translation.vector;
        let (x_m, y_m) = (position.x, position.y);
        let place = origin.world_m([x_m, y_m]).filter(|place| place.iter().all(|value| value.is_finite()));
        place.ok_or_else(|| {
            format!("a position of {x_m}, {y_m}: not finite, or too far from the origin (--origin)")
        })
    };
    let kinematics = &object.kinematics;
    let paths = kinematics.predicted_paths.iter().map(|path| {
        let step_ns = i64::from(path.time_step.sec) * 1_000_000_000 + i64::from(path.time_step.nanosec);
        if step_ns <= 0 {
            return Err(format!("a time_step of {step_ns} ns"));
        }
        let points_m = path.path.iter().map(point).collect::<Result<_, _>>()?;
        Ok(PredictedPath { step_ns, confidence: path.confidence, points_m })
    });
    Ok(PredictedAgent {
        agent_type,
        position_m: point(&kinematics.initial_pose_with_covariance.pose)?,
        paths: paths.collect::<Result<_, _>>()?,
    })
}

impl PredictedPath {
    /// The position a time after the stamp, between two points if need be; `None` after the last point.
    #[must_use]
    pub fn at(&self, after_ns: i64) -> Option<[f32; 2]> {
        let place = usize::try_from(after_ns / self.step_ns).ok()?;
        let from = *self.points_m.get(place)?;
        let rest_ns = after_ns % self.step_ns;
        if rest_ns == 0 {
            return Some(from);
        }
        let to = self.points_m.get(place + 1)?;
        let share = rest_ns as f32 / self.step_ns as f32;
        Some([0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis])))
    }

    /// Time of the last point after the stamp.
    #[must_use]
    pub fn duration_ns(&self) -> i64 {
        self.step_ns.saturating_mul(self.points_m.len() as i64 - 1).max(0)
    }
}
