//! The tracker on real recordings, if they are available, and on generated ones.

use std::collections::{BTreeMap, BTreeSet};

use bytemuck::Zeroable;
use data::{Frame, GeneratedScene, Recording, SceneOptions};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use testing::public_recording;
use tracker::{Tracker, TrackerOptions};
use wire::{AGENTS_MAX, AgentType, Header, Track, detection_flags, flags};

/// The recording at `path` in the folder of recordings. Prints a note and returns `None` if there is none.
fn recording(path: &str) -> Option<Recording> {
    let path = public_recording(path)?;
    Some(data::open(&path, None).expect("a readable recording"))
}

/// Tracks a recording and passes each frame with its tracks to `show`.
fn track(recording: &Recording, options: TrackerOptions, mut show: impl FnMut(&Frame, &[Track])) {
    let mut tracker = Tracker::new(options);
    let mut out = vec![Track::zeroed(); AGENTS_MAX];
    let identities = if recording.has_identities { flags::HAS_IDENTITIES } else { 0 };
    for (frame, seq) in recording.frames.iter().zip(0..) {
        let from_ego = if frame.ego.is_sensor { flags::SEEN_FROM_EGO } else { 0 };
        let header = Header {
            flags: identities | from_ego,
            observed_types: frame.observed_types,
            interval_ns: recording.interval_ns,
            ego_m: frame.ego.position_m,
            ..Header::new(1, seq, frame.stamp_ns)
        };
        let tracked = tracker.step(&header, &frame.detections, None, &mut out).expect("a good frame");
        assert_eq!(tracked.fault_count, 0);
        for track in &out[..tracked.track_count] {
            track.check().expect("a track fit for the wire");
        }
        show(frame, &out[..tracked.track_count]);
    }
}

/// Root mean square of the added values.
#[derive(Debug, Default)]
struct Rms {
    sum: f64,
    len: usize,
}

impl Rms {
    fn add(&mut self, error: f64) {
        self.sum += error * error;
        self.len += 1;
    }

    fn value(&self) -> f64 {
        (self.sum / self.len.max(1) as f64).sqrt()
    }
}

/// Track of each agent, and the number of identity switches.
#[derive(Debug, Default)]
struct Identities {
    track_of: BTreeMap<u64, u64>,
    switch_count: usize,
}

impl Identities {
    fn add(&mut self, agent: u64, track: u64) {
        let before = self.track_of.insert(agent, track);
        self.switch_count += usize::from(before.is_some_and(|before| before != track));
    }
}

/// Asserts that every agent with two detections is published under its identity. Also asserts that the
/// filtered velocity predicts the agent's position better than the recording's velocity.
fn assert_follows_identities(path: &str, agent_type: AgentType) {
    let Some(recording) = recording(path) else { return };
    let ahead_ns = 800_000_000;
    let mut positions = BTreeMap::new();
    let mut seen_count: BTreeMap<u64, usize> = BTreeMap::new();
    for frame in &recording.frames {
        for d in &frame.detections {
            positions.insert((d.id, frame.stamp_ns), (f64::from(d.x_m), f64::from(d.y_m)));
            *seen_count.entry(d.id).or_default() += 1;
        }
    }
    let mut published: BTreeSet<u64> = BTreeSet::new();
    let (mut position, mut filtered, mut recorded) = (Rms::default(), Rms::default(), Rms::default());
    track(&recording, TrackerOptions::default(), |frame, tracks| {
        published.extend(tracks.iter().map(|t| t.source_id));
        for d in frame.detections.iter().filter(|d| d.agent_type == agent_type as u32) {
            let Some(t) = tracks.iter().find(|t| t.source_id == d.id) else { continue };
            let (x, y) = (f64::from(d.x_m), f64::from(d.y_m));
            position.add((f64::from(t.x_m) - x).hypot(f64::from(t.y_m) - y));
            let before = positions.get(&(d.id, frame.stamp_ns - 400_000_000));
            let after = positions.get(&(d.id, frame.stamp_ns + ahead_ns));
            let (Some(before), Some(after)) = (before, after) else { continue };
            let forecast = |rms: &mut Rms, x: f64, y: f64, vx: f64, vy: f64| {
                let ahead_s = ahead_ns as f64 / 1e9;
                rms.add((x + vx * ahead_s - after.0).hypot(y + vy * ahead_s - after.1));
            };
            forecast(&mut filtered, t.x_m.into(), t.y_m.into(), t.vx_mps.into(), t.vy_mps.into());
            if d.has(detection_flags::HAS_SPEED) {
                let (sin, cos) = f64::from(d.heading_rad).sin_cos();
                let speed_mps = f64::from(d.speed_mps);
                forecast(&mut recorded, x, y, speed_mps * cos, speed_mps * sin);
            } else {
                forecast(&mut recorded, x, y, (x - before.0) / 0.4, (y - before.1) / 0.4);
            }
        }
    });
    let missing = seen_count.iter().filter(|&(id, &len)| len > 1 && !published.contains(id)).count();
    println!(
        "{path}: {} agents, {missing} unpublished; position {:.4} m off; 0.8 s on at the filtered velocity {:.4} m, \
         at the recording's {:.4} m",
        seen_count.len(),
        position.value(),
        filtered.value(),
        recorded.value()
    );
    assert_eq!(missing, 0);
    assert!(filtered.len > 100);
    assert!(position.value() < 0.05 && filtered.value() < 1.02 * recorded.value());
}

#[test]
fn interaction_is_tracked_by_its_identities() {
    let folder = "interaction/recorded_trackfiles";
    assert_follows_identities(
        &format!("{folder}/DR_USA_Intersection_GL/vehicle_tracks_000.csv"),
        AgentType::Vehicle,
    );
    assert_follows_identities(
        &format!("{folder}/DR_USA_Roundabout_SR/vehicle_tracks_000.csv"),
        AgentType::Pedestrian,
    );
}

#[test]
fn pedestrians_at_2_5_hz_are_tracked() {
    assert_follows_identities("eth_ucy/raw/biwi_hotel.txt", AgentType::Pedestrian);
}

/// Adds noise of 0.2 m to the positions.
#[test]
fn filtering_reduces_noise_by_a_quarter() {
    let path = "interaction/recorded_trackfiles/DR_USA_Intersection_GL/vehicle_tracks_000.csv";
    let Some(mut recording) = recording(path) else { return };
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let sigma_m = 0.2_f32;
    let noise = Normal::new(0.0, sigma_m).expect("a finite sigma");
    let mut truth = BTreeMap::new();
    recording.has_identities = false;
    recording.frames.truncate(600);
    for frame in &mut recording.frames {
        for d in &mut frame.detections {
            truth.insert((frame.stamp_ns, d.id), (f64::from(d.x_m), f64::from(d.y_m)));
            d.x_m += noise.sample(&mut rng);
            d.y_m += noise.sample(&mut rng);
            d.sigma_m = sigma_m;
            d.flags &= !detection_flags::HAS_SPEED;
        }
    }
    let (mut raw, mut filtered, mut identities) = (Rms::default(), Rms::default(), Identities::default());
    track(&recording, TrackerOptions::default(), |frame, tracks| {
        for d in &frame.detections {
            let (x, y) = truth[&(frame.stamp_ns, d.id)];
            let Some(t) = tracks.iter().find(|t| t.source_id == d.id && t.unseen_ns == 0) else { continue };
            raw.add((f64::from(d.x_m) - x).hypot(f64::from(d.y_m) - y));
            filtered.add((f64::from(t.x_m) - x).hypot(f64::from(t.y_m) - y));
            identities.add(d.id, t.id);
        }
    });
    let (raw_m, filtered_m) = (raw.value(), filtered.value());
    println!("{path}: raw {raw_m:.3} m, filtered {filtered_m:.3} m, {identities:?}");
    assert!(raw.len > 5_000 && filtered_m < 0.75 * raw_m);
    assert!(identities.switch_count * 1_000 < raw.len, "{identities:?}");
}

/// How well tracks within 2 m follow the true agents.
#[derive(Debug, Default)]
struct Followed {
    truths_len: usize,
    found_count: usize,
    track_count: usize,
    /// Errors of detections and tracks, in frames that detected the agent.
    raw: Rms,
    filtered: Rms,
    identities: Identities,
}

/// Compares tracks with the truth like CLEAR-MOT: an agent keeps its track as long as the track is near.
fn follow(recording: &Recording, types: u32) -> Followed {
    let mut followed = Followed::default();
    track(recording, TrackerOptions::default(), |frame, tracks| {
        followed.track_count += tracks.len();
        let mut claimed = BTreeSet::new();
        for kept in [true, false] {
            for truth in frame.truth.iter().filter(|t| types & 1 << t.agent_type != 0) {
                let before = followed.identities.track_of.get(&truth.id).copied();
                let distance =
                    |x_m: f32, y_m: f32| f64::from(x_m - truth.x_m).hypot(f64::from(y_m - truth.y_m));
                let near = |t: &&Track| distance(t.x_m, t.y_m) < 2.0;
                let own = tracks.iter().filter(near).find(|t| Some(t.id) == before);
                if kept != own.is_some() {
                    continue;
                }
                followed.truths_len += 1;
                let free = tracks.iter().filter(near).filter(|t| !claimed.contains(&t.id));
                let nearest = free.min_by(|a, b| distance(a.x_m, a.y_m).total_cmp(&distance(b.x_m, b.y_m)));
                let Some(found) = own.or(nearest) else { continue };
                claimed.insert(found.id);
                followed.found_count += 1;
                followed.identities.add(truth.id, found.id);
                let detected = frame.detections.iter().map(|d| distance(d.x_m, d.y_m));
                let nearest = detected.filter(|&d| d < 2.0).min_by(f64::total_cmp);
                if let Some(raw) = nearest.filter(|_| found.unseen_ns == 0) {
                    followed.raw.add(raw);
                    followed.filtered.add(distance(found.x_m, found.y_m));
                }
            }
        }
    });
    println!(
        "{}: {} of {} found by {} tracks, {} switches, raw {:.3} m, filtered {:.3} m",
        recording.name,
        followed.found_count,
        followed.truths_len,
        followed.track_count,
        followed.identities.switch_count,
        followed.raw.value(),
        followed.filtered.value()
    );
    followed
}

#[test]
fn a_detectors_output_is_tracked() {
    let Some(recording) = recording("kitti_tracking/detection/Car/0000.txt") else { return };
    let followed = follow(&recording, AgentType::Vehicle.bit());
    assert!(followed.found_count * 10 > followed.truths_len * 9);
    assert!(followed.identities.switch_count * 100 < followed.found_count);
}

/// Occlusion, misses, clutter and flipped headings at an intersection with 32 agents.
#[test]
fn a_generated_intersection_is_tracked() {
    for seed in [1, 2, 3] {
        let options = SceneOptions { seed, yaw_flip_probability: 0.3, ..SceneOptions::default() };
        let scene = GeneratedScene::new(options).expect("good options");
        let recording = scene.recording(750);
        let all = follow(&recording, 0b111);
        assert!(all.found_count * 100 > all.truths_len * 85);
        assert!(all.track_count * 100 < all.truths_len * 115, "too many false tracks");
        assert!(all.identities.switch_count * 200 < all.found_count);
        // Pedestrians walk within 2 m of each other, so a neighbour's track would count for a hidden
        // pedestrian.
        let vehicles_and_cyclists = follow(&recording, AgentType::Vehicle.bit() | AgentType::Cyclist.bit());
        assert!(vehicles_and_cyclists.filtered.value() < 0.8 * vehicles_and_cyclists.raw.value());
    }
}
