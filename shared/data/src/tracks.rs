//! From frames with identities to trajectories.

use std::collections::BTreeMap;

use scene::State;
use wire::{AgentType, Detection, detection_flags};

use crate::rows::HEADING_SPEED_MPS;
use crate::{Recording, text};

/// All flags of motion that a detection can have.
const MOTION: u32 = detection_flags::HAS_HEADING | detection_flags::HAS_SPEED;

/// One agent over all frames that detected it.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedTrack {
    /// Identity in the recording.
    pub id: u64,
    /// Times of the measurements and states in time order. A state never depends on later data.
    pub states: Vec<(i64, State)>,
    /// Whether the first state lacks velocity and heading, because there was no position before it. Once the
    /// second state is known, [`RecordedTrack::state_at`] gives the first one its velocity and heading.
    pub starts_unmoved: bool,
    /// The attributes that the recording had reported of the agent from each of these stamps on, in time
    /// order, at least one entry. Attributes can become known or change.
    pub reported: Vec<(i64, Reported)>,
}

/// The attributes that a recording has reported of an agent so far, without its states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reported {
    /// The agent type.
    pub agent_type: AgentType,
    /// Length, or 0 if unknown.
    pub length_m: f32,
    /// Width, or 0 if unknown.
    pub width_m: f32,
    /// Whether every detection so far had a speed.
    pub has_speed: bool,
    /// Whether every detection so far had a heading.
    pub has_heading: bool,
}

impl RecordedTrack {
    /// The attributes that were known of the agent at a time, from detections up to then only. Before the
    /// first detection it returns the first detection's attributes.
    ///
    /// # Panics
    /// If `reported` is empty.
    #[must_use]
    pub fn reported_at(&self, stamp_ns: i64) -> Reported {
        let known = self.reported.partition_point(|(from_ns, _)| *from_ns <= stamp_ns);
        self.reported[known.saturating_sub(1)].1
    }

    /// The state at `stamp_ns` as known at `now_ns`, from states up to then only. A recorded state is
    /// unchanged. Between two states that are at most `gap_max_ns` apart the state is interpolated. Otherwise
    /// `None`.
    #[must_use]
    pub fn state_at(&self, stamp_ns: i64, now_ns: i64, gap_max_ns: i64) -> Option<State> {
        let next = self.states.partition_point(|(at_ns, _)| *at_ns < stamp_ns);
        let (next_ns, to) = self.known(next, now_ns)?;
        if next_ns == stamp_ns {
            return Some(to);
        }
        let (last_ns, from) = self.known(next.checked_sub(1)?, now_ns)?;
        let gap_ns = next_ns - last_ns;
        (gap_ns <= gap_max_ns).then(|| between(from, to, (stamp_ns - last_ns) as f32 / gap_ns as f32))
    }

    /// The state at `stamp_ns` as known then, of an agent whose newest measurement is `offset_ns` from that
    /// stamp. The agent's last velocity moves the state.
    pub(crate) fn state_now(&self, stamp_ns: i64, offset_ns: i64) -> Option<State> {
        let measured_ns = stamp_ns.checked_add(offset_ns)?;
        let measured = self.state_at(measured_ns, measured_ns, 0)?;
        let elapsed_s = (-offset_ns as f64 * 1e-9) as f32;
        let moved = [0, 1].map(|axis| measured.position_m[axis] + measured.velocity_mps[axis] * elapsed_s);
        Some(State { position_m: moved, ..measured })
    }

    /// A recorded state as known at `now_ns`.
    fn known(&self, index: usize, now_ns: i64) -> Option<(i64, State)> {
        let &(stamp_ns, state) = self.states.get(index).filter(|(stamp_ns, _)| *stamp_ns <= now_ns)?;
        match self.states.get(1) {
            Some((second_ns, second)) if index == 0 && self.starts_unmoved && *second_ns <= now_ns => {
                Some((stamp_ns, State { position_m: state.position_m, ..*second }))
            }
            _ => Some((stamp_ns, state)),
        }
    }
}

/// The trajectories of a recording, by identity. Velocities and headings are the recording's, or else
/// backward differences \[model §1\]. Detections without identity are left out.
#[must_use]
pub fn tracks(recording: &Recording) -> Vec<RecordedTrack> {
    follow(recording, true)
}

/// As [`tracks`], but with velocities and headings from the positions only, as from a sensor that measures
/// neither.
#[must_use]
pub fn tracks_from_positions(recording: &Recording) -> Vec<RecordedTrack> {
    follow(recording, false)
}

fn follow(recording: &Recording, motion_is_given: bool) -> Vec<RecordedTrack> {
    let mut tracks: BTreeMap<u64, RecordedTrack> = BTreeMap::new();
    for frame in &recording.frames {
        for detection in frame.detections.iter().filter(|detection| detection.has(detection_flags::HAS_ID)) {
            let Ok(agent_type) = detection.agent_type() else { continue };
            let track = tracks.entry(detection.id).or_insert_with(|| RecordedTrack {
                id: detection.id,
                states: Vec::new(),
                starts_unmoved: !(motion_is_given && detection.has(MOTION)),
                reported: Vec::new(),
            });
            let stamp_ns = frame.stamp_ns + detection.offset_ns;
            let last = track.reported.last().map(|(_, reported)| *reported);
            let reported = Reported::after(last, detection, agent_type);
            if last != Some(reported) {
                track.reported.push((stamp_ns, reported));
            }
            // If two measurements have the same time, or one came late, the first is kept.
            if track.states.last().is_some_and(|(last_ns, _)| stamp_ns <= *last_ns) {
                continue;
            }
            let state = state(track.states.last(), stamp_ns, detection, motion_is_given);
            track.states.push((stamp_ns, state));
        }
    }
    tracks.into_values().collect()
}

impl Reported {
    fn after(last: Option<Self>, detection: &Detection, agent_type: AgentType) -> Self {
        let has = |flag: u32, before: fn(Self) -> bool| detection.has(flag) && last.is_none_or(before);
        let [length_m, width_m] = match detection.has(detection_flags::HAS_SIZE) {
            true => [detection.length_m, detection.width_m],
            false => last.map_or([0.0; 2], |last| [last.length_m, last.width_m]),
        };
        Self {
            agent_type,
            length_m,
            width_m,
            has_speed: has(detection_flags::HAS_SPEED, |last| last.has_speed),
            has_heading: has(detection_flags::HAS_HEADING, |last| last.has_heading),
        }
    }
}

fn state(last: Option<&(i64, State)>, stamp_ns: i64, detection: &Detection, motion_is_given: bool) -> State {
    let position_m = [detection.x_m, detection.y_m];
    let difference_mps = last.map_or([0.0; 2], |(last_ns, last)| {
        let dt_s = ((stamp_ns - last_ns) as f64 * 1e-9) as f32;
        [0, 1].map(|axis| (position_m[axis] - last.position_m[axis]) / dt_s)
    });
    let last_heading_rad = last.map_or(0.0, |(_, last)| last.heading_rad);
    let course_rad = |velocity_mps: [f32; 2]| {
        let moves = velocity_mps[0].hypot(velocity_mps[1]) >= HEADING_SPEED_MPS;
        if moves { velocity_mps[1].atan2(velocity_mps[0]) } else { last_heading_rad }
    };
    let heading_rad = match motion_is_given && detection.has(detection_flags::HAS_HEADING) {
        true => detection.heading_rad,
        false => course_rad(difference_mps),
    };
    let velocity_mps = match motion_is_given && detection.has(detection_flags::HAS_SPEED) {
        true => [heading_rad.cos(), heading_rad.sin()].map(|direction| direction * detection.speed_mps),
        false => difference_mps,
    };
    State { position_m, velocity_mps, heading_rad }
}

/// The state at `share` of the way between two states. The heading turns the shorter way.
fn between(from: State, to: State, share: f32) -> State {
    let mix = |a: f32, b: f32| a + (b - a) * share;
    let turn_rad = text::wrapped(f64::from(to.heading_rad - from.heading_rad)) as f32;
    State {
        position_m: [0, 1].map(|axis| mix(from.position_m[axis], to.position_m[axis])),
        velocity_mps: [0, 1].map(|axis| mix(from.velocity_mps[axis], to.velocity_mps[axis])),
        heading_rad: text::wrapped(f64::from(from.heading_rad + turn_rad * share)) as f32,
    }
}
