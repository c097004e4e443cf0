//! Out-of-sequence frames: rollback and replay give the same result as the frames in sequence.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_3;

use bytemuck::Zeroable;
use filters::wrapped;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tracker::{Prior, Tally, TrackerOptions};
use wire::{
    AGENT_TYPES, AgentType, Detection, Forecast, Header, HistoryState, InputCounts, Quality, Rejected,
    Steering, Track, flags,
};

use crate::support::forecaster::{HORIZON_LEN, STEP_NS, forecast, forecasts_header};
use crate::support::harness::{Harness, TICK_NS, detected_at, noise, with_heading, without_smoothing};

/// Largest number of frames that may be newer than an out-of-sequence frame.
const LAG_MAX: usize = 8;
const FIRST_NS: i64 = 1_000_000_000;

fn stamp_ns(frame: usize) -> i64 {
    FIRST_NS + frame as i64 * TICK_NS
}

/// Agents on separate circles that appear, disappear and are missed. Some detections have a wrong type, and
/// some are clutter.
struct Scene {
    frames: Vec<Vec<Detection>>,
}

impl Scene {
    fn new(seed: u64, frames_len: usize, agents_len: usize, coming: bool) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let spans: Vec<(usize, usize)> = (0..agents_len)
            .map(|_| {
                let from = if coming { rng.random_range(0..frames_len / 2) } else { 0 };
                (from, if coming { from + rng.random_range(20..frames_len) } else { frames_len })
            })
            .collect();
        let frames = (0..frames_len)
            .map(|k| {
                let mut detections = Vec::new();
                for (agent, &(from, to)) in spans.iter().enumerate() {
                    if (from..to).contains(&k) && rng.random_ratio(9, 10) {
                        detections.push(Self::detection(agent, k, &mut rng));
                    }
                }
                if coming && rng.random_ratio(1, 3) {
                    let (x, y) = (rng.random_range(-30.0..30.0), rng.random_range(-30.0..30.0));
                    detections.push(detected_at(AgentType::Pedestrian, 1_000 + k as u64, x, y));
                }
                detections
            })
            .collect();
        Self { frames }
    }

    /// Position and heading of an agent.
    fn pose(agent: usize, frame: usize) -> [f64; 3] {
        let (phase, time_s) = (agent as f64, frame as f64 * 0.08);
        let speed_mps = [6.0, 4.0, 1.3][agent % 3];
        let (turn_rate, course) = (0.3, phase + 0.3 * time_s);
        let (sin, cos) = course.sin_cos();
        let (x, y) = (7.0 * (phase % 4.0), 7.0 * (phase / 4.0).floor());
        [x + speed_mps / turn_rate * sin, y - speed_mps / turn_rate * cos, wrapped(course)]
    }

    fn detection(agent: usize, frame: usize, rng: &mut ChaCha8Rng) -> Detection {
        let [x, y, course] = Self::pose(agent, frame);
        let agent_type = AGENT_TYPES[if rng.random_ratio(1, 20) { 0 } else { agent % 3 }];
        let at = detected_at(agent_type, agent as u64 + 1, x + noise(rng, 0.1), y + noise(rng, 0.1));
        if agent.is_multiple_of(3) { with_heading(at, course + noise(rng, 0.05)) } else { at }
    }
}

/// The frames in an order in which at most [`LAG_MAX`] newer frames precede each.
fn shuffled(frames_len: usize, in_order: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let mut due: Vec<(usize, usize)> = (0..frames_len)
        .map(|frame| {
            let late = frame >= in_order && rng.random_ratio(1, 4);
            (frame + if late { rng.random_range(1..=LAG_MAX) } else { 0 }, frame)
        })
        .collect();
    due.sort_unstable_by_key(|&(due, frame)| (due, std::cmp::Reverse(frame)));
    due.into_iter().map(|(_, frame)| frame).collect()
}

/// Forecasts of each published agent, by the controls of its true circle or by none.
fn forecasts(frame: usize, tracks: &[Track]) -> (Header, Vec<Forecast>) {
    let made: Vec<Forecast> = tracks
        .iter()
        .filter(|track| track.source_id > 0)
        .map(|track| {
            let agent = track.source_id as usize - 1;
            let bicycle = track.state_len == 5;
            let step = if bicycle { [0.3, 0.002] } else { [0.05, 0.02] };
            let steering = if bicycle { Steering::Bicycle } else { Steering::Displacement };
            let modes = [(0.5, [step; HORIZON_LEN]), (0.3, [[0.0; 2]; HORIZON_LEN])];
            let frame_heading_rad = Scene::pose(agent, frame)[2] as f32;
            Forecast { frame_heading_rad, ..forecast(track, steering, &modes) }
        })
        .collect();
    (forecasts_header(stamp_ns(frame), made.len()), made)
}

/// A track without the parts that depend on previously published tracks: the history, and the rate-limited
/// heading. The velocity has the heading of the state.
fn estimate(track: &Track) -> Track {
    Track { history: Track::zeroed().history, forecastable: 0, heading_rad: 0.0, ..*track }
}

/// Result of all frames in some order: tracks by frame, if any were published.
struct Delivered {
    run: Harness,
    tracks: BTreeMap<usize, Vec<Track>>,
    /// Frames that were published after all earlier frames had arrived.
    settled: Vec<usize>,
}

/// Delivers a scene in this order. Forecasts belong to the tracks published at frame [`IN_ORDER`], so they
/// are the same in any order.
fn deliver(scene: &Scene, order: &[usize], options: TrackerOptions, identities: u32) -> Delivered {
    let mut run = Harness::new(options, identities);
    let mut delivered = vec![false; scene.frames.len()];
    let (mut tracks, mut settled) = (BTreeMap::new(), Vec::new());
    let mut known: Vec<Track> = Vec::new();
    for &frame in order {
        run.stamp_ns = stamp_ns(frame) - TICK_NS;
        if options.prior == Prior::Learned && frame > IN_ORDER {
            run.prior = Some(forecasts(frame - 1, &known));
        }
        let tracked = run.try_step(&scene.frames[frame]).expect("a good frame");
        delivered[frame] = true;
        if tracked.replayed_count > 0 {
            assert_eq!(run.published().len(), 0, "tracks of an out-of-sequence frame");
            continue;
        }
        if delivered[..frame].iter().all(|&delivered| delivered) {
            settled.push(frame);
        }
        tracks.insert(frame, run.published().to_vec());
        if frame == IN_ORDER {
            known = run.published().to_vec();
        }
    }
    Delivered { run, tracks, settled }
}

/// The first frames arrive in sequence if forecasts are the prior, because the forecasts belong to their
/// tracks.
const IN_ORDER: usize = 20;

#[test]
fn frames_in_any_order_give_the_same_estimates_to_the_bit() {
    let (mut compared_count, mut late_count, mut learned_count) = (0, 0, 0);
    for seed in 0..60 {
        for (prior, identities) in [
            (Prior::Kinematic, 0),
            (Prior::Kinematic, flags::HAS_IDENTITIES),
            (Prior::Kinematic, flags::SEEN_FROM_EGO),
            (Prior::Learned, 0),
            (Prior::Learned, flags::HAS_IDENTITIES),
        ] {
            let options = TrackerOptions { prior, ..TrackerOptions::default() };
            let learned = prior == Prior::Learned;
            let scene = Scene::new(seed, 120, 9, !learned);
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let order = shuffled(120, if learned { IN_ORDER + 1 } else { 0 }, &mut rng);
            let straight: Vec<usize> = (0..120).collect();
            let straight = deliver(&scene, &straight, options, identities);
            let late = deliver(&scene, &order, options, identities);
            late_count += late.run.tracker.tally().out_of_sequence_count;
            let mut ids = [BTreeMap::new(), BTreeMap::new()];
            for frame in late.settled {
                // Births are the same in any order. Ids are the same only if no birth is out of sequence.
                let mut pair = [&straight.tracks[&frame], &late.tracks[&frame]].map(|of| of.clone());
                for tracks in &mut pair {
                    tracks.sort_by_key(|t| (t.born_ns, t.x_m.to_bits(), t.y_m.to_bits()));
                }
                assert_eq!(pair[0].len(), pair[1].len(), "seed {seed}, {prior:?}, frame {frame}");
                for (a, b) in pair[0].iter().zip(&pair[1]) {
                    let named = (*ids[0].entry(b.id).or_insert(a.id), *ids[1].entry(a.id).or_insert(b.id));
                    assert_eq!(named, (a.id, b.id), "seed {seed}, {prior:?}, frame {frame}: another id");
                    assert!(!learned || a.id == b.id);
                    let b = Track { id: a.id, ..*b };
                    assert_eq!(estimate(a), estimate(&b), "seed {seed}, {prior:?}, frame {frame}");
                    compared_count += 1;
                    learned_count += usize::from(a.prior == Quality::Learned as u32);
                }
            }
        }
    }
    println!(
        "{compared_count} tracks after {late_count} out-of-sequence frames are the same, {learned_count} by forecasts"
    );
    assert!(compared_count > 20_000 && late_count > 3_000 && learned_count > 5_000);
}

/// Root mean square error of 20 vehicles' positions. One in three frames arrives up to four frames late and
/// is either replayed or dropped.
fn error_m(seed: u64, replay: bool) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut run = Harness::new(TrackerOptions::default(), 0);
    let mut held_back: Vec<(usize, usize, Vec<Detection>)> = Vec::new();
    let (mut sum, mut len) = (0.0, 0);
    for k in 0..150 {
        let mut frame = Vec::new();
        for agent in (0..60).step_by(3) {
            let [x, y, course] = Scene::pose(agent, k);
            let at = (x + 40.0 * agent as f64 + noise(&mut rng, 0.2), y + noise(&mut rng, 0.2));
            let at = detected_at(AgentType::Vehicle, agent as u64 + 1, at.0, at.1);
            frame.push(with_heading(at, course + noise(&mut rng, 0.1)));
        }
        let due = k + rng.random_range(1..=4);
        if rng.random_ratio(1, 3) {
            held_back.push((due, k, frame));
            continue;
        }
        for (_, late, frame) in held_back.extract_if(.., |(due, ..)| *due <= k) {
            if replay {
                run.stamp_ns = stamp_ns(late) - TICK_NS;
                run.step(&frame);
            }
        }
        run.stamp_ns = stamp_ns(k) - TICK_NS;
        for track in run.step(&frame).iter().filter(|_| k > 20) {
            let agent = track.source_id as usize - 1;
            let [x, y, _] = Scene::pose(agent, k);
            let (dx, dy) = (f64::from(track.x_m) - x - 40.0 * agent as f64, f64::from(track.y_m) - y);
            sum += dx * dx + dy * dy;
            len += 1;
        }
    }
    assert!(len > 1_500, "{len} tracks published");
    (sum / f64::from(len)).sqrt()
}

#[test]
fn replaying_out_of_sequence_frames_reduces_the_error() {
    let (mut replayed_m, mut dropped_m) = (0.0, 0.0);
    for seed in 0..10 {
        let (replayed, dropped) = (error_m(seed, true), error_m(seed, false));
        assert!(replayed < dropped, "seed {seed}: {replayed} m, without these frames {dropped} m");
        replayed_m += replayed / 10.0;
        dropped_m += dropped / 10.0;
    }
    println!("a third of the frames out of sequence: {replayed_m:.4} m, without these {dropped_m:.4} m");
    assert!(replayed_m < 0.97 * dropped_m, "{replayed_m} m, without these frames {dropped_m} m");
}

/// Published states keep their bits in later histories, and no heading jumps.
#[test]
fn out_of_sequence_frames_change_no_published_state() {
    let (mut compared_count, mut turn_count) = (0, 0);
    for seed in 0..20 {
        let scene = Scene::new(seed, 120, 9, true);
        let order = shuffled(120, 0, &mut ChaCha8Rng::seed_from_u64(seed));
        let late = deliver(&scene, &order, without_smoothing(), 0);
        let mut published: BTreeMap<(u64, i64), HistoryState> = BTreeMap::new();
        let mut headings: BTreeMap<u64, f64> = BTreeMap::new();
        for (frame, tracks) in &late.tracks {
            for track in tracks {
                for (step, state) in track.history.iter().rev().enumerate() {
                    let at_ns = stamp_ns(*frame) - step as i64 * STEP_NS as i64;
                    if state.present == 1
                        && let Some(before) = published.insert((track.id, at_ns), *state)
                    {
                        assert_eq!(before, *state, "seed {seed}, track {} at {at_ns} ns", track.id);
                        compared_count += 1;
                    }
                }
                let now = f64::from(track.heading_rad);
                if let Some(before) = headings.insert(track.id, now) {
                    let turn = wrapped(now - before).abs();
                    assert!(turn <= FRAC_PI_3 + 1e-6, "seed {seed}, frame {frame}: turned by {turn}");
                    turn_count += usize::from(turn > 0.5);
                }
            }
        }
    }
    println!("{compared_count} states published again, {turn_count} turns by more than 0.5 rad");
    assert!(compared_count > 10_000 && turn_count > 10, "{compared_count} {turn_count}");
}

/// The first detections of an agent arrive after others have started its track and it was published.
#[test]
fn an_agent_keeps_its_id_when_its_birth_is_out_of_sequence() {
    for identities in [0, flags::HAS_IDENTITIES] {
        let mut run = Harness::new(TrackerOptions::default(), identities);
        let at = |k: usize| with_heading(detected_at(AgentType::Vehicle, 7, 0.6 * k as f64, 3.0), 0.0);
        let mut give = |k: usize, frame: &[Detection]| {
            run.stamp_ns = stamp_ns(k) - TICK_NS;
            run.step(frame).to_vec()
        };
        give(0, &[]);
        let before: Vec<Track> = (3..8).flat_map(|k| give(k, &[at(k)])).collect();
        assert!(before.len() >= 3 && before.iter().all(|track| track.born_ns == stamp_ns(3)));
        assert!(give(2, &[at(2)]).is_empty() && give(1, &[at(1)]).is_empty());
        let after = give(8, &[at(8)]);
        assert_eq!((after.len(), after[0].id, after[0].born_ns), (1, before[0].id, stamp_ns(1)));
    }
}

/// An out-of-sequence detection revives a deleted track under its id.
#[test]
fn an_out_of_sequence_detection_revives_a_deleted_track() {
    let mut run = Harness::new(TrackerOptions::default(), 0);
    let at = |k: usize| detected_at(AgentType::Pedestrian, 7, 0.1 * k as f64, 0.0);
    let mut give = |k: usize, frame: &[Detection]| {
        run.stamp_ns = stamp_ns(k) - TICK_NS;
        run.step(frame).to_vec()
    };
    // Four detections earn coast time for six frames.
    let id = (0..4).flat_map(|k| give(k, &[at(k)])).last().expect("a track").id;
    let ended = (4..16).filter(|&k| k != 9).find(|&k| give(k, &[]).is_empty()).expect("an end");
    assert!((10..=11).contains(&ended), "{ended}");
    assert!(give(9, &[at(9)]).is_empty(), "an out-of-sequence frame is not published");
    let back = give(ended + 1, &[]);
    assert_eq!((back.len(), back[0].id), (1, id));
}

#[test]
fn too_late_and_repeated_frames_are_refused_and_counted() {
    let mut run = Harness::new(TrackerOptions::default(), 0);
    let mut other = Harness::new(TrackerOptions::default(), 0);
    let at = |k: usize| detected_at(AgentType::Pedestrian, 1, k as f64 * 0.1, 0.0);
    let repeated_ns = [0, 5 * TICK_NS, LAG_MAX as i64 * TICK_NS];
    let too_late_ns = [LAG_MAX as i64 * TICK_NS + 1, 2_000_000_000, i64::MAX];
    for k in 0..40 {
        assert_eq!(run.step(&[at(k)]), other.step(&[at(k)]));
        let last_ns = run.stamp_ns;
        for back_ns in repeated_ns.into_iter().chain(too_late_ns).filter(|_| k > LAG_MAX) {
            let stamp_ns = last_ns.saturating_sub(back_ns);
            run.stamp_ns = stamp_ns.saturating_sub(TICK_NS);
            assert_eq!(run.try_step(&[at(0)]), Err(Rejected::NotNewer { stamp_ns, last_ns }));
            assert!(run.published().is_empty(), "the header counts tracks of a refused frame");
        }
        run.stamp_ns = last_ns;
    }
    let refused_count = 3 * (40 - LAG_MAX as u64 - 1);
    let processed =
        Tally { input: InputCounts { detections: 40, ..InputCounts::default() }, ..Tally::default() };
    let tally = Tally { repeated_count: refused_count, too_late_count: refused_count, ..processed };
    assert_eq!((run.tracker.tally(), other.tracker.tally()), (tally, processed));
    // At long intervals few frames are newer, but by a long time.
    run.stamp_ns += 60_000_000_000;
    run.step(&[]);
    run.stamp_ns -= 2 * TICK_NS + 4_800_000_000;
    let refused = run.try_step(&[]);
    assert!(matches!(refused, Err(Rejected::NotNewer { .. })), "{refused:?}");
    assert_eq!(run.tracker.tally().too_late_count, refused_count + 1);
}
