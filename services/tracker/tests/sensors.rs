//! Sensors of different noise, and the motion that is published from their detections.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tracker::TrackerOptions;
use wire::{AgentType, Detection, Rejected, SENSORS_MAX, Track, flags};

use crate::support::harness::{Harness, detected_at, noise};

const AGENTS: u64 = 6;
const FRAMES: usize = 200;
const SEEDS: u64 = 4;
const TICK_S: f64 = 0.08;
const SPEED_MPS: f64 = 9.0;

/// Sensor, from 0, that detects an agent in a frame.
type Turns = fn(usize, u64) -> usize;

/// One sensor detects all agents in even frames, and the other one in odd frames.
const BY_FRAME: Turns = |frame, _| frame % 2;
/// Each agent is detected by its own sensor.
const BY_AGENT: Turns = |_, agent| agent as usize % 2;
/// Each frame has detections of both sensors, and they change places.
const MIXED: Turns = |frame, agent| (frame + agent as usize) % 2;
/// The first sensor has a quarter of the other one's rate.
const SLOW: Turns = |frame, _| usize::from(frame % 4 > 0);

const ALL: [(&str, Turns); 4] =
    [("by frame", BY_FRAME), ("by agent", BY_AGENT), ("mixed", MIXED), ("slow", SLOW)];

/// The tracks of each frame, of vehicles in lanes of their own.
fn play(flags: u32, sigmas_m: [f64; 2], (turns, seed): (Turns, u64), numbers: [u8; 2]) -> Vec<Vec<Track>> {
    let mut run = Harness::new(TrackerOptions::default(), flags);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let frame = |frame: usize| -> Vec<Track> {
        let detections: Vec<Detection> = (1..=AGENTS)
            .map(|id| {
                let sensor = turns(frame, id);
                let [dx, dy] = [(); 2].map(|()| noise(&mut rng, sigmas_m[sensor]));
                let x_m = SPEED_MPS * frame as f64 * TICK_S;
                let detection = detected_at(AgentType::Vehicle, id, x_m + dx, 30.0 * id as f64 + dy);
                Detection { sensor: numbers[sensor], ..detection }
            })
            .collect();
        run.step(&detections).to_vec()
    };
    (0..FRAMES).map(frame).collect()
}

/// Square of the error of a published velocity.
fn off_mps2(track: &Track) -> f64 {
    (f64::from(track.vx_mps) - SPEED_MPS).powi(2) + f64::from(track.vy_mps).powi(2)
}

fn root_mean(squares: &[f64]) -> f64 {
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// Root mean square errors of the published positions and velocities from 4 s on, over several seeds. `numbers`
/// are the numbers of the sensors.
fn errors(flags: u32, sigmas_m: [f64; 2], turns: Turns, numbers: [u8; 2]) -> [f64; 2] {
    let (mut sums, mut count) = ([0.0; 2], 0);
    for seed in 0..SEEDS {
        let frames = play(flags, sigmas_m, (turns, seed), numbers);
        for (frame, tracks) in frames.iter().enumerate().skip(50) {
            for track in tracks {
                let x_m = SPEED_MPS * frame as f64 * TICK_S;
                let lane_m = 30.0 * (f64::from(track.y_m) / 30.0).round();
                sums[0] += (f64::from(track.x_m) - x_m).powi(2) + (f64::from(track.y_m) - lane_m).powi(2);
                sums[1] += (f64::from(track.vx_mps) - SPEED_MPS).powi(2) + f64::from(track.vy_mps).powi(2);
                count += 1;
            }
        }
    }
    sums.map(|sum| (sum / f64::from(count)).sqrt())
}

#[test]
fn the_noise_of_each_sensor_is_learned() {
    // With sensors of 0.1 and 0.3 m, little is gained if an agent has one sensor all the time.
    for (sigmas_m, most_m, most_mps) in [([0.05, 0.5], 0.85, 0.6), ([0.1, 0.3], 0.95, 0.85)] {
        for (name, turns) in ALL {
            for flags in [flags::HAS_IDENTITIES, 0] {
                let [together, apart] =
                    [[0, 0], [1, 2]].map(|numbers| errors(flags, sigmas_m, turns, numbers));
                println!("{sigmas_m:?} m, {name}: {together:.3?} m and m/s; by sensor {apart:.3?}");
                let [of_positions, of_velocities] = [0, 1].map(|i| apart[i] / together[i]);
                assert!(of_positions < most_m && of_velocities < most_mps, "{name}, flags {flags}");
            }
        }
    }
}

#[test]
fn detections_without_a_number_are_a_further_sensor() {
    let [together, apart] =
        [[0, 0], [0, 8]].map(|numbers| errors(flags::HAS_IDENTITIES, [0.5, 0.05], MIXED, numbers));
    assert!(apart[1] < 0.6 * together[1], "{together:?} and {apart:?}");
}

#[test]
fn sensors_of_the_same_noise_cost_nothing() {
    for (name, turns) in ALL {
        for flags in [flags::HAS_IDENTITIES, 0] {
            let [together, apart] = [[0, 0], [1, 2]].map(|numbers| errors(flags, [0.2; 2], turns, numbers));
            println!("{name}: {together:.4?} m and m/s; by sensor {apart:.4?}");
            assert!((0..2).all(|i| apart[i] < 1.02 * together[i]), "{name}, flags {flags}");
        }
    }
}

/// The lidar reports a deviation, which is too large, and the camera reports none. Their detections alternate.
#[test]
fn sensors_with_and_without_reports_are_separated() {
    let play = |numbers: [u8; 2]| {
        let mut squares_mps2 = Vec::new();
        let mut run = Harness::new(TrackerOptions::default(), flags::HAS_IDENTITIES);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for frame in 0..FRAMES {
            let (sensor, sigma_m) = (frame % 2, [0.05, 0.5][frame % 2]);
            let detections: Vec<Detection> = (1..=AGENTS)
                .map(|id| {
                    let [dx, dy] = [(); 2].map(|()| noise(&mut rng, sigma_m));
                    let x_m = SPEED_MPS * frame as f64 * TICK_S;
                    let detection = detected_at(AgentType::Vehicle, id, x_m + dx, 30.0 * id as f64 + dy);
                    let sigma_m = if sensor == 0 { 0.3 } else { 0.0 };
                    Detection { sensor: numbers[sensor], sigma_m, ..detection }
                })
                .collect();
            let tracks = run.step(&detections);
            squares_mps2.extend(tracks.iter().filter(|_| frame >= 50).map(off_mps2));
        }
        root_mean(&squares_mps2)
    };
    let [together, apart] = [[0, 0], [1, 2]].map(play);
    println!("{together:.3} m/s; by sensor {apart:.3} m/s");
    assert!(apart < 0.8 * together, "{together} and {apart} m/s");
}

/// Both sensors detect each agent in each frame, the first one 30 ms earlier.
#[test]
fn sensors_with_own_times_in_one_frame_are_separated() {
    let play = |numbers: [u8; 2]| {
        let mut squares_mps2 = Vec::new();
        let mut run = Harness::new(TrackerOptions::default(), 0);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for frame in 0..FRAMES {
            let mut detections = Vec::new();
            for ((sigma_m, offset_ns), sensor) in [(0.05, -30_000_000), (0.5, 0)].into_iter().zip(numbers) {
                let time_s = frame as f64 * TICK_S + offset_ns as f64 / 1e9;
                detections.extend((1..=AGENTS).map(|id| {
                    let [dx, dy] = [(); 2].map(|()| noise(&mut rng, sigma_m));
                    let lane_m = 30.0 * id as f64;
                    let detection = detected_at(AgentType::Vehicle, id, SPEED_MPS * time_s + dx, lane_m + dy);
                    Detection { sensor, offset_ns, ..detection }
                }));
            }
            let tracks = run.step(&detections);
            squares_mps2.extend(tracks.iter().filter(|_| frame >= 50).map(off_mps2));
        }
        root_mean(&squares_mps2)
    };
    let [together, apart] = [[0, 0], [1, 2]].map(play);
    println!("{together:.3} m/s; by sensor {apart:.3} m/s");
    assert!(apart < 0.7 * together, "{together} and {apart} m/s");
}

#[test]
fn one_sensor_gives_the_same_bytes_under_any_number() {
    for flags in [flags::HAS_IDENTITIES, 0] {
        let [unknown, first, last] =
            [0, 1, SENSORS_MAX as u8].map(|number| play(flags, [0.05, 0.5], (MIXED, 1), [number; 2]));
        let bytes = |frames: &[Vec<Track>]| bytemuck::cast_slice::<Track, u8>(&frames.concat()).to_vec();
        assert!(bytes(&unknown) == bytes(&first), "flags {flags}");
        assert!(bytes(&unknown) == bytes(&last), "flags {flags}");
    }
}

#[test]
fn a_sensor_beyond_the_limit_is_refused() {
    let mut run = Harness::new(TrackerOptions::default(), 0);
    let sensor = SENSORS_MAX as u8 + 1;
    let detection = Detection { sensor, ..detected_at(AgentType::Vehicle, 1, 0.0, 0.0) };
    let impossible = Rejected::Impossible { field: "detection sensor", value: f64::from(sensor) };
    assert_eq!(run.try_step(&[detection]), Err(impossible));
}
