//! A tracker continues with the published tracks of another one: ids, histories and motion are kept.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tracker::{Predecessor, Tracker, TrackerOptions};
use wire::{AGENT_TYPES, AgentType, Detection, Header, Rejected, Track, flags};

use crate::support::harness::{Harness, detected_at, noise, with_heading, without_smoothing};

const FRAMES: usize = 60;
/// The frame after which another tracker takes over.
const LAST: usize = 39;

/// Nine agents of all types on straight, separate paths. The last agent is not seen in the last ten frames
/// before the take-over.
fn frames(identities: bool) -> Vec<Vec<Detection>> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let of = |frame: usize, rng: &mut ChaCha8Rng| {
        let seen = (0..9).filter(|&agent| agent < 8 || !(LAST - 9..=LAST).contains(&frame));
        let detected = seen.map(|agent: usize| {
            let speed_mps = [8.0, 4.0, 1.4][agent % 3];
            let x = speed_mps * frame as f64 * 0.08 + noise(rng, 0.05);
            let y = 12.0 * agent as f64 + noise(rng, 0.05);
            let at = detected_at(AGENT_TYPES[agent % 3], agent as u64 + 1, x, y);
            if agent.is_multiple_of(3) { with_heading(at, noise(rng, 0.02)) } else { at }
        });
        let mut detections: Vec<Detection> = detected.collect();
        if !identities {
            detections.iter_mut().for_each(|detection| detection.id += 100);
        }
        detections
    };
    (0..FRAMES).map(|frame| of(frame, &mut rng)).collect()
}

/// The header of the newest frame's tracks.
fn header(of: &Harness) -> Header {
    of.tracker.header(&of.header())
}

/// Runs a tracker to the end, and another one that takes over from it after `LAST`. Calls `compare` with the
/// tracks of both in each frame after `LAST`.
fn taken_over(identities: u32, mut compare: impl FnMut(usize, &[Track], &[Track])) {
    let frames = frames(identities != 0);
    let mut before = Harness::new(without_smoothing(), identities);
    let mut predecessor = Predecessor::default();
    for frame in &frames[..=LAST] {
        let tracks = before.step(frame).to_vec();
        predecessor.follow(&header(&before), &tracks);
    }
    let mut after = Harness::new(without_smoothing(), identities);
    after.tracker = Tracker::new(without_smoothing()).with_ids_of(1);
    after.tracker.begin_with(&predecessor);
    after.stamp_ns = before.stamp_ns;
    for (nth, frame) in frames.iter().enumerate().skip(LAST + 1) {
        let expected = before.step(frame).to_vec();
        compare(nth, &expected, after.step(frame));
    }
}

#[test]
fn tracks_keep_ids_histories_and_motion() {
    for identities in [0, flags::HAS_IDENTITIES] {
        taken_over(identities, |frame, expected, tracks| {
            let ids = |tracks: &[Track]| tracks.iter().map(|track| track.id).collect::<Vec<_>>();
            assert_eq!(ids(tracks), ids(expected), "frame {frame}");
            assert!(tracks.len() >= 8, "frame {frame}: {} tracks", tracks.len());
            for (track, expected) in tracks.iter().zip(expected) {
                let apart_m = (track.x_m - expected.x_m).hypot(track.y_m - expected.y_m);
                // The successor learns the noise again.
                assert!(apart_m < 0.15, "frame {frame}: track {} is {apart_m} m off", track.id);
                let of =
                    |track: &Track| (track.agent_type, track.born_ns, track.source_id, track.forecastable);
                assert_eq!(of(track), of(expected), "frame {frame}");
                // Previously published states are never rewritten.
                for (k, (state, expected)) in track.history.iter().zip(&expected.history).enumerate() {
                    assert_eq!(state.present, expected.present, "frame {frame}, step {k}");
                    let back = 5 * (track.history.len() - 1 - k);
                    if frame >= LAST + back {
                        continue;
                    }
                    assert_eq!(state, expected, "frame {frame}: track {}, step {k}", track.id);
                }
            }
        });
    }
}

/// A smoothed history continues as it was last published. Its covariances ended with the tracker before, so it is
/// not smoothed again.
#[test]
fn smoothed_histories_continue() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut frame = |nth: usize| -> Vec<Detection> {
        let place = |id: u64| [0.7 * nth as f64, 20.0 * id as f64].map(|at_m| at_m + noise(&mut rng, 0.2));
        let places = [1, 2, 3].map(place);
        (1..).zip(places).map(|(id, [x, y])| detected_at(AgentType::Vehicle, id, x, y)).collect()
    };
    let mut before = Harness::new(TrackerOptions::default(), flags::HAS_IDENTITIES);
    let mut predecessor = Predecessor::default();
    let mut last = Vec::new();
    for nth in 0..=LAST {
        let tracks = before.step(&frame(nth)).to_vec();
        predecessor.follow(&header(&before), &tracks);
        last = tracks;
    }
    let mut after = Harness::new(TrackerOptions::default(), flags::HAS_IDENTITIES);
    after.tracker = Tracker::new(TrackerOptions::default()).with_ids_of(1);
    after.tracker.begin_with(&predecessor);
    after.stamp_ns = before.stamp_ns;
    for nth in LAST + 1..=LAST + 5 {
        after.step(&frame(nth));
    }
    // Five frames are a step of the history.
    for (track, last) in after.published().iter().zip(&last) {
        let newest = track.history.len() - 1;
        assert_eq!(track.history[..newest], last.history[1..], "track {}", track.id);
    }
}

#[test]
fn a_new_agent_gets_an_id_of_the_new_incarnation() {
    let mut predecessor = Predecessor::default();
    let mut before = Harness::new(TrackerOptions::default(), flags::HAS_IDENTITIES);
    let seen = |agents: u64, frame: u64| -> Vec<Detection> {
        let at = |id| detected_at(AgentType::Vehicle, id, frame as f64, 20.0 * id as f64);
        (1..=agents).map(at).collect()
    };
    for frame in 0..5 {
        let tracks = before.step(&seen(2, frame)).to_vec();
        predecessor.follow(&header(&before), &tracks);
    }
    let mut after = Harness::new(TrackerOptions::default(), flags::HAS_IDENTITIES);
    after.tracker = Tracker::new(TrackerOptions::default()).with_ids_of(1);
    after.tracker.begin_with(&predecessor);
    after.stamp_ns = before.stamp_ns;
    (5..10).for_each(|frame| {
        after.step(&seen(3, frame));
    });
    let ids: Vec<u64> = after.published().iter().map(|track| track.id).collect();
    assert_eq!(ids, [1, 2, (1 << 40) + 1]);
}

#[test]
fn frames_that_the_tracker_before_has_processed_are_refused() {
    let frames = frames(false);
    let mut before = Harness::new(TrackerOptions::default(), 0);
    let mut predecessor = Predecessor::default();
    for frame in &frames[..=LAST] {
        let tracks = before.step(frame).to_vec();
        predecessor.follow(&header(&before), &tracks);
    }
    let mut after = Harness::new(TrackerOptions::default(), 0);
    after.tracker.begin_with(&predecessor);
    after.stamp_ns = before.stamp_ns - after.tick_ns;
    let refused = after.try_step(&frames[LAST]);
    assert!(matches!(refused, Err(Rejected::NotNewer { .. })), "{refused:?}");
    assert!(after.try_step(&frames[LAST + 1]).is_ok(), "the next one is processed");
}

#[test]
fn nothing_is_taken_from_frames_that_are_void_or_impossible() {
    let mut before = Harness::new(TrackerOptions::default(), flags::HAS_IDENTITIES);
    for frame in 0..3 {
        before.step(&[detected_at(AgentType::Cyclist, 4, f64::from(frame), 0.0)]);
    }
    let (good, tracks) = (header(&before), before.published().to_vec());
    let mut predecessor = Predecessor::default();
    predecessor.follow(&Header { flags: flags::VOID, ..good }, &tracks);
    predecessor.follow(&good, &[Track { x_m: f32::NAN, ..tracks[0] }]);
    assert!(predecessor.is_empty());
    predecessor.follow(&good, &tracks);
    assert!(!predecessor.is_empty());
}
