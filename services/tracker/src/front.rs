//! The decision which end of an agent is its front.
//!
//! Detectors often confuse front and rear, and flip a heading by π. A flipped heading still gives the axis.
//! It is therefore *folded* onto the estimated front for the filter, and counted here as evidence against
//! this front. Only accumulated evidence flips a track; one frame never does.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, PI};

use filters::wrapped;

/// Log-odds of a detected heading that agrees with the estimated front, or contradicts it. It corresponds to
/// 30 % flipped headings.
const HEADING_WEIGHT: f64 = 0.85;
/// Log-odds of a frame of forward or backward motion. It is less than a heading's, because agents do reverse.
const MOTION_WEIGHT: f64 = 0.2;
/// The same at a speed at which nobody reverses. It outweighs headings that are half a turn off.
const FAST_MOTION_WEIGHT: f64 = 1.2;
/// Speeds up to which agents often reverse, and from which nobody does.
const REVERSE_MPS: [f64; 2] = [3.0, 5.0];
/// The same before the track is published. Few agents come into view in reverse.
const FIRST_MOTION_WEIGHT: f64 = 1.0;
/// Slower motion is not evidence, and neither is motion of fewer standard deviations.
const MOTION_MIN_MPS: f64 = 1.0;
const MOTION_MIN_SIGMAS: f64 = 3.0;
/// Bound of the log-odds, so that later evidence can change them.
const LOG_ODDS_MAX: f64 = 8.0;
/// At these log-odds of its front, a published track flips.
const FLIP_LOG_ODDS: f64 = -6.0;
/// Largest turn of a published heading in one frame. A flip takes three frames.
const TURN_MAX_RAD: f64 = FRAC_PI_3;

/// Evidence about the front of an agent, accumulated over frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Front {
    /// Log-odds that the estimated front is the front.
    log_odds: f64,
}

impl Front {
    /// The evidence after the detection that set the estimate.
    #[must_use]
    pub const fn new() -> Self {
        Self { log_odds: HEADING_WEIGHT }
    }

    /// Adds the direction of a detected heading.
    pub fn observe_heading(&mut self, detected_rad: f64, estimated_rad: f64) {
        self.add(if agree(detected_rad, estimated_rad) { HEADING_WEIGHT } else { -HEADING_WEIGHT });
    }

    /// Adds a frame of motion along the estimated heading, with this speed and its standard deviation.
    pub fn observe_motion(&mut self, speed_mps: f64, sigma_mps: f64, published: bool) {
        if speed_mps.abs() > MOTION_MIN_MPS.max(MOTION_MIN_SIGMAS * sigma_mps) {
            let [often_mps, never_mps] = REVERSE_MPS;
            let fast = ((speed_mps.abs() - often_mps) / (never_mps - often_mps)).clamp(0.0, 1.0);
            let slow = if published { MOTION_WEIGHT } else { FIRST_MOTION_WEIGHT };
            let weight = slow + fast * (FAST_MOTION_WEIGHT - slow);
            self.add(weight.copysign(speed_mps));
        }
    }

    /// Whether the agent points the other way. Before a track is published, any majority of the evidence is
    /// enough; afterwards it must be clear. Taking the flip also reverses the evidence.
    #[must_use]
    pub fn take_flip(&mut self, published: bool) -> bool {
        let flips = if published { self.log_odds <= FLIP_LOG_ODDS } else { self.log_odds < 0.0 };
        if flips {
            self.log_odds = -self.log_odds;
        }
        flips
    }

    fn add(&mut self, weight: f64) {
        self.log_odds = (self.log_odds + weight).clamp(-LOG_ODDS_MAX, LOG_ODDS_MAX);
    }
}

/// Whether the speed along a heading shows that the heading is half a turn off.
#[must_use]
pub fn is_reversed(speed_mps: f64) -> bool {
    speed_mps < -REVERSE_MPS[1]
}

/// The published heading, rate-limited on its way from the last one to `heading_rad`. Returns `None` if the
/// heading arrives immediately.
#[must_use]
pub fn rate_limited_rad(last_rad: f64, heading_rad: f64) -> Option<f64> {
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
