use data::{Frame, Recording};
use wire::Detection;

use super::*;
use crate::forecaster::MapInput;

const INTERVAL_NS: i64 = 100_000_000;

/// A site without map and retrieval memory.
pub(crate) const NOWHERE: Place<'static> = Place { map: MapInput::None, memory: None };

/// A vehicle that drives straight at 10 m/s for 20 s.
pub(crate) fn recording() -> Recording {
    let frames = (0..200).map(|frame| vec![vehicle(7, [frame as f32, 0.0])]);
    recording_of(frames)
}

/// Consecutive vehicles that turn left at the same corner at 7 m/s, 6.5 s after they appear.
pub(crate) fn corner(vehicles: usize) -> Recording {
    const RADIUS_M: f32 = 12.0;
    const SPEED_MPS: f32 = 7.0;
    let place = |since_s: f32| {
        let beyond_m = SPEED_MPS * (since_s - 6.5);
        let turned_rad = (beyond_m / RADIUS_M).clamp(0.0, std::f32::consts::FRAC_PI_2);
        let left_m = beyond_m - RADIUS_M * turned_rad;
        let (sin, cos) = turned_rad.sin_cos();
        [RADIUS_M * sin + left_m * cos, RADIUS_M * (1.0 - cos) + left_m * sin]
    };
    let frames = (0..vehicles * 140).map(|frame| {
        let (number, since) = (frame / 140, frame % 140);
        // The last 2 s of each period are empty.
        let there = (since < 120).then(|| vehicle(number as u64, place(since as f32 / 10.0)));
        there.into_iter().collect()
    });
    recording_of(frames)
}

fn vehicle(id: u64, [x_m, y_m]: [f32; 2]) -> Detection {
    Detection {
        id,
        x_m,
        y_m,
        flags: detection_flags::HAS_ID,
        agent_type: AgentType::Vehicle as u32,
        ..bytemuck::Zeroable::zeroed()
    }
}

fn recording_of(frames: impl Iterator<Item = Vec<Detection>>) -> Recording {
    let frame = |(number, detections): (i64, Vec<Detection>)| Frame {
        stamp_ns: number * INTERVAL_NS,
        detections,
        ..Frame::default()
    };
    Recording {
        interval_ns: INTERVAL_NS.cast_unsigned(),
        frames: (0..).zip(frames).map(frame).collect(),
        ..Recording::default()
    }
}

#[test]
fn positions_are_noisy_and_velocities_true() {
    let sensor = Sensor { sigma_m: 0.1, gap_s: 0.0, seed: 1 };
    let course = Course::new(&recording(), [0, i64::MAX], sensor, &NOWHERE);
    let errors: Vec<f64> = course
        .instants
        .iter()
        .map(|instant| &instant.agents[0])
        .filter_map(|seen| Some(seen.measured_m?[0] - seen.truth?.position_m[0]))
        .collect();
    assert_eq!(errors.len(), 198);
    let variance = errors.iter().map(|error| error * error).sum::<f64>() / 198.0;
    assert!((0.007..0.013).contains(&variance), "{variance}");
    let truths = course.instants[1..199].iter().map(|instant| instant.agents[0].truth.unwrap());
    assert!(truths.clone().all(|truth| (truth.velocity_mps[0] - 10.0).abs() < 1e-4));
}

#[test]
fn gaps_have_their_length_and_begin_after_3_s() {
    let sensor = Sensor { sigma_m: 0.1, gap_s: 1.6, seed: 1 };
    let course = Course::new(&recording(), [0, i64::MAX], sensor, &NOWHERE);
    let occluded: Vec<bool> =
        course.instants.iter().map(|instant| instant.agents[0].measured_m.is_none()).collect();
    let spells: Vec<&[bool]> = occluded.chunk_by(|a, b| a == b).collect();
    assert!(!spells[0][0] && spells[0].len() >= 30);
    assert!(spells.len() > 3);
    let gaps = spells[..spells.len() - 1].iter().filter(|spell| spell[0]);
    assert!(gaps.clone().count() >= 2);
    assert!(gaps.clone().all(|gap| gap.len().abs_diff(16) <= 1), "{spells:?}");
}
