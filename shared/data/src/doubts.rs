//! Speeds at which a recording is probably not read as it was meant: another frame rate, another unit.
//!
//! Speeds are those of chords: the way between two positions of an agent that are at least a second apart,
//! over the time. Of each type the median and the 95th percentile of the chords of moving agents are compared
//! with what is usual; and where the recording has speeds of its own, the chords with those.

use std::collections::BTreeMap;
use std::fmt;

use wire::{AgentType, Detection, detection_flags};

use crate::{FrameRate, Recording};

/// Shortest time of a chord.
const CHORD_NS: i64 = 1_000_000_000;
/// Longest time between two positions of a chord.
const GAP_MAX_NS: i64 = 3_000_000_000;
/// Speed from which an agent counts as moving.
const MOVING_MPS: f32 = 0.3;
/// Fewest chords of which anything is said.
const CHORDS_MIN: usize = 20;
/// Mean reported speed from which a chord is compared with it.
const COMPARED_MPS: f64 = 1.0;
/// Usual median ratios of positions' speeds to reported ones.
const RATIOS: std::ops::RangeInclusive<f64> = 0.87..=1.15;

/// Something about a recording that is probably wrong.
#[derive(Clone, Debug, PartialEq)]
pub enum Doubt {
    /// The agents of a type move at other speeds than usual.
    Speeds {
        /// The type.
        agent_type: AgentType,
        /// Median and 95th percentile of the moving agents.
        speeds_mps: [f32; 2],
        /// The rate at which the files' frames were counted, where they do not have their times.
        frame_rate: Option<FrameRate>,
    },
    /// The positions move at another speed than the recording reports.
    Reported {
        /// The type.
        agent_type: AgentType,
        /// Median ratio of the speed of the positions to the reported one.
        ratio: f64,
        /// The rate at which the files' frames were counted, where they do not have their times.
        frame_rate: Option<FrameRate>,
    },
}

/// Usual speeds of the moving agents of a type: least and greatest median, greatest 95th percentile.
const fn usual_mps(agent_type: AgentType) -> [f32; 3] {
    match agent_type {
        AgentType::Vehicle => [0.0, 45.0, 60.0],
        AgentType::Cyclist => [0.8, 9.0, 16.0],
        AgentType::Pedestrian => [0.5, 2.0, 6.0],
    }
}

/// What is probably wrong with a recording, by type; nothing where its agents have no identities.
#[must_use]
pub fn doubts(recording: &Recording) -> Vec<Doubt> {
    let mut agents: BTreeMap<u64, Chord> = BTreeMap::new();
    let mut types: BTreeMap<AgentType, Motion> = BTreeMap::new();
    for frame in &recording.frames {
        for detection in frame.detections.iter().filter(|detection| detection.has(detection_flags::HAS_ID)) {
            let Ok(agent_type) = detection.agent_type() else { continue };
            let place = Place::of(frame.stamp_ns + detection.offset_ns, detection);
            let chord = agents.entry(detection.id).or_insert_with(|| Chord::from(place));
            if let Some(ended) = chord.extend(place) {
                types.entry(agent_type).or_default().add(ended);
            }
        }
    }
    let of_type = |(agent_type, motion)| Motion::doubts(motion, agent_type, recording.frame_rate);
    types.into_iter().flat_map(of_type).collect()
}

/// An agent at one time.
#[derive(Clone, Copy)]
struct Place {
    stamp_ns: i64,
    position_m: [f64; 2],
    speed_mps: Option<f64>,
}

/// The way of an agent since a place.
struct Chord {
    first: Place,
    last: Place,
    /// By the reported speeds; none where one was missing.
    reported_m: Option<f64>,
}

/// A finished chord.
#[derive(Clone, Copy)]
struct Ended {
    way_m: f64,
    elapsed_s: f64,
    reported_m: Option<f64>,
}

/// The chords of a type.
#[derive(Default)]
struct Motion {
    moving_mps: Vec<f32>,
    /// Of chords to what was reported meanwhile.
    ratios: Vec<f32>,
}

impl Place {
    fn of(stamp_ns: i64, detection: &Detection) -> Self {
        let has_speed = detection.has(detection_flags::HAS_SPEED);
        Self {
            stamp_ns,
            position_m: [detection.x_m, detection.y_m].map(f64::from),
            speed_mps: has_speed.then_some(f64::from(detection.speed_mps.abs())),
        }
    }
}

impl Chord {
    const fn from(place: Place) -> Self {
        Self { first: place, last: place, reported_m: Some(0.0) }
    }

    /// Goes on to a later place; the chord if it is long enough, after which the next one begins.
    fn extend(&mut self, place: Place) -> Option<Ended> {
        let step_ns = place.stamp_ns - self.last.stamp_ns;
        if step_ns > GAP_MAX_NS {
            *self = Self::from(place);
            return None;
        }
        let mean_mps = self.last.speed_mps.zip(place.speed_mps).map(|(from, to)| (from + to) / 2.0);
        let step_m = mean_mps.map(|mean_mps| mean_mps * step_ns as f64 * 1e-9);
        self.reported_m = self.reported_m.zip(step_m).map(|(way_m, step_m)| way_m + step_m);
        self.last = place;
        let elapsed_ns = place.stamp_ns - self.first.stamp_ns;
        if elapsed_ns < CHORD_NS {
            return None;
        }
        let Self { first, reported_m, .. } = std::mem::replace(self, Self::from(place));
        let [x_m, y_m] = [0, 1].map(|axis| place.position_m[axis] - first.position_m[axis]);
        Some(Ended { way_m: x_m.hypot(y_m), elapsed_s: elapsed_ns as f64 * 1e-9, reported_m })
    }
}

impl Motion {
    fn add(&mut self, chord: Ended) {
        let speed_mps = (chord.way_m / chord.elapsed_s) as f32;
        if speed_mps >= MOVING_MPS {
            self.moving_mps.push(speed_mps);
        }
        if let Some(reported_m) = chord.reported_m.filter(|way_m| way_m / chord.elapsed_s >= COMPARED_MPS) {
            self.ratios.push((chord.way_m / reported_m) as f32);
        }
    }

    fn doubts(mut self, agent_type: AgentType, frame_rate: Option<FrameRate>) -> Vec<Doubt> {
        let mut doubts = Vec::new();
        if self.moving_mps.len() >= CHORDS_MIN {
            let speeds_mps @ [median_mps, high_mps] =
                [50, 95].map(|percent| percentile(&mut self.moving_mps, percent));
            let [least_mps, most_mps, most_high_mps] = usual_mps(agent_type);
            if !(least_mps..=most_mps).contains(&median_mps) || high_mps > most_high_mps {
                doubts.push(Doubt::Speeds { agent_type, speeds_mps, frame_rate });
            }
        }
        if self.ratios.len() >= CHORDS_MIN {
            let ratio = f64::from(percentile(&mut self.ratios, 50));
            if !RATIOS.contains(&ratio) {
                doubts.push(Doubt::Reported { agent_type, ratio, frame_rate });
            }
        }
        doubts
    }
}

/// A percentile of values, of which there is at least one.
fn percentile(values: &mut [f32], percent: usize) -> f32 {
    let place = (values.len() - 1) * percent / 100;
    *values.select_nth_unstable_by(place, f32::total_cmp).1
}

/// The agents of a type, in words.
const fn plural(agent_type: AgentType) -> &'static str {
    match agent_type {
        AgentType::Vehicle => "vehicles",
        AgentType::Cyclist => "cyclists",
        AgentType::Pedestrian => "pedestrians",
    }
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Speeds { agent_type, speeds_mps: [median_mps, high_mps], frame_rate } => {
                let [least_mps, most_mps, most_high_mps] = usual_mps(*agent_type);
                write!(
                    f,
                    "{} that move have a median speed of {median_mps:.1} m/s and a 95th percentile of \
                     {high_mps:.1} m/s; usual are {least_mps} to {most_mps} m/s and up to {most_high_mps} \
                     m/s: ",
                    plural(*agent_type)
                )?;
                match frame_rate {
                    Some(rate) => {
                        write!(f, "is it {rate} frames a second (--fps), and are positions in metres?")
                    }
                    None => f.write_str("are positions in metres and times in seconds?"),
                }
            }
            Self::Reported { agent_type, ratio, frame_rate } => {
                write!(
                    f,
                    "the positions of {} move {ratio:.2} times as fast as their reported speeds: ",
                    plural(*agent_type)
                )?;
                match frame_rate {
                    Some(rate) => {
                        let fitting_hz = rate.hertz() / ratio;
                        write!(f, "at {fitting_hz:.2} frames a second instead of {rate} they agree (--fps)")
                    }
                    None => f.write_str("are both in metres and seconds?"),
                }
            }
        }
    }
}
