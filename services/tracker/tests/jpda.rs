//! Two agents that cross closely in clutter, tracked by assignment and by joint probabilistic data
//! association.

use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tracker::{Association, TrackerOptions};
use wire::{AgentType, Detection, Track};

use crate::support::harness::{Harness, MEETINGS, Meeting, detected_at, noise, with_heading};

const SEEDS: u64 = 100;
/// Number of frames of a crossing. `MEETING` contains the frames near it, in which ids are not compared.
const FRAMES: u64 = 75;
const MEETING: std::ops::Range<u64> = 20..55;
/// The first frames, in which tracks start.
const BEGIN: u64 = 10;
/// False detections per m². `CLUTTER_REACH_M` is their largest distance from an agent along each axis.
const CLUTTER: f64 = 0.01;
const CLUTTER_REACH_M: f64 = 10.0;
/// Distance within which a track belongs to an agent.
const NEAR_M: f64 = 1.5;

const OVERTAKING: Meeting = Meeting {
    name: "a vehicle overtaking, 2.5 m apart",
    agent_type: AgentType::Vehicle,
    agents: [([0.0, 0.0], [10.0, 0.0]), ([0.0, 2.5], [8.0, 0.0])],
};

/// Results of all crossings.
#[derive(Debug, Default)]
struct Outcome {
    /// Agents that have another id after the crossing, or more than one id before or after it.
    switched_count: usize,
    /// Crossings after which an agent has the other agent's id.
    swapped_count: usize,
    /// Frames in which an agent had no track.
    lost_count: usize,
    found_count: usize,
    square_m2: f64,
}

impl Outcome {
    fn rms_m(&self) -> f64 {
        (self.square_m2 / self.found_count as f64).sqrt()
    }

    /// Finds an agent's track and counts its error. Returns the track's id.
    fn find(&mut self, tracks: &[Track], [x, y, ..]: &[f64; 4]) -> Option<u64> {
        let off_m = |track: &Track| (f64::from(track.x_m) - x).hypot(f64::from(track.y_m) - y);
        let near = tracks.iter().map(|track| (off_m(track), track.id)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((off_m, id)) = near.filter(|(off_m, _)| *off_m < NEAR_M) else {
            self.lost_count += 1;
            return None;
        };
        self.found_count += 1;
        self.square_m2 += off_m.powi(2);
        Some(id)
    }
}

/// A detection. It has a heading if the agents have one.
fn detected(agent_type: AgentType, id: u64, x: f64, y: f64, course: f64) -> Detection {
    let at = detected_at(agent_type, id, x, y);
    if agent_type == AgentType::Vehicle { with_heading(at, course) } else { at }
}

/// The detections of a frame: each agent in nine of ten frames, and clutter around the agents.
fn frame(meeting: &Meeting, states: &[[f64; 4]; 2], rng: &mut ChaCha8Rng) -> Vec<Detection> {
    let mut detections = Vec::new();
    for ([x, y, vx, vy], id) in states.iter().zip(1..) {
        let sigma_m = if meeting.agent_type == AgentType::Vehicle { 0.25 } else { 0.15 };
        let (dx, dy) = (noise(rng, sigma_m), noise(rng, sigma_m));
        let course = vy.atan2(*vx) + noise(rng, 0.1);
        if rng.random_bool(0.9) {
            detections.push(detected(meeting.agent_type, id, x + dx, y + dy, course));
        }
        let clutter_count = CLUTTER * (2.0 * CLUTTER_REACH_M).powi(2);
        for _ in 0..clutter_count as usize {
            let mut off = || rng.random_range(-CLUTTER_REACH_M..CLUTTER_REACH_M);
            let (x, y) = (x + off(), y + off());
            detections.push(detected(meeting.agent_type, 0, x, y, rng.random_range(-PI..PI)));
        }
    }
    detections
}

fn meet(meeting: &Meeting, association: Association) -> Outcome {
    let defaults = TrackerOptions::default();
    // The clutter of both agents overlaps.
    let clutter_density = 2.0 * CLUTTER;
    let missed = 1.0 - defaults.detection_probability;
    let miss_cost = -2.0 * (TAU * clutter_density * missed / defaults.detection_probability).ln();
    let options = TrackerOptions { association, clutter_density, miss_cost, ..defaults };
    let mut outcome = Outcome::default();
    for seed in 0..SEEDS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut run = Harness::new(options, 0);
        let mut states = meeting.states(3.0);
        let mut ids = [BTreeSet::new(), BTreeSet::new()];
        for k in 0..FRAMES {
            states.iter_mut().for_each(|state| Meeting::swerve(state, &mut rng));
            let detections = frame(meeting, &states, &mut rng);
            let tracks = run.step(&detections);
            if k < BEGIN {
                continue;
            }
            for (state, ids) in states.iter().zip(&mut ids) {
                let id = outcome.find(tracks, state);
                ids.extend(id.filter(|_| !MEETING.contains(&k)));
            }
        }
        outcome.switched_count += ids.iter().filter(|of| of.len() > 1).count();
        outcome.swapped_count += usize::from(!ids[0].is_disjoint(&ids[1]));
    }
    outcome
}

#[test]
fn jpda_switches_fewer_ids_than_assignment_in_clutter() {
    for meeting in MEETINGS.iter().chain([&OVERTAKING]) {
        let [assigned, joint] =
            [Association::Assignment, Association::Jpda].map(|association| meet(meeting, association));
        for (name, outcome) in [("assigned", &assigned), ("joint", &joint)] {
            println!(
                "{}, {name}: of {} agents {} switched, {} pairs swapped; {} of {} states lost, RMS {:.3} m",
                meeting.name,
                2 * SEEDS,
                outcome.switched_count,
                outcome.swapped_count,
                outcome.lost_count,
                outcome.lost_count + outcome.found_count,
                outcome.rms_m(),
            );
        }
        let name = meeting.name;
        assert!(joint.switched_count < assigned.switched_count, "{name}: {assigned:?} {joint:?}");
        assert!(joint.swapped_count <= assigned.swapped_count, "{name}: {assigned:?} {joint:?}");
        assert!(joint.lost_count * 50 < joint.found_count, "{name}: {assigned:?} {joint:?}");
        // Only the assignment averages over seconds of steady motion.
        assert!(joint.rms_m() < 1.05 * assigned.rms_m(), "{name}: {assigned:?} {joint:?}");
    }
}
