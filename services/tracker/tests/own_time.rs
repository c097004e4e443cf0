//! Detections that were measured at times other than their frame's stamp.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tracker::{Prior, TrackerOptions};
use wire::{AgentType, Detection, Track, flags};

use crate::support::harness::{Harness, detected_at, noise};

const TICK_NS: i64 = 100_000_000;
const SPEEDS_MPS: [f64; 3] = [12.0, -7.0, 1.4];

/// Position of an agent, and its detection with this offset from a frame.
fn detect(agent: usize, frame: i64, offset_ns: i64, rng: &mut ChaCha8Rng, sigma_m: f64) -> Detection {
    let t_s = (frame * TICK_NS + offset_ns) as f64 / 1e9;
    let agent_type = if agent == 2 { AgentType::Pedestrian } else { AgentType::Vehicle };
    let x_m = SPEEDS_MPS[agent] * t_s + noise(rng, sigma_m);
    let y_m = 8.0 * agent as f64 + noise(rng, sigma_m);
    Detection { offset_ns, ..detected_at(agent_type, agent as u64 + 1, x_m, y_m) }
}

fn harness(identities: u32) -> Harness {
    let options = TrackerOptions { prior: Prior::Kinematic, ..TrackerOptions::default() };
    let mut run = Harness::new(options, identities);
    run.tick_ns = TICK_NS;
    run.stamp_ns = -TICK_NS;
    run
}

/// Root mean square errors of position and velocity of the tracks.
fn errors(tracks: &[Track], frame: i64) -> [f64; 2] {
    let mut sum = [0.0; 2];
    for track in tracks {
        let agent = (f64::from(track.y_m) / 8.0).round() as usize;
        let x_m = SPEEDS_MPS[agent] * (frame * TICK_NS) as f64 / 1e9;
        sum[0] += (f64::from(track.x_m) - x_m).powi(2);
        sum[1] += (f64::from(track.vx_mps) - SPEEDS_MPS[agent]).powi(2);
    }
    sum.map(|sum| (sum / tracks.len() as f64).sqrt())
}

#[test]
fn states_are_at_the_stamp_whatever_the_offsets() {
    let patterns: [(&str, [i64; 3]); 5] = [
        ("none", [0, 0, 0]),
        ("early", [-30, -45, -70]),
        ("late", [20, 40, 60]),
        ("both", [-50, 0, 50]),
        ("before the last frame", [-150, -120, -110]),
    ];
    for identities in [0, flags::HAS_IDENTITIES] {
        for (what, offsets_ms) in patterns {
            let (mut run, mut rng) = (harness(identities), ChaCha8Rng::seed_from_u64(5));
            for frame in 0..60 {
                let seen = [0, 1, 2]
                    .map(|agent| detect(agent, frame, offsets_ms[agent] * 1_000_000, &mut rng, 0.02));
                let tracks = run.step(&seen);
                if frame >= 10 {
                    assert_eq!(tracks.len(), 3, "{what}");
                    let [position_m, velocity_mps] = errors(tracks, frame);
                    assert!(
                        position_m < 0.12 && velocity_mps < 0.8,
                        "{what}: {position_m} m, {velocity_mps} m/s"
                    );
                }
            }
        }
    }
}

/// Two sensors see the same agents, 40 ms apart.
#[test]
fn two_sensors_make_one_track_of_an_agent() {
    for identities in [0, flags::HAS_IDENTITIES] {
        let (mut both, mut single) = (0.0, 0.0);
        for seed in 0..10 {
            let (mut run, mut rng) = (harness(identities), ChaCha8Rng::seed_from_u64(seed));
            let mut other = harness(identities);
            for frame in 0..60 {
                let one = [0, 1, 2].map(|agent| detect(agent, frame, -40_000_000, &mut rng, 0.1));
                let two = [2, 1, 0].map(|agent| detect(agent, frame, 0, &mut rng, 0.1));
                let tracked = run.try_step(&[two, one].concat()).expect("a good frame");
                assert_eq!(tracked.duplicate_count, 0);
                assert!(
                    run.published().len() <= 3,
                    "seed {seed}: {} tracks at {frame}",
                    run.published().len()
                );
                other.step(&two);
                if frame >= 10 {
                    assert_eq!(run.published().len(), 3, "seed {seed}: frame {frame}");
                    both += errors(run.published(), frame)[0].powi(2);
                    single += errors(other.published(), frame)[0].powi(2);
                }
            }
        }
        assert!(both < single, "squared errors of two sensors {both}, of one {single}");
    }
}

/// A scan of a slow detector takes most of its period, so each agent has a different own time.
#[test]
fn agents_of_one_scan_are_no_twins() {
    const SPEEDS_MPS: [f64; 5] = [10.0, 8.0, 6.0, 1.4, 1.2];
    for (tick_ms, apart_ms) in [(400, 80), (500, 100), (200, 40), (500, 20)] {
        let (mut run, mut rng) = (harness(0), ChaCha8Rng::seed_from_u64(2));
        run.tick_ns = tick_ms * 1_000_000;
        for frame in 0..30 {
            let seen = [0, 1, 2, 3, 4].map(|agent: usize| {
                let late_ms = apart_ms * agent as i64;
                let is_walking = SPEEDS_MPS[agent] < 2.0;
                let agent_type = if is_walking { AgentType::Pedestrian } else { AgentType::Vehicle };
                let x_m = SPEEDS_MPS[agent] * (frame * tick_ms + late_ms) as f64 / 1e3;
                let (x_m, y_m) = (x_m + noise(&mut rng, 0.03), 6.0 * agent as f64 + noise(&mut rng, 0.03));
                let offset_ns = (late_ms - 4 * apart_ms) * 1_000_000;
                Detection { offset_ns, ..detected_at(agent_type, agent as u64 + 1, x_m, y_m) }
            });
            let tracks = run.step(&seen);
            if frame >= 4 {
                assert_eq!(tracks.len(), 5, "{tick_ms} ms, {apart_ms} ms apart: frame {frame}");
            }
        }
        assert!(run.published().iter().all(|track| track.id <= 5), "{tick_ms} ms: the first tracks");
    }
}

#[test]
fn equal_identities_and_own_times_are_duplicates() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut run = harness(flags::HAS_IDENTITIES);
    for frame in 0..5 {
        let mut at = |offset_ms: i64| detect(0, frame, offset_ms * 1_000_000, &mut rng, 0.0);
        let tracked = run.try_step(&[at(0), at(-50), at(-50), at(0)]).expect("a good frame");
        assert_eq!((tracked.duplicate_count, tracked.track_count), (2, 1));
    }
    let [position_m, velocity_mps] = errors(run.published(), 4);
    assert!(position_m < 0.02 && velocity_mps < 0.2, "{position_m} m, {velocity_mps} m/s");
}
