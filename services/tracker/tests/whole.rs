//! Long vehicles of which a part or the whole is seen.

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tracker::TrackerOptions;
use wire::{AgentType, Detection, detection_flags, flags};

use crate::support::harness::{Harness, detected_at, noise, with_heading};

const SPEED_MPS: f64 = 6.0;
/// Interval of frames at 10 Hz.
const TICK_S: f64 = 0.1;

/// The box around `length_m` of a bus whose front is at this distance, along +x or along −y.
fn seen(front_m: f64, length_m: f64, along_x: bool, has_heading: bool, rng: &mut ChaCha8Rng) -> Detection {
    let centre_m = front_m - length_m / 2.0 + noise(rng, 0.05);
    let [x_m, y_m] = if along_x { [centre_m, noise(rng, 0.05)] } else { [noise(rng, 0.05), -centre_m] };
    let found = detected_at(AgentType::Vehicle, 1, x_m, y_m);
    let heading_rad = if along_x { 0.0 } else { -std::f64::consts::FRAC_PI_2 };
    let found = if has_heading { with_heading(found, heading_rad) } else { found };
    let flags = found.flags | detection_flags::HAS_SIZE;
    Detection { length_m: length_m as f32, width_m: 2.5, flags, ..found }
}

#[test]
fn a_bus_seen_in_part_is_one_agent_at_its_speed() {
    for (lengths_m, identities, has_heading) in [
        (&[4.0, 12.0][..], flags::HAS_IDENTITIES, true),
        (&[4.0, 12.0], 0, true),
        (&[5.0, 9.0, 15.0], flags::HAS_IDENTITIES, true),
        (&[5.0, 9.0, 15.0], 0, true),
        (&[4.0, 12.0], flags::HAS_IDENTITIES, false),
        (&[4.0, 12.0], 0, false),
    ] {
        for along_x in [true, false] {
            let case = format!("{lengths_m:?} identities {identities} {has_heading} {along_x}");
            let mut rng = ChaCha8Rng::seed_from_u64(2);
            let mut run = Harness::new(TrackerOptions::default(), identities);
            run.tick_ns = 100_000_000;
            for frame in 0..150 {
                let length_m = lengths_m[rng.random_range(0..lengths_m.len())];
                let front_m = SPEED_MPS * TICK_S * f64::from(frame);
                let tracks = run.step(&[seen(front_m, length_m, along_x, has_heading, &mut rng)]);
                if frame < 20 {
                    continue;
                }
                assert_eq!(tracks.len(), 1, "{case}: frame {frame}");
                let [forward_mps, sideways_mps] = match along_x {
                    true => [tracks[0].vx_mps, tracks[0].vy_mps],
                    false => [-tracks[0].vy_mps, tracks[0].vx_mps],
                };
                let off_mps = (f64::from(forward_mps) - SPEED_MPS).hypot(f64::from(sideways_mps));
                // Positions alone show the course less well.
                let most_mps = if has_heading { 1.0 } else { 1.5 };
                assert!(off_mps < most_mps, "{case}: frame {frame}: {forward_mps} {sideways_mps}");
                let centre_m = front_m - lengths_m[lengths_m.len() - 1] / 2.0;
                let at_m = f64::from(if along_x { tracks[0].x_m } else { -tracks[0].y_m });
                assert!((at_m - centre_m).abs() < 1.0, "{case}: frame {frame}: {at_m} for {centre_m}");
            }
        }
    }
}
