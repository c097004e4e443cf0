//! Detections whose reported speeds or headings contradict their positions.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tracker::TrackerOptions;
use wire::{AgentType, Detection, Track, detection_flags, flags};

use crate::support::harness::{Harness, detected_at, noise, with_heading};

const AGENTS: u64 = 6;
const FRAMES: usize = 120;
/// Frames until every agent is published with its velocity.
const SETTLED: usize = 30;
const TICK_S: f64 = 0.1;

/// The true motion of an agent: its course and a speed.
fn course_rad(id: u64) -> f64 {
    TAU * id as f64 / AGENTS as f64 + 0.5
}

fn at_m(id: u64, speed_mps: f64, time_s: f64) -> [f64; 2] {
    let (sin, cos) = course_rad(id).sin_cos();
    let way_m = speed_mps * time_s;
    [150.0 * id as f64 + way_m * cos, way_m * sin]
}

/// Plays agents that drive straight. `write` gives the heading and the speed that the detector reports.
fn play(
    (agent_type, speed_mps): (AgentType, f64),
    (identities, sigma_m): (u32, f64),
    write: impl Fn(u64, f64, &mut ChaCha8Rng) -> (f64, f64),
) -> Vec<Vec<Track>> {
    let mut run = Harness::new(TrackerOptions::default(), identities);
    run.tick_ns = 100_000_000;
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let frame = |frame: usize| -> Vec<Track> {
        let time_s = frame as f64 * TICK_S;
        let detected = |id: u64| {
            let [x_m, y_m] = at_m(id, speed_mps, time_s).map(|x| x + noise(&mut rng, sigma_m));
            let (heading_rad, reported_mps) = write(id, time_s, &mut rng);
            let found = with_heading(detected_at(agent_type, id, x_m, y_m), heading_rad);
            let flags = found.flags | detection_flags::HAS_SPEED;
            Detection { speed_mps: reported_mps as f32, flags, ..found }
        };
        run.step(&(0..AGENTS).map(detected).collect::<Vec<_>>()).to_vec()
    };
    (0..FRAMES).map(frame).collect()
}

/// Asserts that all agents are published, each with its velocity, and returns the largest error of a heading.
fn assert_velocities(frames: &[Vec<Track>], speed_mps: f64, from: usize, most_mps: f64, case: &str) -> f64 {
    let mut most_rad = 0.0_f64;
    for (frame, tracks) in frames.iter().enumerate().skip(from) {
        assert_eq!(tracks.len(), AGENTS as usize, "{case}: frame {frame}");
        for track in tracks {
            let off_m = |id: u64| {
                let [x_m, y_m] = at_m(id, speed_mps, frame as f64 * TICK_S);
                (f64::from(track.x_m) - x_m).hypot(f64::from(track.y_m) - y_m)
            };
            let id = (0..AGENTS).min_by(|&a, &b| off_m(a).total_cmp(&off_m(b))).expect("agents");
            let (sin, cos) = course_rad(id).sin_cos();
            let off_mps =
                (f64::from(track.vx_mps) - speed_mps * cos).hypot(f64::from(track.vy_mps) - speed_mps * sin);
            assert!(off_mps < most_mps, "{case}: frame {frame}, agent {id}: {off_mps:.2} m/s off");
            let turned_rad = filters::wrapped(f64::from(track.heading_rad) - course_rad(id)).abs();
            most_rad = most_rad.max(turned_rad);
        }
    }
    most_rad
}

/// What a detector reports: heading and speed of an agent, from its true values.
type Report = fn(u64, f64, f64, &mut ChaCha8Rng) -> (f64, f64);

#[test]
fn positions_decide_if_reports_contradict_them() {
    let reports: [(&str, Report); 9] = [
        ("speeds of 0", |id, _, _, _| (course_rad(id), 0.0)),
        ("headings of 0", |_, _, speed_mps, _| (0.0, speed_mps)),
        ("zeros", |_, _, _, _| (0.0, 0.0)),
        ("half a turn off", |id, _, speed_mps, _| (course_rad(id) + PI, speed_mps)),
        ("one half a turn off", |id, _, speed_mps, _| {
            (course_rad(id) + if id == 1 { PI } else { 0.0 }, speed_mps)
        }),
        ("half a turn off from 5 s on", |id, time_s, speed_mps, _| {
            (course_rad(id) + if time_s > 5.0 { PI } else { 0.0 }, speed_mps)
        }),
        ("front and rear by chance", |id, _, speed_mps, rng| {
            (course_rad(id) + if rng.random::<bool>() { PI } else { 0.0 }, speed_mps)
        }),
        ("km/h", |id, _, speed_mps, _| (course_rad(id), 3.6 * speed_mps)),
        ("clockwise from north", |id, _, speed_mps, _| (FRAC_PI_2 - course_rad(id), speed_mps)),
    ];
    for (name, report) in reports {
        for moving in [(AgentType::Vehicle, 9.0), (AgentType::Cyclist, 7.0)] {
            for identities in [flags::HAS_IDENTITIES, 0] {
                for sigma_m in [0.02, 0.15] {
                    let case = format!("{name}: {moving:?}, identities {identities}, {sigma_m} m");
                    let frames = play(moving, (identities, sigma_m), |id, time_s, rng| {
                        report(id, time_s, moving.1, rng)
                    });
                    let most_rad = assert_velocities(&frames, moving.1, SETTLED, 1.5, &case);
                    assert!(most_rad < 0.4, "{case}: a heading is {most_rad:.2} rad off");
                }
            }
        }
    }
}

#[test]
fn a_walker_with_speeds_of_0_walks() {
    for identities in [flags::HAS_IDENTITIES, 0] {
        for sigma_m in [0.02, 0.15] {
            let frames =
                play((AgentType::Pedestrian, 1.3), (identities, sigma_m), |id, _, _| (course_rad(id), 0.0));
            let case = format!("identities {identities}, {sigma_m} m");
            // A chord of three seconds is longer than the noise.
            assert_velocities(&frames, 1.3, 60, 0.7, &case);
        }
    }
}
