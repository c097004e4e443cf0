//! A source that resends the same detections under new stamps.

use tracker::{Prior, TrackerOptions};
use wire::{AgentType, Detection, flags};

use crate::support::harness::{Harness, detected_at};

const SPEED_MPS: f64 = 8.0;

/// An agent that drives along x without a reported speed, and a parked agent.
fn frame(tick: u32) -> [Detection; 2] {
    let x_m = SPEED_MPS * 0.08 * f64::from(tick);
    [detected_at(AgentType::Vehicle, 1, x_m, 0.0), detected_at(AgentType::Vehicle, 2, 30.0, 9.0)]
}

fn harness(frozen_frames: u32) -> Harness {
    let options = TrackerOptions { frozen_frames, prior: Prior::Kinematic, ..TrackerOptions::default() };
    let mut harness = Harness::new(options, flags::HAS_IDENTITIES);
    for tick in 0..20 {
        harness.step(&frame(tick));
    }
    harness
}

/// Position of the driving agent, and whether its tracks are predicted.
fn driving(harness: &Harness) -> (f64, bool) {
    let track = harness.published().iter().find(|track| track.source_id == 1).expect("it is published");
    (f64::from(track.x_m), harness.tracker.header(&harness.header()).has(flags::PREDICTED))
}

#[test]
fn tracks_of_a_frozen_source_are_predicted_until_it_goes_on() {
    let mut harness = harness(4);
    let frames: Vec<u32> =
        (0..7).map(|_| harness.try_step(&frame(19)).expect("a good frame").frozen_count).collect();
    assert_eq!(frames, [0, 0, 4, 5, 6, 7, 8], "the fourth with these detections is the first");
    let (x_m, is_predicted) = driving(&harness);
    assert!(is_predicted && harness.tracker.header(&harness.header()).observed_types == 0);
    let stands_m = SPEED_MPS * 0.08 * 19.0;
    assert!(x_m > stands_m + 0.25, "it drives on: {x_m} m, detected at {stands_m} m");
    let tracked = harness.try_step(&frame(27)).expect("a good frame");
    assert_eq!((tracked.frozen_count, driving(&harness).1), (0, false));
}

#[test]
fn standing_agents_and_trackers_without_the_option_take_every_frame() {
    let mut without = harness(0);
    assert!((0..7).all(|_| without.try_step(&frame(19)).expect("a good frame").frozen_count == 0));
    let mut parked = Harness::new(TrackerOptions { frozen_frames: 4, ..TrackerOptions::default() }, 0);
    assert!((0..20).all(|_| parked.try_step(&frame(0)[1..]).expect("a good frame").frozen_count == 0));
}
