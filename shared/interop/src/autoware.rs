//! A tick as Autoware's messages.
//!
//! Objects are in the frame [`MAP`]. It is the recording's own frame, so the run's origin is added again.
//! Velocities are along and across the object, as in Autoware. The tracks are flat, so the z of a pose is
//! half the height of a typical object of the type. Sizes that the detections lack are typical ones too.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::Deref;

use audit::Doubt;
use wire::tick_view::{AgentView, ForecastView, Point, TickView};
use wire::{AGENT_TYPES, AgentType, Cause, Expert, Hop, Quality, StageId, Track, WorldOrigin, vocabulary};

use crate::cdr::Byte;
use crate::messages::{
    Covariance, DiagnosticArray, DiagnosticStatus, Duration, Header, KeyValue, ObjectClassification,
    Point as RosPoint, Pose, PoseWithCovariance, PredictedObject, PredictedObjectKinematics,
    PredictedObjects, PredictedPath, Quaternion, Shape, TfMessage, Time, TrackedObject,
    TrackedObjectKinematics, TrackedObjects, Transform, TransformStamped, Twist, TwistWithCovariance, Uuid,
    Vector3, label,
};

/// Frame of the tracks.
pub const MAP: &str = "map";
/// Frame of the ego vehicle.
pub const EGO: &str = "base_link";

/// `TrackedObjectKinematics::orientation_availability` of a known orientation.
const AVAILABLE: u8 = 2;
/// Speed below which an object is stationary.
const STATIONARY_MPS: f32 = 0.1;
/// Shortest step whose direction is the heading of a path's pose.
const STEP_MIN_M: f32 = 0.05;
/// Level of a diagnostic status without a fault.
const OK: Byte = Byte(0);
/// The same, of a state to look at.
const WARN: Byte = Byte(1);

/// A tick with what its view leaves out.
#[derive(Debug)]
pub struct Tick<'a> {
    /// The view.
    pub view: TickView,
    /// The tracks of the view.
    pub tracks: &'a [Track],
    /// The world frame's origin in the recording's own frame.
    pub origin: WorldOrigin,
}

impl Deref for Tick<'_> {
    type Target = TickView;

    fn deref(&self) -> &TickView {
        &self.view
    }
}

impl Tick<'_> {
    /// The agents of the view with their tracks.
    fn agents(&self) -> impl Iterator<Item = (&AgentView, &Track)> {
        self.view.agents.iter().filter_map(|agent| {
            let track = self.tracks.iter().find(|track| track.id == agent.id)?;
            Some((agent, track))
        })
    }
}

/// Length, width and height of a typical agent, m.
#[must_use]
pub const fn typical_size_m(of: AgentType) -> [f32; 3] {
    match of {
        AgentType::Vehicle => [4.5, 1.8, 1.6],
        AgentType::Cyclist => [1.8, 0.6, 1.7],
        AgentType::Pedestrian => [0.6, 0.6, 1.7],
    }
}

/// Length, width and height of an agent.
#[must_use]
pub fn size_m(agent: &AgentView) -> [f32; 3] {
    let [length_m, width_m, height_m] = typical_size_m(agent.agent_type);
    [agent.length_m.unwrap_or(length_m), agent.width_m.unwrap_or(width_m), height_m]
}

/// Removes forecasts that are older than the limit, and returns their number. The age of a forecast is its
/// age at the release of the tick and the time `passed_ns` since then.
pub fn leave_out_old(view: &mut TickView, max_age_ns: u64, passed_ns: u64) -> u64 {
    let is_old = |age_ns: u64| age_ns.saturating_add(passed_ns) > max_age_ns;
    let old = |agent: &mut AgentView| agent.forecast.take_if(|forecast| is_old(forecast.age_ns)).is_some();
    view.agents.iter_mut().map(|agent| u64::from(old(agent))).sum()
}

/// The modes of a forecast by falling probability, at most `paths_max`; the best forecast if it has no modes.
#[must_use]
pub fn probable_paths(forecast: &ForecastView, paths_max: usize) -> Vec<(&[Point], f32)> {
    let mut paths: Vec<(&[Point], f32)> =
        forecast.modes.iter().map(Vec::as_slice).zip(forecast.probability.iter().copied()).collect();
    paths.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    paths.truncate(paths_max.max(1));
    if paths.is_empty() {
        paths.push((&forecast.best, 1.0));
    }
    paths
}

/// Seconds and nanoseconds; clamped to the range of ROS.
fn split(ns: i64) -> (i32, u32) {
    let sec = ns.div_euclid(1_000_000_000).clamp(i32::MIN.into(), i32::MAX.into());
    (sec as i32, ns.rem_euclid(1_000_000_000) as u32)
}

pub(crate) fn header(view: &Tick<'_>) -> Header {
    let (sec, nanosec) = split(view.stamp_ns);
    Header { stamp: Time { sec, nanosec }, frame_id: MAP.to_owned() }
}

/// The identity of an agent: the same in all ticks and messages of a run.
#[must_use]
pub fn object_id(agent: &AgentView) -> Uuid {
    let mut uuid = *b"stgdat\x80\0\x80\0\0\0\0\0\0\0";
    // Version 8 is free for own formats. Numbers of tracks and of the recording's agents do not mix.
    uuid[7] = u8::from(agent.source_id != 0);
    uuid[8..].copy_from_slice(&agent.known_as().to_be_bytes());
    Uuid { uuid }
}

fn yaw(heading_rad: f32) -> Quaternion {
    let half = f64::from(heading_rad) / 2.0;
    Quaternion { x: 0.0, y: 0.0, z: half.sin(), w: half.cos() }
}

pub(crate) fn pose([x, y]: [f64; 2], z: f64, heading_rad: f32) -> Pose {
    Pose { position: RosPoint { x, y, z }, orientation: yaw(heading_rad) }
}

fn z_m(agent: &AgentView) -> f64 {
    f64::from(size_m(agent)[2]) / 2.0
}

fn classification(track: &Track, own: AgentType) -> Vec<ObjectClassification> {
    let label = |of| match of {
        AgentType::Vehicle => label::CAR,
        AgentType::Cyclist => label::BICYCLE,
        AgentType::Pedestrian => label::PEDESTRIAN,
    };
    let has_probabilities = track.type_probability.iter().any(|probability| *probability > 0.0);
    let of = |of: AgentType| match has_probabilities {
        true => track.type_probability[of.index()],
        false => f32::from(u8::from(of == own)),
    };
    let classes =
        AGENT_TYPES.map(|class| ObjectClassification { label: label(class), probability: of(class) });
    let mut classes: Vec<_> = classes.into_iter().filter(|class| class.probability > 0.0).collect();
    // The agent's own type is the first of equal ones.
    let is_other = |class: &ObjectClassification| class.label != label(own);
    classes.sort_by(|a, b| b.probability.total_cmp(&a.probability).then(is_other(a).cmp(&is_other(b))));
    classes
}

fn shape(agent: &AgentView) -> Shape {
    let [x, y, z] = size_m(agent).map(f64::from);
    Shape { dimensions: Vector3 { x, y, z }, ..Shape::default() }
}

/// Rows and columns of a state's entries in ROS's covariances: x, y, ψ of the pose.
const POSE: [usize; 3] = [0, 1, 5];

fn pose_with_covariance(view: &Tick<'_>, agent: &AgentView, track: &Track) -> PoseWithCovariance {
    let mut covariance = Covariance::default();
    let state_len = track.state_len as usize;
    // (x, y, ψ, v, β) has the heading, (x, y, vx, vy) has not.
    let known = match state_len {
        5 => 3,
        4 => 2,
        _ => 0,
    };
    for (row, to_row) in POSE.into_iter().enumerate().take(known) {
        for (column, to_column) in POSE.into_iter().enumerate().take(known) {
            covariance.0[to_row * 6 + to_column] = track.covariance[row * state_len + column].into();
        }
    }
    let position_m = view.origin.own_m(agent.position_m);
    PoseWithCovariance { pose: pose(position_m, z_m(agent), agent.heading_rad), covariance }
}

/// The velocity along and across the agent.
fn twist(agent: &AgentView, track: &Track) -> TwistWithCovariance {
    let (sin, cos) = f64::from(agent.heading_rad).sin_cos();
    let [vx, vy] = agent.velocity_mps.map(f64::from);
    let linear = Vector3 { x: cos * vx + sin * vy, y: cos * vy - sin * vx, z: 0.0 };
    let mut covariance = Covariance::default();
    let at = |row: usize, column: usize, len: usize| f64::from(track.covariance[row * len + column]);
    match track.state_len {
        5 => {
            // v along the heading; slip turns the velocity.
            let speed_mps = vx.hypot(vy);
            covariance.0[0] = at(3, 3, 5);
            covariance.0[7] = speed_mps * speed_mps * at(4, 4, 5);
        }
        4 => {
            let [xx, xy, yy] = [at(2, 2, 4), at(2, 3, 4), at(3, 3, 4)];
            covariance.0[0] = cos * cos * xx + 2.0 * sin * cos * xy + sin * sin * yy;
            covariance.0[7] = sin * sin * xx - 2.0 * sin * cos * xy + cos * cos * yy;
            covariance.0[1] = sin * cos * (yy - xx) + (cos * cos - sin * sin) * xy;
            covariance.0[6] = covariance.0[1];
        }
        _ => {}
    }
    TwistWithCovariance { twist: Twist { linear, ..Twist::default() }, covariance }
}

/// The tracks of a tick.
#[must_use]
pub fn tracked_objects(view: &Tick<'_>) -> TrackedObjects {
    let objects = view.agents().map(|(agent, track)| {
        let [vx_mps, vy_mps] = agent.velocity_mps;
        let kinematics = TrackedObjectKinematics {
            pose_with_covariance: pose_with_covariance(view, agent, track),
            twist_with_covariance: twist(agent, track),
            orientation_availability: AVAILABLE,
            is_stationary: vx_mps.hypot(vy_mps) < STATIONARY_MPS,
            ..TrackedObjectKinematics::default()
        };
        TrackedObject {
            object_id: object_id(agent),
            existence_probability: track.existence,
            classification: classification(track, agent.agent_type),
            kinematics,
            shape: shape(agent),
        }
    });
    TrackedObjects { header: header(view), objects: objects.collect() }
}

/// The forecasts of a tick: of each agent the most probable paths first. An agent without a forecast is left
/// out, because Autoware's readers expect a path.
#[must_use]
pub fn predicted_objects(view: &Tick<'_>, paths_max: usize) -> PredictedObjects {
    let (sec, nanosec) = split(i64::try_from(view.step_ns).unwrap_or(i64::MAX));
    let time_step = Duration { sec, nanosec };
    let objects = view.agents().filter_map(|(agent, track)| {
        let forecast = agent.forecast.as_ref()?;
        let path = |(points, confidence)| PredictedPath {
            path: path(view, agent, points),
            time_step: time_step.clone(),
            confidence,
        };
        let kinematics = PredictedObjectKinematics {
            initial_pose_with_covariance: pose_with_covariance(view, agent, track),
            initial_twist_with_covariance: twist(agent, track),
            predicted_paths: probable_paths(forecast, paths_max).into_iter().map(path).collect(),
            ..PredictedObjectKinematics::default()
        };
        Some(PredictedObject {
            object_id: object_id(agent),
            existence_probability: track.existence,
            classification: classification(track, agent.agent_type),
            kinematics,
            shape: shape(agent),
        })
    });
    PredictedObjects { header: header(view), objects: objects.collect() }
}

/// The present pose, then a pose for each step in the direction of the motion.
fn path(view: &Tick<'_>, agent: &AgentView, points: &[Point]) -> Vec<Pose> {
    let mut heading_rad = agent.heading_rad;
    let mut last = agent.position_m;
    let steps = points.iter().map(|&point| {
        let [dx, dy] = [point[0] - last[0], point[1] - last[1]];
        if dx.hypot(dy) >= STEP_MIN_M {
            heading_rad = dy.atan2(dx);
        }
        last = point;
        pose(view.origin.own_m(point), z_m(agent), heading_rad)
    });
    let present = std::iter::once(pose(view.origin.own_m(agent.position_m), z_m(agent), agent.heading_rad));
    present.chain(steps).collect()
}

/// The ego vehicle's pose; `None` if it is unknown.
#[must_use]
pub fn transforms(view: &Tick<'_>) -> Option<TfMessage> {
    let (position_m, heading_rad) = view.ego?;
    let [x, y] = view.origin.own_m(position_m);
    let translation = Vector3 { x, y, z: 0.0 };
    let transform = Transform { translation, rotation: yaw(heading_rad) };
    let ego = TransformStamped { header: header(view), child_frame_id: EGO.to_owned(), transform };
    Some(TfMessage { transforms: vec![ego] })
}

/// The values of a tick that have no field in Autoware's messages. Each forecast has its quality, cause, age
/// and evidence. The tick has the number of forecasts, the doubts about the input, the learned noise of the
/// detections, and each stage's time and budget.
#[must_use]
pub fn diagnostics(view: &Tick<'_>, hops: &[Hop], budgets_ms: &BTreeMap<StageId, f64>) -> DiagnosticArray {
    let mut status = vec![input_status(view)];
    status.extend(hops.iter().filter_map(|hop| stage_status(hop, budgets_ms)));
    status.extend(view.agents.iter().map(agent_status));
    DiagnosticArray { header: header(view), status }
}

fn value(key: &str, value: &dyn Display) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}

fn ms(ns: u64) -> f64 {
    (ns as f64 / 1e3).round() / 1e3
}

fn input_status(view: &Tick<'_>) -> DiagnosticStatus {
    let of = |quality| {
        view.agents
            .iter()
            .filter_map(|agent| agent.forecast.as_ref())
            .filter(|f| f.quality == quality)
            .count()
    };
    let mut values = vec![value("tick", &view.seq), value("tracks", &view.agents.len())];
    values.extend(Quality::ALL.map(|quality| value(quality.name(), &of(quality))));
    let without = view.agents.iter().filter(|agent| agent.forecast.is_none()).count();
    values.push(value("without forecast", &without));
    let doubts: Vec<Doubt> = Doubt::of_bits(view.doubts).collect();
    for doubt in &doubts {
        values.push(value(&format!("doubt: {}", doubt.name()), &doubt.remedy()));
    }
    for agent_type in AGENT_TYPES {
        let track = view.tracks.iter().find(|track| track.agent_type == agent_type as u32);
        let noise =
            ["position_m", "heading_rad", "speed_mps"].into_iter().zip(track.map_or([0.0; 3], Track::noise));
        for (of, deviation) in noise.filter(|(_, deviation)| *deviation > 0.0) {
            values.push(value(&format!("noise: {} {of}", agent_type.name()), &deviation));
        }
    }
    let observations: Vec<&str> = doubts.iter().map(|doubt| doubt.observation()).collect();
    let (level, message) = match (view.doubts, without) {
        _ if view.is_predicted => (WARN, "no detections arrived: the tracks are predicted".to_owned()),
        (0, 0) => (OK, "every track has a forecast".to_owned()),
        (0, _) => (WARN, "tracks without a forecast are not among the predicted objects".to_owned()),
        _ => (WARN, format!("the input looks wrong: {}", observations.join("; "))),
    };
    DiagnosticStatus {
        level,
        name: "stgdat: tick".to_owned(),
        message,
        values,
        ..DiagnosticStatus::default()
    }
}

fn stage_status(hop: &Hop, budgets_ms: &BTreeMap<StageId, f64>) -> Option<DiagnosticStatus> {
    let stage = StageId::from_number(hop.stage)?;
    let compute_ms = ms(hop.finished_ns.saturating_sub(hop.started_ns));
    let budget_ms = budgets_ms.get(&stage).copied();
    let mut values = vec![
        value("compute_ms", &compute_ms),
        value("waiting_ms", &ms(hop.started_ns.saturating_sub(hop.received_ns))),
        value("restarts", &hop.incarnation),
    ];
    values.extend(budget_ms.map(|budget_ms| value("budget_ms", &budget_ms)));
    let is_over = budget_ms.is_some_and(|budget_ms| compute_ms > budget_ms);
    let (level, message) = if is_over { (WARN, "over its budget") } else { (OK, "") };
    let name = format!("stgdat: stage {}", stage.name());
    Some(DiagnosticStatus { level, name, message: message.to_owned(), values, ..DiagnosticStatus::default() })
}

fn agent_status(agent: &AgentView) -> DiagnosticStatus {
    let mut values = vec![value("track", &agent.id), value("unseen_ms", &ms(agent.unseen_ns))];
    let (mut level, mut message) = (WARN, "no forecast".to_owned());
    if let Some(forecast) = &agent.forecast {
        let (quality, cause) = (forecast.quality.name(), Cause::name_of(forecast.cause));
        // Not a fault: as in the verdict of a report.
        let is_normal = forecast.cause != Cause::None as u32
            && vocabulary::look(forecast.cause).is_some_and(|look| look.is_normal);
        level = if forecast.quality == Quality::Learned || is_normal { OK } else { WARN };
        message = vocabulary::described(forecast.quality, forecast.cause).into_owned();
        values.push(value("quality", &quality));
        values.push(value("cause", &cause));
        values.push(value("age_ms", &ms(forecast.age_ns)));
        values.push(value("out_of_distribution", &forecast.out_of_distribution));
        for (number, weight) in (0..).zip(forecast.experts).filter(|(_, weight)| *weight > 0.0) {
            let expert = Expert::from_number(number).map_or("unknown", Expert::name);
            values.push(value(&format!("evidence: {expert}"), &weight));
        }
    }
    let hex = object_id(agent).uuid.iter().map(|byte| format!("{byte:02x}")).collect();
    let name = format!("stgdat: agent {}", agent.known_as());
    DiagnosticStatus { level, name, message, hardware_id: hex, values }
}
