//! Joint probabilistic data association (JPDA): the probability that each detection belongs to each track,
//! over all joint pairings.
//!
//! A *joint event* pairs every track with one detection or none, and pairs no detection with two tracks. Its
//! weight is
//!
//! ```text
//! Π_paired P_D N(y_ij; 0, S_ij) / λ · Π_missed (1 − P_D)
//! ```
//!
//! The probability β_ij of a pair is the weight of all events that contain the pair, divided by the weight of
//! all events. A track is then updated to the moments of a mixture: its posteriors under each detection and
//! its prior, weighted by β of the detections and of the miss.
//!
//! A [`JointAssociation`] enumerates the events of one small component. An [`Associator`] separates a frame
//! into components.

mod associator;

pub use associator::{Associator, Share};

use thiserror::Error;

/// Largest number of tracks, and of detections, in a component whose events are enumerated.
pub const SIDE_MAX: usize = 5;
/// Smallest log-likelihood of a pair, relative to the best pair of its track. Smaller values never matter,
/// and the limit prevents underflow of the events.
const LOG_RATIO_MIN: f64 = -100.0;
/// Options of one track: a detection, or the miss.
const OPTIONS_MAX: usize = SIDE_MAX + 1;

/// Detection model of the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Probability that a track is detected, P_D, below 1.
    pub detection_probability: f64,
    /// False detections per unit of the measured space, λ. It is above 0.
    pub clutter_density: f64,
}

/// Why an association failed.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum JpdaFault {
    /// The component has too many events to enumerate.
    #[error("{track_count} tracks and {detection_count} detections, at most {SIDE_MAX} each")]
    TooLarge {
        /// Number of tracks.
        track_count: usize,
        /// Number of detections.
        detection_count: usize,
    },
    /// The sensor's numbers are not a probability and a density.
    #[error("{0:?} is no sensor")]
    Sensor(Sensor),
}

/// The probability of each pair, and of each track's miss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointAssociation {
    beta: [[f64; OPTIONS_MAX]; SIDE_MAX],
    track_count: usize,
    detection_count: usize,
}

impl JointAssociation {
    /// Enumerates the joint events of a component.
    ///
    /// `log_likelihood(track, detection)` is ln N(y; 0, S). It is `None` beyond the gate; a value that is not
    /// finite also counts as beyond the gate.
    ///
    /// # Errors
    /// [`JpdaFault`]
    pub fn new(
        track_count: usize,
        detection_count: usize,
        sensor: &Sensor,
        log_likelihood: impl Fn(usize, usize) -> Option<f64>,
    ) -> Result<Self, JpdaFault> {
        if track_count > SIDE_MAX || detection_count > SIDE_MAX {
            return Err(JpdaFault::TooLarge { track_count, detection_count });
        }
        let log_miss = (1.0 - sensor.detection_probability).ln();
        let log_hit = (sensor.detection_probability / sensor.clutter_density).ln();
        if !(log_miss.is_finite() && log_hit.is_finite()) {
            return Err(JpdaFault::Sensor(*sensor));
        }
        let log_weight = |track, detection| log_likelihood(track, detection).map(|log| log + log_hit);
        Ok(Self::enumerate(track_count, detection_count, log_miss, log_weight))
    }

    /// Like [`JointAssociation::new`], for a component within [`SIDE_MAX`], given the log-weights of the
    /// pairs and of a miss.
    fn enumerate(
        track_count: usize,
        detection_count: usize,
        log_miss: f64,
        log_weight: impl Fn(usize, usize) -> Option<f64>,
    ) -> Self {
        let mut weights = [[0.0; OPTIONS_MAX]; SIDE_MAX];
        for (track, weight) in weights.iter_mut().enumerate().take(track_count) {
            let mut logs = [None; OPTIONS_MAX];
            for (detection, log) in logs.iter_mut().enumerate().take(detection_count) {
                *log = log_weight(track, detection).filter(|log| log.is_finite());
            }
            logs[detection_count] = Some(log_miss);
            let most = logs.iter().flatten().fold(f64::NEG_INFINITY, |most, &log| most.max(log));
            *weight = logs.map(|log| log.map_or(0.0, |log| (log - most).max(LOG_RATIO_MIN).exp()));
        }
        let mut association = Self { beta: [[0.0; OPTIONS_MAX]; SIDE_MAX], track_count, detection_count };
        let sum = association.accumulate(&weights, 0, 0, 1.0);
        for beta in association.beta.as_flattened_mut() {
            // Rounding may move a certain pair above 1.
            *beta = (*beta / sum).min(1.0);
        }
        association
    }

    /// Adds every event that continues the pairs of the tracks before `track` to β. These pairs have the
    /// weight `before` and the detections of the mask `taken`. Returns the sum of the events' weights from
    /// `track` on.
    fn accumulate(
        &mut self,
        weights: &[[f64; OPTIONS_MAX]; SIDE_MAX],
        track: usize,
        taken: u8,
        before: f64,
    ) -> f64 {
        if track == self.track_count {
            return 1.0;
        }
        let mut sum = 0.0;
        for option in 0..=self.detection_count {
            let weight = weights[track][option];
            let bit = if option < self.detection_count { 1 << option } else { 0 };
            if weight == 0.0 || taken & bit != 0 {
                continue;
            }
            let from_here = weight * self.accumulate(weights, track + 1, taken | bit, before * weight);
            self.beta[track][option] += before * from_here;
            sum += from_here;
        }
        sum
    }

    /// Probability that a detection belongs to a track.
    #[must_use]
    pub fn pair(&self, track: usize, detection: usize) -> f64 {
        self.of_track(track)[detection]
    }

    /// Probabilities of a track's detections, then of its miss. They sum to 1.
    ///
    /// # Panics
    /// If the track does not exist.
    #[must_use]
    pub fn of_track(&self, track: usize) -> &[f64] {
        &self.beta[..self.track_count][track][..=self.detection_count]
    }
}
