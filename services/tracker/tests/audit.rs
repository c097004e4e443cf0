//! The tracker audits its input: the headers of its tracks contain the doubts.

use audit::Doubt;
use tracker::TrackerOptions;
use wire::{AgentType, flags};

use crate::support::harness::{Harness, detected_at, with_heading};

/// The doubts after ten seconds of a car on a circle whose headings are written by `written`.
fn doubts(flags: u32, written: fn(f64) -> f64) -> u32 {
    let mut run = Harness::new(TrackerOptions::default(), flags);
    for step in 0..128 {
        let angle = f64::from(step) * 0.08 * 8.0 / 50.0;
        let (sin, cos) = angle.sin_cos();
        let mut detection = detected_at(AgentType::Vehicle, 4, 50.0 * cos, 50.0 * sin);
        detection = with_heading(detection, 0.0);
        detection.heading_rad = written(angle + std::f64::consts::FRAC_PI_2) as f32;
        run.step(&[detection]);
    }
    run.tracker.header(&run.header()).input.doubts
}

#[test]
fn headings_in_degrees_of_a_producer_are_doubted() {
    for flags in [flags::HAS_IDENTITIES, 0] {
        assert_eq!(doubts(flags, |heading| heading), 0);
        assert_eq!(doubts(flags, f64::to_degrees), Doubt::HeadingsInDegrees.bit());
    }
}

#[test]
fn ids_that_change_with_each_frame_are_ignored() {
    let mut run = Harness::new(TrackerOptions::default(), flags::HAS_IDENTITIES);
    let mut ids = Vec::new();
    for step in 0..100_u32 {
        let car = |nth: u32| {
            let x_m = f64::from(8 + nth) * 0.08 * f64::from(step);
            detected_at(AgentType::Vehicle, u64::from(3 * step + nth), x_m, 6.0 * f64::from(nth))
        };
        let tracks = run.step(&[0, 1, 2].map(car));
        ids.push(tracks.iter().map(|track| track.id).collect::<Vec<u64>>());
    }
    assert_eq!(run.tracker.header(&run.header()).input.doubts, Doubt::IdentitiesChange.bit());
    // Twenty changes are seen within eight frames, and a track needs some more.
    assert!(ids[30].len() == 3 && ids[30..].iter().all(|of| *of == ids[30]), "{ids:?}");
}
