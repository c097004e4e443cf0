//! Noise of the detections, learned from the detections alone, and the motion that is published under it.

use audit::Doubt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tracker::{Association, TrackerOptions};
use wire::{AgentType, Detection, Track, detection_flags, flags};

use crate::support::harness::{Harness, detected_at, noise, with_heading};

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

/// In the first second few measurements show the noise, and none show whether it is correlated.
#[test]
fn the_first_second_is_as_good_with_identities_as_without() {
    for kept in [0.0_f64, (-TICK_S / 0.3).exp()] {
        let [with, without] = [flags::HAS_IDENTITIES, 0].map(|flags| {
            let mut sum = 0.0;
            for seed in 0..8 {
                let mut run = Harness::new(TrackerOptions::default(), flags);
                let mut rng = ChaCha8Rng::seed_from_u64(seed);
                let mut errors_m = [[0.0; 2]; AGENTS as usize];
                let mut fresh = 1.0;
                for frame in 0..13 {
                    let detections = std::array::from_fn::<Detection, { AGENTS as usize }, _>(|i| {
                        let [dx, dy] =
                            errors_m[i].map(|error_m: f64| kept * error_m + fresh * noise(&mut rng, 0.12));
                        errors_m[i] = [dx, dy];
                        let id = i as u64 + 1;
                        let x_m = 9.0 * frame as f64 * TICK_S;
                        detected_at(AgentType::Vehicle, id, x_m + dx, 30.0 * id as f64 + dy)
                    });
                    fresh = (1.0 - kept * kept).sqrt();
                    let tracks = run.step(&detections);
                    for track in tracks.iter().filter(|_| frame >= 6) {
                        sum += f64::from(track.vx_mps - 9.0).powi(2) + f64::from(track.vy_mps).powi(2);
                    }
                }
            }
            (sum / (8.0 * 7.0 * AGENTS as f64)).sqrt()
        });
        println!("{with:.3} m/s with identities, {without:.3} m/s without");
        assert!(with < 1.25 * without, "{with} and {without} m/s, kept {kept}");
    }
}

/// Positions outside of the gates would start further tracks beside the agents.
#[test]
fn noise_beyond_the_prior_starts_no_further_tracks() {
    let mut run = Harness::new(TrackerOptions::default(), 0);
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (mut further, mut all) = (0, 0);
    for frame in 0..4 * FRAMES {
        let detections: Vec<Detection> = (1..=AGENTS)
            .map(|lane| {
                let [dx, dy] = [(); 2].map(|()| noise(&mut rng, 0.4));
                let x_m = 1.3 * frame as f64 * TICK_S;
                detected_at(AgentType::Pedestrian, 0, x_m + dx, 30.0 * lane as f64 + dy)
            })
            .collect();
        let tracks = run.step(&detections).len();
        if frame >= FRAMES {
            (further, all) = (further + tracks.saturating_sub(AGENTS as usize), all + tracks);
        }
    }
    println!("{further} of {all} tracks");
    assert!(all >= 3 * FRAMES * AGENTS as usize, "{all} tracks");
    assert!(20 * further < all, "{further} of {all} tracks");
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

/// The network reads accelerations from the history. Later measurements make it smoother than the states were
/// when they were published.
#[test]
fn histories_are_smoothed_under_noise() {
    let [braking_m, braking_mps]: [fn(f64) -> f64; 2] =
        [|time_s| 14.0 * time_s - 0.6 * time_s * time_s, |time_s| 14.0 - 1.2 * time_s];
    for flags in [flags::HAS_IDENTITIES, 0] {
        let frames = play((TrackerOptions::default(), flags), 0.2, braking_m);
        let (mut published, mut smoothed) = ([0.0; 2], [0.0; 2]);
        let add = |sums: &mut [f64; 2], state: &wire::HistoryState, frame: usize| {
            let lane_m = 30.0 * (f64::from(state.y_m) / 30.0).round();
            let time_s = frame as f64 * TICK_S;
            let off_m = f64::from(state.x_m) - braking_m(time_s);
            let off_mps = f64::from(state.vx_mps) - braking_mps(time_s);
            sums[0] += off_m.powi(2) + (f64::from(state.y_m) - lane_m).powi(2);
            sums[1] += off_mps.powi(2) + f64::from(state.vy_mps).powi(2);
        };
        for (frame, tracks) in frames.iter().enumerate().skip(40) {
            for back in 1..=3 {
                let before = frame - 5 * back;
                let newest = tracks[0].history.len() - 1;
                tracks.iter().for_each(|track| add(&mut smoothed, &track.history[newest - back], before));
                frames[before].iter().for_each(|track| add(&mut published, &track.history[newest], before));
            }
        }
        let [of_positions, of_velocities] = [0, 1].map(|i| (smoothed[i] / published[i]).sqrt());
        println!(
            "errors of positions {of_positions:.3}, of velocities {of_velocities:.3} of those published"
        );
        assert!(of_positions < 0.75 && of_velocities < 0.75, "{of_positions} and {of_velocities}");
    }
}

#[test]
fn exact_positions_are_found_exact_within_a_second() {
    let [along_m, true_mps]: [fn(f64) -> f64; 2] =
        [|time_s| 5.0 * time_s + 1.5 * time_s * time_s, |time_s| 5.0 + 3.0 * time_s];
    for flags in [flags::HAS_IDENTITIES, 0] {
        // Association by position keeps the process noise of a detector.
        let (from, most_mps) = if flags == 0 { (26, 0.5) } else { (13, 0.3) };
        let frames = play((TrackerOptions::default(), flags), 0.0, along_m);
        let off_mps = error_mps(&frames, from, true_mps);
        assert!(off_mps < most_mps, "{off_mps} m/s while the vehicle accelerates");
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

/// The published size is a mean over about 39 detections, and a box of half the length hardly changes it.
#[test]
fn published_sizes_average_the_noise() {
    let (length_m, width_m) = (4.5_f64, 1.8_f64);
    for flags in [flags::HAS_IDENTITIES, 0] {
        let mut run = Harness::new(TrackerOptions::default(), flags);
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let (mut square_m2, mut count) = (0.0, 0);
        for frame in 0..=300 {
            let detections: Vec<Detection> = (1..=AGENTS)
                .map(|id| {
                    let x_m = 9.0 * f64::from(frame) * TICK_S;
                    let is_cut = frame == 300;
                    let length_m = if is_cut { 0.5 * length_m } else { length_m + noise(&mut rng, 0.3) };
                    Detection {
                        length_m: length_m as f32,
                        width_m: (width_m + noise(&mut rng, 0.3)).max(0.1) as f32,
                        flags: detection_flags::HAS_ID | detection_flags::HAS_SIZE,
                        ..detected_at(AgentType::Vehicle, id, x_m, 30.0 * id as f64)
                    }
                })
                .collect();
            let tracks = run.step(&detections);
            if (30..300).contains(&frame) {
                square_m2 += tracks.iter().map(|of| (f64::from(of.length_m) - length_m).powi(2)).sum::<f64>();
                count += tracks.len();
            } else if frame == 300 {
                let least_m = tracks.iter().map(|of| of.length_m).fold(f32::INFINITY, f32::min);
                assert!(least_m > 4.1, "a box of {:.2} m changed the length to {least_m}", 0.5 * length_m);
            }
        }
        let rms_m = (square_m2 / count as f64).sqrt();
        println!("published length: {rms_m:.3} m RMS for detections of 0.3 m");
        assert!(count > 1500 && rms_m < 0.08, "{rms_m} m over {count}");
    }
}

/// The tracks of the last frame, and the doubts, after 60 s of vehicles whose noise is `sigma_m` of the time.
fn published(options: TrackerOptions, flags: u32, sigma_m: impl Fn(f64) -> f64) -> (Vec<Track>, u32) {
    let mut run = Harness::new(options, flags);
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut tracks = Vec::new();
    for frame in 0..750 {
        let time_s = f64::from(frame) * TICK_S;
        let mut off = |scale: f64| noise(&mut rng, scale * sigma_m(time_s));
        let detections: Vec<Detection> = (1..=AGENTS)
            .map(|id| {
                detected_at(AgentType::Vehicle, id, 9.0 * time_s + off(1.0), 30.0 * id as f64 + off(1.0))
            })
            .collect();
        let detections: Vec<Detection> =
            detections.into_iter().map(|detection| with_heading(detection, off(0.3))).collect();
        tracks = run.step(&detections).to_vec();
        if frame == 1 {
            assert!(tracks.iter().all(|track| track.noise() == [0.0; 3]), "there is no evidence yet");
        }
    }
    (tracks, run.tracker.header(&run.header()).input.doubts)
}

#[test]
fn the_learned_noise_is_published() {
    for flags in [flags::HAS_IDENTITIES, 0] {
        let (tracks, doubts) = published(TrackerOptions::default(), flags, |_| 0.12);
        assert_eq!((tracks.len(), doubts), (AGENTS as usize, 0));
        let [position_m, heading_rad, speed_mps] = tracks[0].noise();
        assert!((0.1..0.145).contains(&position_m), "{position_m} m");
        assert!((0.03..0.043).contains(&heading_rad), "{heading_rad} rad");
        assert_eq!(speed_mps, 0.0, "no speeds are reported");
    }
    let jpda = TrackerOptions { association: Association::Jpda, ..TrackerOptions::default() };
    let (tracks, _) = published(jpda, 0, |_| 0.12);
    assert!(
        !tracks.is_empty() && tracks.iter().all(|track| track.noise() == [0.0; 3]),
        "jpda learns nothing"
    );
}

#[test]
fn noise_that_triples_is_a_doubt() {
    for flags in [flags::HAS_IDENTITIES, 0] {
        let doubts = |from_m: f64, to_m: f64| {
            let sigma_m = |time_s| if time_s < 41.0 { from_m } else { to_m };
            published(TrackerOptions::default(), flags, sigma_m).1
        };
        assert_eq!(doubts(0.1, 0.3), Doubt::NoiseChanged.bit(), "worse");
        assert_eq!(doubts(0.3, 0.1), Doubt::NoiseChanged.bit(), "better");
        assert_eq!(doubts(0.1, 0.15), 0, "about the same");
        assert_eq!(doubts(0.002, 0.02), 0, "exact");
        let exact_m = published(TrackerOptions::default(), flags, |_| 0.0).0[0].noise_m;
        assert!(exact_m > 0.0 && exact_m < 0.01, "{exact_m} m");
    }
}

/// Root mean square error of the published velocities of three vehicles near the sensor and of three far away,
/// whose positions are ten times less exact.
fn near_and_far_mps(flags: u32) -> [f64; 2] {
    let mut run = Harness::new(TrackerOptions::default(), flags);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (mut sums, mut count) = ([0.0; 2], 0);
    for frame in 0..150 {
        let detections: Vec<Detection> = (1..=AGENTS)
            .map(|id| {
                let (y_m, sigma_m) =
                    if id <= 3 { (5.0 * id as f64, 0.04) } else { (60.0 + 5.0 * id as f64, 0.4) };
                let [dx, dy] = [(); 2].map(|()| noise(&mut rng, sigma_m));
                detected_at(AgentType::Vehicle, id, 2.0 * f64::from(frame) * TICK_S - 6.0 + dx, y_m + dy)
            })
            .collect();
        let tracks = run.step(&detections);
        if frame >= 60 {
            assert_eq!(tracks.len(), AGENTS as usize, "frame {frame}");
            for track in tracks {
                sums[usize::from(track.y_m > 40.0)] +=
                    (f64::from(track.vx_mps) - 2.0).powi(2) + f64::from(track.vy_mps).powi(2);
            }
            count += 3;
        }
    }
    sums.map(|sum| (sum / f64::from(count)).sqrt())
}

#[test]
fn noise_that_grows_with_the_distance_is_learned_by_distance() {
    let [everywhere, by_distance] =
        [flags::HAS_IDENTITIES, flags::HAS_IDENTITIES | flags::SEEN_FROM_EGO].map(near_and_far_mps);
    println!("near and far: {everywhere:.3?} m/s for one noise, {by_distance:.3?} m/s by distance");
    assert!(
        by_distance[0] < 0.1 && by_distance[1] < 0.6 * everywhere[1],
        "{everywhere:?} and {by_distance:?} m/s"
    );
}

/// Root mean square error of the published velocities of six vehicles around the sensor. Their positions are ten
/// times less exact along the line of sight, or across it.
fn elongated_mps(flags: u32, along_m: f64, across_m: f64) -> f64 {
    let mut run = Harness::new(TrackerOptions::default(), flags);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (mut sum, mut count) = (0.0, 0);
    for frame in 0..200 {
        let detections: Vec<Detection> = (1..=AGENTS)
            .map(|id| {
                let (sin, cos) = (std::f64::consts::TAU * id as f64 / AGENTS as f64).sin_cos();
                let [x, y] = [30.0 * cos + 2.0 * f64::from(frame) * TICK_S - 12.0, 30.0 * sin];
                let distance_m = x.hypot(y);
                let [along_m, across_m] = [along_m, across_m].map(|sigma_m| noise(&mut rng, sigma_m));
                let dx = (along_m * x - across_m * y) / distance_m;
                let dy = (along_m * y + across_m * x) / distance_m;
                detected_at(AgentType::Vehicle, id, x + dx, y + dy)
            })
            .collect();
        let tracks = run.step(&detections);
        if frame >= 80 {
            for track in tracks {
                sum += (f64::from(track.vx_mps) - 2.0).powi(2) + f64::from(track.vy_mps).powi(2);
                count += 1;
            }
        }
    }
    (sum / f64::from(count)).sqrt()
}

#[test]
fn noise_along_or_across_the_line_of_sight_is_learned() {
    for (along_m, across_m, most) in [(0.5, 0.05, 0.95), (0.05, 0.5, 0.65)] {
        let [all, by_view] = [flags::HAS_IDENTITIES, flags::HAS_IDENTITIES | flags::SEEN_FROM_EGO]
            .map(|flags| elongated_mps(flags, along_m, across_m));
        println!("{along_m} and {across_m} m: {all:.3} m/s for one noise, {by_view:.3} m/s by the view");
        assert!(by_view < most * all, "{all} and {by_view} m/s");
    }
}
