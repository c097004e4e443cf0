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
