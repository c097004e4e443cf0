//! Noise of the detections, learned from the detections alone, and the motion that is published under it.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tracker::TrackerOptions;
use wire::{AgentType, Detection, Track, flags};

use crate::support::harness::{Harness, detected_at, noise};

const FRAMES: usize = 120;
const AGENTS: u64 = 6;
const TICK_S: f64 = 0.08;

/// The tracks of each frame, of vehicles in lanes of their own whose way along x is `along_m` of the time.
fn play(
    (options, flags): (TrackerOptions, u32),
    sigma_m: f64,
    along_m: impl Fn(f64) -> f64,
) -> Vec<Vec<Track>> {
    let mut run = Harness::new(options, flags);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let frame = |frame: usize| -> Vec<Track> {
        let x_m = along_m(frame as f64 * TICK_S);
        let detections: Vec<Detection> = (1..=AGENTS)
            .map(|id| {
                let [dx, dy] = [(); 2].map(|()| if sigma_m > 0.0 { noise(&mut rng, sigma_m) } else { 0.0 });
                detected_at(AgentType::Vehicle, id, x_m + dx, 30.0 * id as f64 + dy)
            })
            .collect();
        run.step(&detections).to_vec()
    };
    (0..FRAMES).map(frame).collect()
}

/// Root mean square error of the published velocities from the given frame on.
fn error_mps(frames: &[Vec<Track>], from: usize, true_mps: impl Fn(f64) -> f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for (frame, tracks) in frames.iter().enumerate().skip(from) {
        assert_eq!(tracks.len(), AGENTS as usize, "frame {frame}");
        for track in tracks {
            let off_mps = f64::from(track.vx_mps) - true_mps(frame as f64 * TICK_S);
            sum += off_mps.powi(2) + f64::from(track.vy_mps).powi(2);
            count += 1;
        }
    }
    (sum / f64::from(count)).sqrt()
}

#[test]
fn a_straight_vehicle_is_steady_with_and_without_identities() {
    for (sigma_m, most_mps) in [(0.12, 0.3), (0.3, 0.6)] {
        let [with, without] = [flags::HAS_IDENTITIES, 0].map(|flags| {
            let frames = play((TrackerOptions::default(), flags), sigma_m, |time_s| 9.0 * time_s);
            error_mps(&frames, 60, |_| 9.0)
        });
        println!("{sigma_m} m: {with:.3} m/s with identities, {without:.3} m/s without");
        assert!(with < most_mps && without < most_mps, "{sigma_m} m: {with} and {without} m/s");
        assert!((with / without).ln().abs() < 1.25_f64.ln(), "{sigma_m} m: {with} and {without} m/s");
    }
}

#[test]
fn a_parked_vehicle_stands_under_noise() {
    for flags in [flags::HAS_IDENTITIES, 0] {
        let frames = play((TrackerOptions::default(), flags), 0.3, |_| 0.0);
        let speeds_mps = frames.iter().skip(30).flatten().map(|track| track.vx_mps.hypot(track.vy_mps));
        let (fast, all) = speeds_mps.fold((0, 0), |(fast, all), v| (fast + i32::from(v > 0.3), all + 1));
        assert!(all > 500 && fast * 50 < all, "{fast} of {all} above 0.3 m/s");
    }
}

#[test]
fn exact_positions_are_found_exact_within_a_second() {
    let [along_m, true_mps]: [fn(f64) -> f64; 2] =
        [|time_s| 5.0 * time_s + 1.5 * time_s * time_s, |time_s| 5.0 + 3.0 * time_s];
    for flags in [flags::HAS_IDENTITIES, 0] {
        let from = if flags == 0 { 26 } else { 13 };
        let frames = play((TrackerOptions::default(), flags), 0.0, along_m);
        let off_mps = error_mps(&frames, from, true_mps);
        assert!(off_mps < 0.3, "{off_mps} m/s while the vehicle accelerates");
    }
}

#[test]
fn associated_detections_are_tracked_as_those_without_identities() {
    let associate = TrackerOptions { associate: true, ..TrackerOptions::default() };
    let along_m = |time_s: f64| 9.0 * time_s;
    let associated = play((associate, flags::HAS_IDENTITIES), 0.12, along_m);
    let without = play((TrackerOptions::default(), 0), 0.12, along_m);
    for (frame, (associated, without)) in associated.iter().zip(&without).enumerate() {
        let [associated, without] =
            [associated, without].map(|tracks| bytemuck::cast_slice::<Track, u8>(tracks));
        assert!(associated == without, "frame {frame}");
    }
}
