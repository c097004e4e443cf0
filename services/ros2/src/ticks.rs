//! Messages of ROS as ticks of a run.
//!
//! Each message is a frame of detections at its own stamp. A tick is the newest frame. Frames that are too
//! near to the previous tick wait:
//!
//! 1. The interval I of the messages is the mean difference of their last stamps, without gaps.
//! 2. With n = ⌈72 ms / I⌉, a frame is due if its stamp is at least n I − I / 2 after the previous tick's
//!    stamp.
//! 3. When a tick goes out, the detections of other sensors in the waiting frames are merged into it, each
//!    with its own time. The rules are those of a recording ([`source::merge`]).
//! 4. If no frame is due for 80 ms after a frame arrived, the waiting frames go out.
//!
//! A frame in another frame of reference waits until the transforms reach its stamp, at most
//! [`TRANSFORM_WAIT_NS`].

use std::fmt;

use data::formats::rosbag::{Object, Transforms};
use data::{Ego, Frame};
use interop::autoware::EGO;
use interop::messages::{Header, TfMessage};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use wire::{AGENT_TYPES, DETECTIONS_MAX, Detection, InputCounts, OFFSET_MAX_NS, TICK_NS, WorldOrigin};

/// Longest wait of a message for the transform at its stamp.
pub const TRANSFORM_WAIT_NS: u64 = 50_000_000;
/// The time of transforms that is remembered.
const TRANSFORMS_NS: i64 = 10_000_000_000;
/// Numbers of stamps from which the interval of the messages is estimated.
const STAMPS_MIN: usize = 9;
const STAMPS_MAX: usize = 32;
/// A difference of this many times the median is a gap, not an interval.
const GAP: i64 = 4;
/// The rate of the messages may exceed that of the ticks by one part in this many before messages wait.
/// Stamps of a live sensor vary, and a rate that is taken for a higher one costs every second message.
const TOLERANCE: u64 = 10;
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
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { messages, unplaced, dropped, other, refused } = self;
        write!(
            f,
            "{messages} messages: {unplaced} without a transform, {dropped} dropped; left out {other} objects of \
             other classes and {refused} with impossible values"
        )
    }
}

/// A tick for the pipeline.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// The detections.
    pub frame: Frame,
    /// The planned interval between ticks.
    pub interval_ns: u64,
    /// Detections that found no room in the frame.
    pub left_out: u32,
    /// Detections of frames that did not go out, since the start.
    pub input: InputCounts,
}

/// A frame that waits for its tick.
#[derive(Debug)]
struct Waiting {
    frame: Frame,
    arrived_ns: u64,
}

/// Makes ticks of messages.
#[derive(Debug)]
pub struct Ticks {
    world: World,
    transforms: Transforms,
    /// Messages that wait for a transform, oldest first.
    messages: Vec<Message>,
    /// Frames that wait for a tick, by stamp.
    frames: Vec<Waiting>,
    /// The newest stamps, sorted.
    stamps: Vec<i64>,
    last_ns: Option<i64>,
    input: InputCounts,
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
            frames: Vec::new(),
            stamps: Vec::new(),
            last_ns: None,
            input: InputCounts::default(),
            counts: Counts::default(),
            problem: None,
        }
    }

    /// What became of the messages so far.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        self.counts
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
            if let Some(tick) = self.overdue(now_ns) {
                return Some(tick);
            }
            let ready = |message: &Message| {
                now_ns.saturating_sub(message.arrived_ns) >= TRANSFORM_WAIT_NS || self.is_placeable(message)
            };
            let place = self.messages.iter().position(ready)?;
            let message = self.messages.remove(place);
            let Some(waiting) = self.placed(&message) else { continue };
            let stamp_ns = waiting.frame.stamp_ns;
            self.add(waiting);
            if self.is_due(stamp_ns) {
                return self.tick();
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
    fn placed(&mut self, message: &Message) -> Option<Waiting> {
        let stamp_ns = stamp_ns(&message.header);
        let frame = bare(&message.header.frame_id);
        let world_from_frame = match self.world.pose {
            _ if frame == self.world.frame => Ok(Isometry3::identity()),
            Some(pose) => Ok(isometry(pose)),
            None => self.transforms.to_root(frame, Some(&self.world.frame), stamp_ns),
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
            match placed.detection(object.id.map(identity), self.world.origin) {
                Ok(detection) => detections.push(detection),
                Err(problem) => {
                    self.counts.refused += 1;
                    self.problem = Some(format!("an object of the frame {frame}: {problem}"));
                }
            }
        }
        detections.sort_by_key(|detection: &Detection| (detection.agent_type, detection.id));
        let observed_types = AGENT_TYPES.iter().fold(0, |bits, of| bits | of.bit());
        let ego = self.ego(stamp_ns, &detections);
        let frame = Frame { stamp_ns, observed_types, ego, detections, ..Frame::default() };
        Some(Waiting { frame, arrived_ns: message.arrived_ns })
    }

    /// The sensor's pose, or the scene's centre if it is unknown.
    fn ego(&self, stamp_ns: i64, detections: &[Detection]) -> Ego {
        let pose = match self.world.pose {
            Some(pose) => Some(isometry(pose)),
            None if self.transforms.has(EGO) => {
                self.transforms.to_root(EGO, Some(&self.world.frame), stamp_ns).ok()
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

    fn add(&mut self, waiting: Waiting) {
        let stamp_ns = waiting.frame.stamp_ns;
        let restart_ns = OFFSET_MAX_NS as i64;
        if self.last_ns.is_some_and(|last_ns| stamp_ns < last_ns.saturating_sub(restart_ns)) {
            // A clock that was set back, or a bag that begins again.
            self.problem = Some("the stamps of the messages went back".to_owned());
            self.stamps.clear();
            self.frames.clear();
            self.last_ns = None;
        }
        let place = self.stamps.partition_point(|stamp| *stamp < stamp_ns);
        if self.stamps.get(place) != Some(&stamp_ns) {
            self.stamps.insert(place, stamp_ns);
        }
        if self.stamps.len() > STAMPS_MAX {
            self.stamps.remove(0);
        }
        let place = self.frames.partition_point(|other| other.frame.stamp_ns <= stamp_ns);
        self.frames.insert(place, waiting);
        if self.frames.len() > WAITING_MAX {
            self.frames.remove(0);
            self.counts.dropped += 1;
        }
    }

    /// The mean interval of the messages; that of the ticks while few are known.
    fn interval_ns(&self) -> u64 {
        if self.stamps.len() < STAMPS_MIN {
            return TICK_NS;
        }
        let mut differences: Vec<i64> = self.stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
        differences.sort_unstable();
        let Some(&median) = differences.get(differences.len() / 2) else { return TICK_NS };
        differences.retain(|difference| *difference <= median.saturating_mul(GAP));
        let mean_ns = differences.iter().sum::<i64>() / differences.len().max(1) as i64;
        u64::try_from(mean_ns).unwrap_or(TICK_NS).max(1)
    }

    /// Number of messages for each tick.
    fn thinning(&self) -> u64 {
        (TICK_NS - TICK_NS / TOLERANCE).div_ceil(self.interval_ns())
    }

    fn is_due(&self, stamp_ns: i64) -> bool {
        let Some(last_ns) = self.last_ns else { return true };
        let interval_ns = self.interval_ns();
        let apart_ns = self.thinning() * interval_ns - interval_ns / 2;
        stamp_ns.saturating_sub(last_ns) >= i64::try_from(apart_ns).unwrap_or(i64::MAX)
    }

    /// The tick of frames that have waited too long.
    fn overdue(&mut self, now_ns: u64) -> Option<Tick> {
        let oldest_ns = self.frames.iter().map(|waiting| waiting.arrived_ns).min()?;
        (now_ns.saturating_sub(oldest_ns) >= TICK_NS).then(|| self.tick())?
    }

    /// The newest frame with the others merged into it.
    fn tick(&mut self) -> Option<Tick> {
        let Waiting { mut frame, .. } = self.frames.pop()?;
        let oldest_ns = frame.stamp_ns.saturating_sub(OFFSET_MAX_NS as i64);
        let others: Vec<Frame> = self.frames.drain(..).map(|waiting| waiting.frame).collect();
        let waited: usize = others.iter().map(|other| other.detections.len()).sum();
        let others: Vec<Frame> = others.into_iter().filter(|other| other.stamp_ns >= oldest_ns).collect();
        let merged = source::merge(&others, &mut frame, self.interval_ns());
        self.input.merged = self.input.merged.wrapping_add(merged);
        self.input.unplayed = self.input.unplayed.wrapping_add(waited as u32 - merged);
        let left_out = frame.detections.len().saturating_sub(DETECTIONS_MAX) as u32;
        if left_out > 0 {
            let [x_m, y_m] = frame.ego.position_m;
            let distance_m = |d: &Detection| (d.x_m - x_m).hypot(d.y_m - y_m);
            let rank = |a: &Detection, b: &Detection| {
                b.score.total_cmp(&a.score).then(distance_m(a).total_cmp(&distance_m(b)))
            };
            frame.detections.sort_by(rank);
            frame.detections.truncate(DETECTIONS_MAX);
            frame.detections.sort_by_key(|detection| (detection.agent_type, detection.id));
        }
        self.last_ns = Some(frame.stamp_ns);
        let interval_ns = self.thinning() * self.interval_ns();
        Some(Tick { frame, interval_ns, left_out, input: self.input })
    }
}

/// A stamp in nanoseconds.
fn stamp_ns(header: &Header) -> i64 {
    i64::from(header.stamp.sec) * 1_000_000_000 + i64::from(header.stamp.nanosec)
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
