//! Impossible measurements: outliers, jumps, exchanged identities and placeholders.

use std::collections::BTreeSet;

use tracker::{Prior, TrackerOptions};
use wire::{AgentType, Detection, Header, Track, TrackStatus, detection_flags, flags};

use crate::support::harness::{Harness, detected_at};

const TYPES: [(AgentType, f64); 3] =
    [(AgentType::Vehicle, 8.0), (AgentType::Cyclist, 5.0), (AgentType::Pedestrian, 1.4)];
const INTERVALS_MS: [i64; 4] = [80, 100, 200, 500];

/// A tracker of detections with trusted identities, at this interval.
fn trusting(interval_ms: i64) -> Harness {
    let options = TrackerOptions { prior: Prior::Kinematic, ..TrackerOptions::default() };
    let mut run = Harness::new(options, flags::HAS_IDENTITIES);
    run.tick_ns = interval_ms * 1_000_000;
    run
}

/// An agent that moves along x, at this time.
fn along(agent_type: AgentType, speed_mps: f64, k: i64, interval_ms: i64) -> Detection {
    detected_at(agent_type, 1, speed_mps * (k * interval_ms) as f64 / 1e3, 0.0)
}

fn moved(detection: Detection, [x_m, y_m]: [f32; 2]) -> Detection {
    Detection { x_m: detection.x_m + x_m, y_m: detection.y_m + y_m, ..detection }
}

fn speed_mps(track: &Track) -> f64 {
    f64::from(track.vx_mps).hypot(track.vy_mps.into())
}

fn input(run: &Harness) -> [u32; 4] {
    let of = run.tracker.header(&Header::new(1, 0, 0)).input;
    [of.repeated, of.misfits, of.placeholders, of.reassigned]
}

/// Asserts at most one track per identity, and no speed more than one metre per second above the agents' own.
fn assert_possible(tracks: &[Track], most_mps: f64, what: &str) {
    let ids: Vec<u64> = tracks.iter().map(|track| track.source_id).collect();
    assert_eq!(ids.len(), ids.iter().collect::<BTreeSet<_>>().len(), "{what}: {ids:?}");
    for track in tracks {
        assert!(speed_mps(track) < most_mps + 1.0, "{what}: {} m/s", speed_mps(track));
    }
}

#[test]
fn one_outlier_is_a_missed_detection() {
    for (agent_type, speed) in TYPES {
        for interval_ms in INTERVALS_MS {
            for off_m in [12.0, 40.0, -3000.0] {
                let what = format!("{agent_type:?}, {interval_ms} ms, {off_m} m");
                let mut run = trusting(interval_ms);
                for k in 0..20 {
                    let good = along(agent_type, speed, k, interval_ms);
                    let is_off = k == 12;
                    let tracks = run.step(&[if is_off { moved(good, [0.0, off_m]) } else { good }]);
                    if k < 2 {
                        continue;
                    }
                    assert_possible(tracks, speed, &what);
                    let [track] = tracks else { panic!("{what}: {} tracks", tracks.len()) };
                    assert_eq!(track.id, 1, "{what}");
                    assert_eq!(track.status == TrackStatus::Coasting as u32, is_off, "{what}: frame {k}");
                    assert!((track.x_m - good.x_m).abs() < 0.3 && track.y_m.abs() < 0.1, "{what}: {track:?}");
                }
                assert_eq!(input(&run), [0, 1, 0, 0], "{what}");
            }
        }
    }
}

#[test]
fn outliers_that_disagree_are_all_missed() {
    let mut run = trusting(100);
    for k in 0..20 {
        let good = along(AgentType::Pedestrian, 1.4, k, 100);
        let off_m = match k {
            10 => [0.0, 12.0],
            11 => [5.0, -9.0],
            12 => [-20.0, 3.0],
            _ => [0.0; 2],
        };
        let tracks = run.step(&[moved(good, off_m)]);
        if k >= 2 {
            assert_possible(tracks, 1.4, "disagreeing");
            assert!(tracks.len() == 1 && tracks[0].id == 1 && tracks[0].y_m.abs() < 0.1, "{k}: {tracks:?}");
        }
    }
    assert_eq!(input(&run), [0, 3, 0, 0]);
}

#[test]
fn a_jump_of_the_localisation_begins_the_state_again_there() {
    for (agent_type, speed) in TYPES {
        for (interval_ms, jump_m) in [(80, 5.0), (100, 50.0), (200, 50.0), (500, 50.0)] {
            let what = format!("{agent_type:?}, {interval_ms} ms, {jump_m} m");
            let mut run = trusting(interval_ms);
            for k in 0..20 {
                let good = along(agent_type, speed, k, interval_ms);
                let seen = if k < 12 { good } else { moved(good, [0.0, jump_m]) };
                let tracks = run.step(&[seen]);
                if k >= 2 {
                    assert_possible(tracks, speed, &what);
                }
                if k >= 13 {
                    let [track] = tracks else { panic!("{what}: {} tracks at {k}", tracks.len()) };
                    assert!((track.y_m - jump_m).abs() < 0.3 && track.source_id == 1, "{what}: {track:?}");
                }
            }
            assert_eq!(input(&run), [0, 2, 0, 1], "{what}");
        }
    }
}

/// The identity goes to an agent with a different motion.
#[test]
fn an_identity_that_was_handed_on_begins_again_after_three_misfits() {
    for interval_ms in [80, 100, 200] {
        let mut run = trusting(interval_ms);
        for k in 0..24 {
            let t_s = (k * interval_ms) as f64 / 1e3;
            let seen = if k < 12 {
                along(AgentType::Vehicle, 8.0, k, interval_ms)
            } else {
                detected_at(AgentType::Vehicle, 1, -60.0, 30.0 - 11.0 * t_s)
            };
            let tracks = run.step(&[seen]);
            if k >= 2 {
                assert_possible(tracks, 11.0, "handed on");
            }
            if k >= 14 {
                let [track] = tracks else { panic!("{} tracks at {k}", tracks.len()) };
                assert!((track.x_m + 60.0).abs() < 0.3 && (track.vy_mps + 11.0).abs() < 1.0, "{track:?}");
            }
        }
        assert_eq!(input(&run), [0, 3, 0, 1]);
    }
}

#[test]
fn tracks_follow_the_positions_of_exchanged_identities() {
    for (agent_type, speed, apart_m) in [(AgentType::Pedestrian, 1.3, 2.0), (AgentType::Vehicle, 9.0, 3.5)] {
        for interval_ms in INTERVALS_MS {
            let what = format!("{agent_type:?}, {interval_ms} ms");
            let mut run = trusting(interval_ms);
            for k in 0..40 {
                let x_m = speed * ((k - 20) * interval_ms) as f64 / 1e3;
                let ids = if k < 20 { [1, 2] } else { [2, 1] };
                let there = detected_at(agent_type, ids[0], x_m, 0.0);
                let back = detected_at(agent_type, ids[1], -x_m, apart_m);
                let tracks = run.step(&[there, back]);
                if k < 2 {
                    continue;
                }
                assert_possible(tracks, speed, &what);
                let [first, second] = tracks else { panic!("{what}: {} tracks at {k}", tracks.len()) };
                assert_eq!([first.source_id, second.source_id], ids, "{what}: frame {k}");
                assert!(first.y_m.abs() < 0.1 && (first.x_m - there.x_m).abs() < 0.2, "{what}: {first:?}");
            }
            assert_eq!(input(&run), [0, 0, 0, 2], "{what}");
        }
    }
}

#[test]
fn placeholders_are_no_measurements() {
    for place in [[0.0_f32, 0.0], [-1.0, -1.0], [9999.0, 9999.0], [417.25, 31.5]] {
        let mut run = trusting(100);
        for k in 0..60 {
            let cars = [1, 2].map(|id| detected_at(AgentType::Vehicle, id, 50.0 + k as f64, 9.0 * id as f64));
            // Three of ten frames miss one agent, and one of ten misses the other.
            let is_missing = [k % 10 >= 7 && k >= 10, k % 10 == 9 && k >= 10];
            let mut seen = cars;
            for (detection, is_missing) in seen.iter_mut().zip(is_missing) {
                if is_missing {
                    [detection.x_m, detection.y_m] = place;
                }
            }
            let tracks = run.step(&seen);
            if k < 2 {
                continue;
            }
            assert_possible(tracks, 10.0, "placeholders");
            assert_eq!(tracks.len(), 2, "{place:?}: frame {k}");
            for ((track, car), is_missing) in tracks.iter().zip(cars).zip(is_missing) {
                assert_eq!((track.id, track.source_id), (car.id, car.id), "{place:?}");
                assert_eq!(track.status == TrackStatus::Coasting as u32, is_missing, "{place:?}: frame {k}");
                assert!((track.x_m - car.x_m).abs() < 0.3, "{place:?}: {track:?}");
            }
        }
        let [repeated, misfits, placeholders, reassigned] = input(&run);
        assert_eq!((repeated, misfits + placeholders, reassigned), (0, 20, 0), "{place:?}");
        assert!(placeholders >= 17, "{place:?}: {placeholders}");
    }
}

#[test]
fn placeholders_among_the_first_detections_give_no_speed() {
    for place in [[0.0_f32, 0.0], [-1.0, -1.0], [1.0, 1.0], [9999.0, 9999.0]] {
        for (agent_type, speed) in TYPES {
            // The first three frames, the first alone, the second, the third, and every fourth.
            let patterns: [fn(i64) -> bool; 5] =
                [|k| k < 3, |k| k == 0, |k| k == 1, |k| k == 2, |k| k % 4 == 0];
            for (interval_ms, (pattern, is_missing)) in
                [100, 500].into_iter().flat_map(|ms| patterns.iter().enumerate().map(move |of| (ms, of)))
            {
                let what = format!("{place:?}, {agent_type:?}, {interval_ms} ms, pattern {pattern}");
                let mut run = trusting(interval_ms);
                for k in 0..24 {
                    let off_m = if interval_ms == 100 { [3.0, 4.0] } else { [9.0, 12.0] };
                    let good = moved(along(agent_type, speed, k, interval_ms), off_m);
                    let missing = Detection { x_m: place[0], y_m: place[1], ..good };
                    let tracks = run.step(&[if is_missing(k) { missing } else { good }]);
                    assert_possible(tracks, speed, &what);
                    if k < 5 {
                        continue;
                    }
                    let [track] = tracks else { panic!("{what}: frame {k}: {} tracks", tracks.len()) };
                    assert!((track.x_m - good.x_m).abs() < 0.3, "{what}: frame {k}: {track:?}");
                }
            }
        }
    }
}

/// An agent may drive through the origin, or begin there, if the user chooses it so.
#[test]
fn an_agent_may_begin_at_the_origin() {
    for (agent_type, speed) in TYPES {
        for interval_ms in INTERVALS_MS {
            for first in [0, -1, -2] {
                let mut run = trusting(interval_ms);
                for k in 0..6 {
                    let good = along(agent_type, speed, k + first, interval_ms);
                    let tracks = run.step(&[good]);
                    assert_possible(tracks, speed, "the origin");
                    assert_eq!(
                        tracks.len(),
                        usize::from(k > 0),
                        "{agent_type:?}, {interval_ms} ms: frame {k}"
                    );
                }
                assert_eq!(input(&run), [0; 4], "{agent_type:?}, {interval_ms} ms");
            }
        }
    }
}

#[test]
fn an_agent_at_rest_is_tracked_wherever_it_is() {
    for place in [[0.0_f64, 0.0], [-1.0, -1.0], [7.5, 3.0]] {
        let mut run = trusting(100);
        for k in 0..60 {
            let parked = detected_at(AgentType::Vehicle, 1, place[0], place[1]);
            // Another agent is sent as 0,0 when it is missing.
            let x_m = 30.0 + k as f64;
            let moving = detected_at(AgentType::Vehicle, 2, x_m, 9.0);
            let missing = detected_at(AgentType::Vehicle, 2, 0.0, 0.0);
            let tracks = run.step(&[parked, if k % 10 == 9 { missing } else { moving }]);
            if k >= 5 {
                assert_eq!(tracks.len(), 2, "{place:?}: frame {k}");
                assert_eq!(
                    (tracks[0].id, tracks[0].status),
                    (1, TrackStatus::Confirmed as u32),
                    "{place:?}: {k}"
                );
                assert!(speed_mps(&tracks[0]) < 0.01 && (tracks[1].x_m - x_m as f32).abs() < 0.3);
            }
        }
    }
}

/// Agents that were not seen yet are listed at 0,0.
#[test]
fn identities_that_share_a_marked_position_start_no_track() {
    let mut run = trusting(100);
    for k in 0..30_u32 {
        let seen = [1, 2, 3].map(|id| {
            let is_there = k >= 5 * id as u32;
            let (x_m, y_m) = if is_there { (20.0 + 0.1 * f64::from(k), 6.0 * id as f64) } else { (0.0, 0.0) };
            detected_at(AgentType::Pedestrian, id, x_m, y_m)
        });
        let tracks = run.step(&seen);
        assert_possible(tracks, 1.0, "shared");
        assert!(tracks.iter().all(|track| track.x_m > 10.0), "{tracks:?}");
        assert_eq!(tracks.len(), [1, 2, 3].iter().filter(|id| k > 5 * **id).count(), "frame {k}");
    }
}

#[test]
fn no_track_is_faster_than_its_type() {
    for (agent_type, most_mps) in
        [(AgentType::Vehicle, 70.0), (AgentType::Cyclist, 25.0), (AgentType::Pedestrian, 12.0)]
    {
        for identities in [0, flags::HAS_IDENTITIES] {
            let mut run = trusting(100);
            run.flags = identities;
            for k in 0..40 {
                // The agent accelerates all the time.
                let t_s = 0.1 * f64::from(k);
                let mut seen = detected_at(agent_type, 1, 15.0 * t_s * t_s, 0.0);
                seen.sigma_m = 0.5;
                for track in run.step(&[seen]) {
                    assert!(speed_mps(track) <= most_mps, "{agent_type:?}: {} m/s", speed_mps(track));
                }
            }
        }
        // An impossible reported speed is unknown.
        let mut run = trusting(100);
        for k in 0..20 {
            let mut seen = along(agent_type, 2.0, k, 100);
            seen.flags |= detection_flags::HAS_SPEED | detection_flags::HAS_HEADING;
            seen.speed_mps = if k == 10 { most_mps as f32 + 1.0 } else { 2.0 };
            let tracks = run.step(&[seen]);
            assert!(tracks[0].status != TrackStatus::Coasting as u32, "{agent_type:?}: {k}");
            assert_possible(tracks, 2.0, "reported");
        }
    }
}

#[test]
fn an_identity_names_one_track_without_trust_too() {
    let options = TrackerOptions { associate: true, prior: Prior::Kinematic, ..TrackerOptions::default() };
    let mut run = Harness::new(options, flags::HAS_IDENTITIES);
    for k in 0..60 {
        let good = along(AgentType::Vehicle, 8.0, k, 80);
        let tracks = run.step(&[if k < 30 { good } else { moved(good, [0.0, 50.0]) }]);
        let named: Vec<u64> = tracks.iter().map(|track| track.source_id).filter(|id| *id != 0).collect();
        assert_eq!(named.len(), usize::from(k >= 2), "frame {k}: {named:?}");
    }
}
