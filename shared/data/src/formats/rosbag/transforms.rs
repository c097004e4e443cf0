//! The frames of `/tf` and `/tf_static`.

use std::collections::{BTreeMap, VecDeque};

use interop::autoware::EGO;
use interop::messages::{Pose, TransformStamped};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use crate::egos::POSE_MAX_NS;

/// Maximum number of frames between an object and the root.
const DEPTH_MAX: usize = 64;

/// Shortest distance of a jump to and fro, and the distance that turning by 1 rad counts as.
const JUMP_M: f64 = 0.3;
const LEVER_M: f64 = 10.0;
/// Smallest number of such jumps, and their smallest share of the poses, that two senders make.
const JUMPS_MIN: usize = 5;
const JUMPS_SHARE: f64 = 0.1;
/// Names of frames that stand still, the preferred one first.
const FIXED: [&str; 9] = ["map", "world", "odom", "earth", "utm", "local", "global", "enu", "ground"];

/// A frame's places in one of its parents.
#[derive(Debug, Default)]
struct Edge {
    parent: String,
    is_static: bool,
    poses: BTreeMap<i64, Isometry3<f64>>,
    /// Poses that differ from another one with the same stamp.
    contradictions: usize,
}

/// The transforms of `/tf` and `/tf_static` so far: the edges from each frame to its parents. A second parent is
/// an error of the senders, but it may lead to another world.
#[derive(Debug, Default)]
pub struct Transforms(BTreeMap<String, Vec<Edge>>);

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
pub(super) fn bare(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

impl Transforms {
    /// Adds a transform.
    pub fn add(&mut self, found: &TransformStamped, is_static: bool) {
        let (at, q) = (&found.transform.translation, &found.transform.rotation);
        let pose = isometry([at.x, at.y, at.z], [q.x, q.y, q.z, q.w]);
        let edge = self.edge(found);
        edge.is_static = is_static;
        if let Some(before) = edge.poses.insert(stamp_ns(found), pose)
            && !is_static
            && distance_m(&before, &pose) > JUMP_M
        {
            edge.contradictions += 1;
        }
    }

    fn edge(&mut self, found: &TransformStamped) -> &mut Edge {
        let parent = bare(&found.header.frame_id);
        let edges = self.0.entry(bare(&found.child_frame_id).to_owned()).or_default();
        let place = edges.iter().position(|edge| edge.parent == parent).unwrap_or_else(|| {
            edges.push(Edge { parent: parent.to_owned(), ..Edge::default() });
            edges.len() - 1
        });
        &mut edges[place]
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
        let is_known = |edge: &Edge| edge.is_static || edge.poses.range(stamp_ns..).next().is_some();
        self.path(frame, world, is_known).is_some()
    }

    /// Adds a live transform. A moving frame keeps `keep_ns` before its newest transform. If a transform is
    /// older than that, the clock was set back, and the frame begins again.
    pub fn add_live(&mut self, found: &TransformStamped, is_static: bool, keep_ns: i64) {
        let from_ns = stamp_ns(found).saturating_sub(keep_ns);
        let edge = self.edge(found);
        let newest_ns = edge.poses.last_key_value().map(|(newest_ns, _)| *newest_ns);
        let went_back =
            newest_ns.is_some_and(|newest_ns| stamp_ns(found) < newest_ns.saturating_sub(keep_ns));
        edge.poses = if is_static || went_back { BTreeMap::new() } else { edge.poses.split_off(&from_ns) };
        self.add(found, is_static);
    }

    /// The edges of the shortest way from a frame up to `world` over edges that `is_usable`, the first one first.
    fn path(&self, frame: &str, world: &str, is_usable: impl Fn(&Edge) -> bool) -> Option<Vec<&Edge>> {
        let mut ways = VecDeque::from([(frame, Vec::new())]);
        let mut seen = vec![frame];
        while let Some((name, way)) = ways.pop_front() {
            if name == world {
                return Some(way);
            }
            for edge in self.0.get(name).into_iter().flatten().filter(|edge| is_usable(edge)) {
                if way.len() < DEPTH_MAX && !seen.contains(&edge.parent.as_str()) {
                    seen.push(&edge.parent);
                    ways.push_back((&edge.parent, way.iter().copied().chain([edge]).collect()));
                }
            }
        }
        None
    }

    /// The transform from a frame to `world`, at a time.
    ///
    /// # Errors
    /// The transform that is missing.
    pub fn to_world(&self, frame: &str, world: &str, stamp_ns: i64) -> Result<Isometry3<f64>, String> {
        if let Some(way) = self.path(frame, world, |edge| edge.at(stamp_ns).is_some()) {
            let poses = way.iter().filter_map(|edge| edge.at(stamp_ns));
            return Ok(poses.fold(Isometry3::identity(), |from_frame, pose| pose * from_frame));
        }
        let Some(way) = self.path(frame, world, |_| true) else {
            let of = if frame.is_empty() { "a frame without a name" } else { frame };
            return Err(format!("no transform from {of} to {world} in /tf or /tf_static"));
        };
        let mut name = frame;
        for edge in way {
            if edge.at(stamp_ns).is_none() {
                let (parent, stamp_s) = (&edge.parent, stamp_ns as f64 / 1e9);
                return Err(format!(
                    "no transform from {name} to {parent} within 1 s of {stamp_s:.3} s in /tf"
                ));
            }
            name = &edge.parent;
        }
        Err(format!("the transforms from {frame} to {world} are at different times"))
    }

    /// The world of objects in these frames: `map` if there is one, or else the frame that most of them are below.
    ///
    /// # Errors
    /// The reason if no frame can be the world.
    pub fn world<'a>(&'a self, frames: impl Iterator<Item = &'a str>) -> Result<&'a str, String> {
        let parents = || self.0.values().flatten().map(|edge| edge.parent.as_str());
        let map = FIXED[0];
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        let mut last = None;
        for frame in frames {
            if frame == map || parents().any(|parent| parent == map) {
                return Ok(map);
            }
            last = Some(frame);
            self.roots(frame).into_iter().for_each(|root| *counts.entry(root).or_default() += 1);
        }
        counts.retain(|root, _| !root.is_empty() && *root != EGO);
        let rank = |root: &str| FIXED.iter().rev().position(|fixed| *fixed == root);
        let best = counts.into_iter().max_by_key(|(root, count)| (rank(root), *count));
        best.map(|(root, _)| root).ok_or_else(|| match last.unwrap_or_default() {
            "" => "the frame of the objects has no name (header.frame_id is empty)".to_owned(),
            EGO => format!("objects in the frame {EGO}, and no transform of it in /tf"),
            frame => format!("no transform from {frame} to a frame that stands still, such as {map}, in /tf"),
        })
    }

    /// The frames without a parent that a frame is below.
    fn roots<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        let (mut seen, mut place) = (vec![frame], 0);
        while let Some(name) = seen.get(place) {
            for edge in self.0.get(*name).into_iter().flatten() {
                if !seen.contains(&edge.parent.as_str()) {
                    seen.push(&edge.parent);
                }
            }
            place += 1;
        }
        seen.retain(|name| !self.has(name));
        seen
    }

    /// What is ambiguous about the transforms from these frames to `world`, in sentences; and whether it makes the
    /// positions doubtful.
    pub fn ambiguities(&self, frames: &[&str], world: &str) -> Vec<(String, bool)> {
        let mut found = Vec::new();
        let moves = self.0.values().flatten().any(|edge| !edge.is_static && edge.parent == world);
        if !FIXED.contains(&world) && !moves {
            found.push((
                format!(
                    "objects are in {world}, and no transform shows whether {world} stands still: record the \
                         transform from {world} to map in /tf or /tf_static"
                ),
                true,
            ));
        }
        let mut below: Vec<&str> = Vec::new();
        for frame in frames {
            let mut name = *frame;
            for edge in self.path(frame, world, |_| true).unwrap_or_default() {
                if !below.contains(&name) {
                    below.push(name);
                }
                name = &edge.parent;
            }
        }
        for name in below {
            let Some(edges) = self.0.get(name) else { continue };
            if let [_, _, ..] = edges[..] {
                let parents: Vec<&str> = edges.iter().map(|edge| edge.parent.as_str()).collect();
                let ways =
                    parents.iter().filter(|parent| self.path(parent, world, |_| true).is_some()).count();
                let sentence = format!(
                    "the frame {name} has the parents {}: the transforms to {world} are used",
                    parents.join(" and ")
                );
                found.push((sentence, ways > 1));
            }
            let jumping = edges
                .iter()
                .filter(|edge| edge.jumps() && self.path(&edge.parent, world, |_| true).is_some());
            found.extend(jumping.map(|Edge { parent, .. }| {
                let sentence = format!(
                    "the transforms from {name} to {parent} jump to and fro, as if two senders wrote them: keep one"
                );
                (sentence, true)
            }));
        }
        found
    }
}

/// The distance between two poses, with the turn as the way of a point at [`LEVER_M`].
fn distance_m(from: &Isometry3<f64>, to: &Isometry3<f64>) -> f64 {
    (to.translation.vector - from.translation.vector).norm() + LEVER_M * from.rotation.angle_to(&to.rotation)
}

/// The pose at a part of the way between two poses.
fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, part: f64) -> Isometry3<f64> {
    // Opposite rotations have no middle.
    let rotation = from.rotation.try_slerp(&to.rotation, part, 1e-9).unwrap_or(from.rotation);
    let translation = from.translation.vector.lerp(&to.translation.vector, part);
    Isometry3::from_parts(translation.into(), rotation)
}

impl Edge {
    /// Whether many poses are far from the way between their neighbours, as if they were of two senders.
    fn jumps(&self) -> bool {
        if self.is_static {
            return false;
        }
        let poses: Vec<_> = self.poses.iter().collect();
        let is_jump = |[(from_ns, from), (at_ns, at), (to_ns, to)]: [&(&i64, &Isometry3<f64>); 3]| {
            let part = (*at_ns - *from_ns) as f64 / (*to_ns - *from_ns) as f64;
            let off_m = distance_m(&between(from, to, part), at);
            *to_ns - *from_ns <= POSE_MAX_NS && off_m > JUMP_M && off_m > distance_m(from, to)
        };
        let jumps = poses.windows(3).filter(|three| is_jump([&three[0], &three[1], &three[2]])).count();
        let jumps = jumps + self.contradictions;
        jumps >= JUMPS_MIN && jumps as f64 >= JUMPS_SHARE * poses.len() as f64
    }

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
            return Some(between(from, to, (stamp_ns - from_ns) as f64 / (to_ns - from_ns) as f64));
        }
        let distance_ns = |(at_ns, _): &(&i64, &Isometry3<f64>)| at_ns.abs_diff(stamp_ns);
        let nearest = before.into_iter().chain(after).min_by_key(distance_ns)?;
        (distance_ns(&nearest) <= POSE_MAX_NS.unsigned_abs()).then_some(*nearest.1)
    }
}
