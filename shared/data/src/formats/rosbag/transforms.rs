//! The tree of frames of `/tf` and `/tf_static`.

use std::collections::{BTreeMap, HashMap};

use interop::messages::{Pose, TransformStamped};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use crate::egos::POSE_MAX_NS;

/// Maximum number of frames between an object and the root.
const DEPTH_MAX: usize = 64;

/// A frame's places in its parent.
#[derive(Debug, Default)]
struct Frame {
    parent: String,
    is_static: bool,
    poses: BTreeMap<i64, Isometry3<f64>>,
}

/// The transforms of `/tf` and `/tf_static` so far.
#[derive(Debug, Default)]
pub struct Transforms(HashMap<String, Frame>);

/// A pose as a transform. The rotation of a quaternion without a direction is none.
pub(super) fn pose(Pose { position: at, orientation: q }: &Pose) -> Isometry3<f64> {
    isometry([at.x, at.y, at.z], [q.x, q.y, q.z, q.w])
}

fn isometry([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-9);
    Isometry3::from_parts(Translation3::new(x, y, z), rotation.unwrap_or_else(UnitQuaternion::identity))
}

fn stamp_ns(found: &TransformStamped) -> i64 {
    i64::from(found.header.stamp.sec) * 1_000_000_000 + i64::from(found.header.stamp.nanosec)
}

/// A frame's name without the slash of ROS 1.
fn bare(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

impl Transforms {
    /// Adds a transform.
    pub fn add(&mut self, found: &TransformStamped, is_static: bool) {
        let (at, q) = (&found.transform.translation, &found.transform.rotation);
        let frame = self.0.entry(bare(&found.child_frame_id).to_owned()).or_default();
        frame.parent = bare(&found.header.frame_id).to_owned();
        frame.is_static = is_static;
        frame.poses.insert(stamp_ns(found), isometry([at.x, at.y, at.z], [q.x, q.y, q.z, q.w]));
    }

    /// Whether the frame has a place in another frame.
    #[must_use]
    pub fn has(&self, frame: &str) -> bool {
        self.0.contains_key(frame)
    }

    /// Whether the moving frames from `frame` up to `world` have a transform at a time or later. If so, later
    /// messages do not change the transform at this time.
    #[must_use]
    pub fn reach(&self, frame: &str, world: &str, stamp_ns: i64) -> bool {
        let mut name = frame;
        for _ in 0..DEPTH_MAX {
            match self.0.get(name) {
                _ if name == world => return true,
                Some(frame) if frame.is_static || frame.poses.range(stamp_ns..).next().is_some() => {
                    name = &frame.parent;
                }
                _ => return false,
            }
        }
        false
    }

    /// Adds a live transform. A moving frame keeps `keep_ns` before its newest transform. If a transform is
    /// older than that, the clock was set back, and the frame begins again.
    pub fn add_live(&mut self, found: &TransformStamped, is_static: bool, keep_ns: i64) {
        let from_ns = stamp_ns(found).saturating_sub(keep_ns);
        if let Some(frame) = self.0.get_mut(bare(&found.child_frame_id)) {
            let newest_ns = frame.poses.last_key_value().map(|(newest_ns, _)| *newest_ns);
            let went_back =
                newest_ns.is_some_and(|newest_ns| stamp_ns(found) < newest_ns.saturating_sub(keep_ns));
            frame.poses =
                if is_static || went_back { BTreeMap::new() } else { frame.poses.split_off(&from_ns) };
        }
        self.add(found, is_static);
    }

    /// The transform from a frame to `world`, at a time; to the root of its tree without `world`.
    ///
    /// # Errors
    /// The frame whose place at the time is unknown.
    pub fn to_root(&self, frame: &str, world: Option<&str>, stamp_ns: i64) -> Result<Isometry3<f64>, String> {
        let (mut name, mut root_from_frame) = (frame, Isometry3::identity());
        for _ in 0..DEPTH_MAX {
            let frame = match self.0.get(name) {
                Some(frame) if world != Some(name) => frame,
                None if world.is_some_and(|world| world != name) => {
                    let world = world.unwrap_or_default();
                    return Err(format!("no transform from {name} to {world} in /tf"));
                }
                _ => return Ok(root_from_frame),
            };
            let pose = frame.at(stamp_ns).ok_or_else(|| {
                let parent = &frame.parent;
                let stamp_s = stamp_ns as f64 / 1e9;
                format!("no transform from {name} to {parent} within 1 s of {stamp_s:.3} s in /tf")
            })?;
            root_from_frame = pose * root_from_frame;
            name = &frame.parent;
        }
        Err(format!("the frames of /tf above {frame} form a loop"))
    }
}

impl Frame {
    /// The pose at a time: between two poses at most 2 s apart, or else the nearest one at most 1 s away.
    fn at(&self, stamp_ns: i64) -> Option<Isometry3<f64>> {
        let before = self.poses.range(..=stamp_ns).next_back();
        let after = self.poses.range(stamp_ns..).next();
        if self.is_static {
            return before.or(after).map(|(_, pose)| *pose);
        }
        if let (Some((from_ns, from)), Some((to_ns, to))) = (before, after)
            && from_ns < to_ns
            && to_ns - from_ns <= 2 * POSE_MAX_NS
        {
            let part = (stamp_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
            // Opposite rotations have no middle.
            let rotation = from.rotation.try_slerp(&to.rotation, part, 1e-9).unwrap_or(from.rotation);
            let translation = from.translation.vector.lerp(&to.translation.vector, part);
            return Some(Isometry3::from_parts(translation.into(), rotation));
        }
        let distance_ns = |(at_ns, _): &(&i64, &Isometry3<f64>)| at_ns.abs_diff(stamp_ns);
        let nearest = before.into_iter().chain(after).min_by_key(distance_ns)?;
        (distance_ns(&nearest) <= POSE_MAX_NS.unsigned_abs()).then_some(*nearest.1)
    }
}
