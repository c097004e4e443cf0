use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, PI};

use filters::wrapped;

/// Each detected heading that agrees with the estimated front, or contradicts it, weighs as if 30 % were turned.
const HEADING_WEIGHT: f64 = 0.85;
/// A frame of driving forwards, or backwards, weighs less: agents do reverse.
const MOTION_WEIGHT: f64 = 0.2;
/// Before anybody has seen the track it weighs more: few agents come into view in reverse.
const FIRST_MOTION_WEIGHT: f64 = 1.0;
/// Slower motion tells nothing, nor does one of fewer standard deviations.
const MOTION_MIN_MPS: f64 = 1.0;
const MOTION_MIN_SIGMAS: f64 = 3.0;
/// Belief is held within this, so that it can change.
const LOG_ODDS_MAX: f64 = 8.0;
/// At this much evidence against it, the front of a published track is where its back was.
const TURN_LOG_ODDS: f64 = -6.0;
/// A published heading turns no further in a frame: where the evidence turns a front round, it goes round in three.
const TURN_MAX_RAD: f64 = FRAC_PI_3;

/// Which end of an agent is its front: evidence gathered over frames.
///
/// Detectors often can't tell front from back and turn a heading by π. A turned heading still tells the axis, so it is
/// *folded* onto the estimated front for the filter, and only counted here: one frame never turns an agent round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Front {
    /// Log-odds that the estimated front is the front.
    log_odds: f64,
}

impl Front {
    /// The belief after the detection that set the estimate.
    #[must_use]
    pub const fn new() -> Self {
        Self { log_odds: HEADING_WEIGHT }
    }

    /// Counts which way a detected heading points.
    pub fn pointed(&mut self, detected_rad: f64, estimated_rad: f64) {
        self.add(if agree(detected_rad, estimated_rad) { HEADING_WEIGHT } else { -HEADING_WEIGHT });
    }

    /// Counts a frame of motion along the estimated heading, at a speed that is known to within `sigma_mps`.
    pub fn moved(&mut self, speed_mps: f64, sigma_mps: f64, published: bool) {
        if speed_mps.abs() > MOTION_MIN_MPS.max(MOTION_MIN_SIGMAS * sigma_mps) {
            let weight = if published { MOTION_WEIGHT } else { FIRST_MOTION_WEIGHT };
            self.add(weight.copysign(speed_mps));
        }
    }

    /// Whether the agent points the other way: for a track that nobody has seen yet by any majority of the evidence,
    /// else by a clear one. Taking the turn starts the count for the new front.
    #[must_use]
    pub fn take_turn(&mut self, published: bool) -> bool {
        let turned = if published { self.log_odds <= TURN_LOG_ODDS } else { self.log_odds < 0.0 };
        if turned {
            self.log_odds = -self.log_odds;
        }
        turned
    }

    fn add(&mut self, weight: f64) {
        self.log_odds = (self.log_odds + weight).clamp(-LOG_ODDS_MAX, LOG_ODDS_MAX);
    }
}

/// The published heading on its way from the last one to `heading_rad`; none where it is there at once.
#[must_use]
pub fn under_way_rad(last_rad: f64, heading_rad: f64) -> Option<f64> {
    let turn_rad = wrapped(heading_rad - last_rad);
    (turn_rad.abs() > TURN_MAX_RAD).then(|| wrapped(last_rad + TURN_MAX_RAD.copysign(turn_rad)))
}

/// Folds a detected heading to within π/2 of the estimated one.
#[must_use]
pub fn folded(detected_rad: f64, estimated_rad: f64) -> f64 {
    if agree(detected_rad, estimated_rad) { detected_rad } else { wrapped(detected_rad + PI) }
}

fn agree(detected_rad: f64, estimated_rad: f64) -> bool {
    wrapped(detected_rad - estimated_rad).abs() <= FRAC_PI_2
}
