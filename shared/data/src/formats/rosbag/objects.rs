//! The objects of Autoware's messages, and their places in the world.

use interop::messages::{DetectedObject, ObjectClassification, Pose, Shape, TrackedObject, label};
use nalgebra::{Isometry3, Vector3};
use wire::{AgentType, Detection, SPEED_MAX_MPS, WorldOrigin, detection_flags};

use super::transforms;
use crate::text::wrapped;

/// `orientation_availability` of an orientation whose sign is known.
const AVAILABLE: u8 = 2;
/// Largest extent of an agent.
const EXTENT_MAX_M: f64 = 100.0;
/// Smallest squared length of a quaternion that is a rotation.
const NORM_MIN: f64 = 1e-6;

/// What detected and tracked objects have in common.
#[derive(Clone, Debug)]
pub struct Object {
    /// The identity; detections have none.
    pub id: Option<[u8; 16]>,
    score: f32,
    class: u8,
    pose: Pose,
    has_heading: bool,
    speed_mps: Option<f64>,
    sigma_m: Option<f64>,
    size_m: [f64; 2],
}

/// An object in the world.
#[derive(Clone, Copy, Debug)]
pub struct Placed {
    /// The type.
    pub agent_type: AgentType,
    /// Position in the frame of the transform's target.
    pub position_m: [f64; 2],
    /// Heading, counter-clockwise from +x.
    pub heading_rad: Option<f64>,
    /// Speed along the heading.
    pub speed_mps: Option<f64>,
    /// Length and width.
    pub size_m: Option<[f64; 2]>,
    /// The detector's confidence.
    pub score: f32,
    /// Standard deviation of the position per axis.
    pub sigma_m: Option<f64>,
}

fn is_speed(speed_mps: f64) -> bool {
    speed_mps.abs() <= f64::from(SPEED_MAX_MPS)
}

fn is_extent(extent_m: f64) -> bool {
    (0.0..=EXTENT_MAX_M).contains(&extent_m)
}

pub(super) fn class(classification: &[ObjectClassification]) -> u8 {
    // The first of equally probable ones, as in Autoware.
    let best = classification.iter().rev().max_by(|a, b| a.probability.total_cmp(&b.probability));
    best.map_or(label::UNKNOWN, |best| best.label)
}

/// The type of a class; `None` for other classes.
pub(super) const fn agent_type(class: u8) -> Option<AgentType> {
    Some(match class {
        label::CAR | label::TRUCK | label::BUS | label::TRAILER | label::MOTORCYCLE => AgentType::Vehicle,
        label::BICYCLE => AgentType::Cyclist,
        label::PEDESTRIAN => AgentType::Pedestrian,
        _ => return None,
    })
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

impl Object {
    /// The object in the world; `None` if it is neither vehicle, cyclist nor pedestrian.
    #[must_use]
    pub fn placed(&self, world_from_frame: &Isometry3<f64>) -> Option<Placed> {
        let agent_type = agent_type(self.class)?;
        let pose = world_from_frame * transforms::pose(&self.pose);
        let has_heading = self.has_heading && self.has_rotation();
        Some(Placed {
            agent_type,
            position_m: [pose.translation.x, pose.translation.y],
            heading_rad: has_heading.then(|| heading_rad(&pose)),
            // A speed is along the heading.
            speed_mps: self.speed_mps.filter(|speed_mps| has_heading && is_speed(*speed_mps)),
            size_m: self
                .size_m
                .iter()
                .all(|size_m| *size_m > 0.0 && is_extent(*size_m))
                .then_some(self.size_m),
            score: if self.score.is_nan() { 1.0 } else { self.score },
            sigma_m: self.sigma_m.filter(|sigma_m| is_extent(*sigma_m)),
        })
    }

    /// Number of values that are said to be known and that no agent can have, such as NaN. They count as
    /// unknown.
    #[must_use]
    pub fn impossible_values(&self) -> usize {
        let impossible = [
            self.has_heading && !self.has_rotation(),
            self.speed_mps.is_some_and(|speed_mps| !is_speed(speed_mps)),
            !self.size_m.into_iter().all(is_extent),
            self.score.is_nan(),
            self.sigma_m.is_some_and(|sigma_m| !is_extent(sigma_m)),
        ];
        impossible.into_iter().filter(|is_impossible| *is_impossible).count()
    }

    /// Whether the quaternion is a rotation. Zeros and NaN stand for an unknown one.
    fn has_rotation(&self) -> bool {
        let q = &self.pose.orientation;
        [q.x, q.y, q.z, q.w].iter().map(|part| part * part).sum::<f64>() > NORM_MIN
    }
}

impl Placed {
    /// The object as a detection.
    ///
    /// # Errors
    /// The first value that no detection can have.
    pub fn detection(&self, id: Option<u64>, origin: WorldOrigin) -> Result<Detection, String> {
        let within = |name: &str, value: Option<f64>, range: std::ops::RangeInclusive<f64>| match value {
            Some(value) if !range.contains(&value) => Err(format!("{name} is {value}")),
            value => Ok(value.map(|value| value as f32)),
        };
        let [x, y] = self.position_m;
        if !(x.is_finite() && y.is_finite()) {
            return Err(format!("the position ({x}, {y}) is not a number"));
        }
        let [x_m, y_m] = origin.world_m(self.position_m).ok_or_else(|| {
            format!("the position ({x}, {y}) is too far from the origin {origin}: see --origin")
        })?;
        let speed_max = f64::from(SPEED_MAX_MPS);
        let speed_mps = within("the speed", self.speed_mps, -speed_max..=speed_max)?;
        let length_m = within("the length", self.size_m.map(|size| size[0]), 0.0..=EXTENT_MAX_M)?;
        let width_m = within("the width", self.size_m.map(|size| size[1]), 0.0..=EXTENT_MAX_M)?;
        let sigma_m = within("the standard deviation", self.sigma_m, 0.0..=EXTENT_MAX_M)?;
        let score = within("the probability", Some(self.score.into()), -1e6..=1e6)?;
        let heading_rad = within("the heading", self.heading_rad, f64::MIN..=f64::MAX)?;
        let flags = [
            (id.is_some(), detection_flags::HAS_ID),
            (heading_rad.is_some(), detection_flags::HAS_HEADING),
            (speed_mps.is_some(), detection_flags::HAS_SPEED),
            (length_m.is_some(), detection_flags::HAS_SIZE),
        ];
        Ok(Detection {
            id: id.unwrap_or(0),
            x_m,
            y_m,
            heading_rad: heading_rad.map_or(0.0, |heading| wrapped(heading.into()) as f32),
            speed_mps: speed_mps.unwrap_or(0.0),
            length_m: length_m.unwrap_or(0.0),
            width_m: width_m.unwrap_or(0.0),
            score: score.unwrap_or(1.0),
            sigma_m: sigma_m.unwrap_or(0.0),
            agent_type: self.agent_type as u32,
            flags: flags.into_iter().filter(|(is_given, _)| *is_given).fold(0, |bits, (_, bit)| bits | bit),
            ..Detection::default()
        })
    }
}

/// The direction of the x axis on the ground.
pub(super) fn heading_rad(pose: &Isometry3<f64>) -> f64 {
    let along = pose.rotation * Vector3::x();
    along.y.atan2(along.x)
}
