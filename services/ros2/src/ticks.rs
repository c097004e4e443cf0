//! Messages of ROS as ticks of a run.
//!
//! Each message is a frame of detections at its own stamp. [`LiveTicks`] makes ticks of the frames.
//!
//! A frame in another frame of reference waits until the transforms reach its stamp, at most
//! [`TRANSFORM_WAIT_NS`].

use std::fmt;

use data::formats::rosbag::{Object, Transforms};
use data::{Ego, Frame};
use interop::autoware::EGO;
use interop::messages::{Header, TfMessage, Time};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
pub use source::LiveTick as Tick;
use source::LiveTicks;
use wire::{AGENT_TYPES, Detection, WorldOrigin};

/// Longest wait of a message for the transform at its stamp.
pub const TRANSFORM_WAIT_NS: u64 = 50_000_000;
/// The time of transforms that is remembered.
const TRANSFORMS_NS: i64 = 10_000_000_000;
/// Maximum number of messages that wait.
const WAITING_MAX: usize = 64;

/// The frame of the world, and how other frames are moved into it.
#[derive(Clone, Debug)]
pub struct World {
    /// Name of the frame.
    pub frame: String,
    /// Origin of the run in the frame.
    pub origin: WorldOrigin,
    /// Pose (x, y, heading) of every other frame, instead of the transforms.
    pub pose: Option<[f64; 3]>,
}

/// A message with objects.
#[derive(Clone, Debug)]
pub struct Message {
    /// Stamp and frame.
    pub header: Header,
    /// The objects.
    pub objects: Vec<Object>,
    /// Number of the sensor; 0 if there is only one.
    pub sensor: u8,
    /// Time of arrival on `CLOCK_MONOTONIC`.
    pub arrived_ns: u64,
}

/// What became of the messages so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Messages with objects.
    pub messages: u64,
    /// Messages without a transform into the world.
    pub unplaced: u64,
    /// Messages that others pushed out of the queue.
    pub dropped: u64,
    /// Objects that are neither vehicle, cyclist nor pedestrian.
    pub other: u64,
    /// Objects with impossible values.
    pub refused: u64,
    /// Objects whose positions are NaN or infinite.
    pub not_finite: u64,
    /// Impossible values, such as a speed of NaN, that count as unknown.
    pub unknown: u64,
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { messages, unplaced, dropped, other, refused, not_finite, unknown } = self;
        write!(
            f,
            "{messages} messages: {unplaced} without a transform, {dropped} dropped; left out {other} objects of \
             other classes, {not_finite} whose positions are not numbers, and {refused} with impossible values; \
             {unknown} values count as unknown"
        )
    }
}

/// Makes ticks of messages.
#[derive(Debug)]
pub struct Ticks {
    world: World,
    transforms: Transforms,
    /// Messages that wait for a transform, oldest first.
    messages: Vec<Message>,
    frames: LiveTicks,
    counts: Counts,
    /// The newest problem that has not been taken.
    problem: Option<String>,
}

impl Ticks {
    /// No message yet.
    #[must_use]
    pub fn new(world: World) -> Self {
        Self {
            world,
            transforms: Transforms::default(),
            messages: Vec::new(),
            frames: LiveTicks::default(),
            counts: Counts::default(),
            problem: None,
        }
    }

    /// What became of the messages so far.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        Counts { dropped: self.counts.dropped + self.frames.dropped(), ..self.counts }
    }

    /// The newest problem of a message, once.
    pub const fn take_problem(&mut self) -> Option<String> {
        self.problem.take()
    }

    /// Adds transforms.
    pub fn transform(&mut self, message: &TfMessage, is_static: bool) {
        for transform in &message.transforms {
            self.transforms.add_live(transform, is_static, TRANSFORMS_NS);
        }
    }

    /// Adds a message.
    pub fn message(&mut self, message: Message) {
        self.counts.messages += 1;
        if self.messages.len() == WAITING_MAX {
            self.messages.remove(0);
            self.counts.dropped += 1;
        }
        self.messages.push(message);
    }

    /// The next tick that is due at `now_ns` on `CLOCK_MONOTONIC`.
    pub fn next(&mut self, now_ns: u64) -> Option<Tick> {
        loop {
            if let Some(tick) = self.frames.overdue(now_ns) {
                return Some(tick);
            }
            let ready = |message: &Message| {
                now_ns.saturating_sub(message.arrived_ns) >= TRANSFORM_WAIT_NS || self.is_placeable(message)
            };
            let place = self.messages.iter().position(ready)?;
            let message = self.messages.remove(place);
            let Some(frame) = self.placed(&message) else { continue };
            let restarts = self.frames.restarts();
            let tick = self.frames.add(frame, message.arrived_ns);
            if self.frames.restarts() > restarts {
                self.problem = Some("the stamps of the messages went back".to_owned());
            }
            if tick.is_some() {
                return tick;
            }
        }
    }

    /// Whether the place of a message is known as well as it will be.
    fn is_placeable(&self, message: &Message) -> bool {
        let frame = bare(&message.header.frame_id);
        frame == self.world.frame
            || self.world.pose.is_some()
            || self.transforms.reach(frame, &self.world.frame, stamp_ns(&message.header))
    }

    /// A message as a frame in the world; `None` if its place is unknown.
    fn placed(&mut self, message: &Message) -> Option<Frame> {
        let stamp_ns = stamp_ns(&message.header);
        let frame = bare(&message.header.frame_id);
        let world_from_frame = match self.world.pose {
            _ if frame == self.world.frame => Ok(Isometry3::identity()),
            Some(pose) => Ok(isometry(pose)),
            None => self.transforms.to_world(frame, &self.world.frame, stamp_ns),
        };
        let world_from_frame = match world_from_frame {
            Ok(world_from_frame) => world_from_frame,
            Err(problem) => {
                self.counts.unplaced += 1;
                self.problem = Some(problem);
                return None;
            }
        };
        let mut detections = Vec::with_capacity(message.objects.len());
        for object in &message.objects {
            let Some(placed) = object.placed(&world_from_frame) else {
                self.counts.other += 1;
                continue;
            };
            self.counts.unknown += object.impossible_values() as u64;
            match placed.detection(object.id.map(identity), self.world.origin) {
                Ok(detection) => detections.push(Detection { sensor: message.sensor, ..detection }),
                Err(problem) => {
                    let is_finite = placed.position_m.iter().all(|value| value.is_finite());
                    *(if is_finite { &mut self.counts.refused } else { &mut self.counts.not_finite }) += 1;
                    self.problem = Some(format!("an object of the frame {frame}: {problem}"));
                }
            }
        }
        detections.sort_by_key(|detection: &Detection| (detection.agent_type, detection.id));
        let observed_types = AGENT_TYPES.iter().fold(0, |bits, of| bits | of.bit());
        let ego = self.ego(stamp_ns, &detections);
        Some(Frame { stamp_ns, observed_types, ego, detections, ..Frame::default() })
    }

    /// The sensor's pose, or the scene's centre if it is unknown.
    fn ego(&self, stamp_ns: i64, detections: &[Detection]) -> Ego {
        let pose = match self.world.pose {
            Some(pose) => Some(isometry(pose)),
            None if self.transforms.has(EGO) => {
                self.transforms.to_world(EGO, &self.world.frame, stamp_ns).ok()
            }
            None => None,
        };
        let known = pose.and_then(|pose| {
            let position_m = self.world.origin.world_m([pose.translation.x, pose.translation.y])?;
            let along = pose.rotation * Vector3::x();
            Some(Ego { position_m, heading_rad: along.y.atan2(along.x) as f32, is_sensor: true })
        });
        known.unwrap_or_else(|| {
            let share = 1.0 / detections.len().max(1) as f32;
            let mean =
                |of: fn(&Detection) -> f32| detections.iter().map(|detection| of(detection) * share).sum();
            Ego { position_m: [mean(|d| d.x_m), mean(|d| d.y_m)], ..Ego::default() }
        })
    }
}

/// A stamp in nanoseconds.
fn stamp_ns(header: &Header) -> i64 {
    time_ns(&header.stamp)
}

/// A time of ROS in nanoseconds.
pub(crate) fn time_ns(time: &Time) -> i64 {
    i64::from(time.sec) * 1_000_000_000 + i64::from(time.nanosec)
}

/// A frame's name without the slash of ROS 1.
fn bare(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

fn isometry([x, y, heading_rad]: [f64; 3]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
    Isometry3::from_parts(Translation3::new(x, y, 0.0), rotation)
}

/// A number for an identity of 128 bits, the same in every process. 0 stands for no identity.
fn identity(uuid: [u8; 16]) -> u64 {
    let bits = u128::from_be_bytes(uuid);
    ((bits >> 64) as u64 ^ bits as u64).max(1)
}

#[cfg(test)]
mod tests;
