//! The smoother bound (oracle): the motion of each vehicle from all of its measurements, earlier and later
//! ones.
//!
//! A filter of the same process has fewer measurements, so the smoother bounds it. This is the
//! Rauch-Tung-Striebel smoother for the process of [`filters::ConstantAcceleration`]. The two axes are
//! independent and have the same covariance.

use std::collections::BTreeMap;

use filters::chain_noise;
use metrics::tracking::{PlanarState, normalised_square};
use nalgebra::{Matrix2, Matrix3, Matrix3x2, RowVector2, Vector2};
use wire::AgentType;

use super::{ACCELERATION_MPS2, Course, Error, Outcome, SETTLED_S, Seen, UNKNOWN};

/// Position, velocity and acceleration of both axes, and the covariance that the axes share.
#[derive(Clone, Copy)]
struct AxisGaussian {
    mean: Matrix3x2<f64>,
    covariance: Matrix3<f64>,
}

/// A vehicle at one instant.
struct SmootherStep<'a> {
    tick: u64,
    stamp_ns: i64,
    seen: &'a Seen,
    /// Prior, before the measurement.
    predicted: AxisGaussian,
    /// Posterior, given all measurements up to now.
    filtered: AxisGaussian,
    /// Transition from the previous instant.
    transition: Matrix3<f64>,
}

/// Smooths all vehicles of a course.
pub(crate) fn smooth(course: &Course<'_>, jerk_density: f64) -> Outcome {
    let mut outcome = Outcome::default();
    let mut tracks: BTreeMap<u64, Vec<SmootherStep<'_>>> = BTreeMap::new();
    let variance = course.sensor.sigma_m.powi(2);
    for (instant, tick) in course.instants.iter().zip(0..) {
        let is_over = |id: &u64| instant.agents.binary_search_by_key(id, |seen| seen.id).is_err();
        tracks.extract_if(.., |id, _| is_over(id)).for_each(|(_, track)| finish(&track, &mut outcome));
        for seen in instant.agents.iter().filter(|seen| seen.agent_type == AgentType::Vehicle) {
            let step = |predicted, filtered, transition| SmootherStep {
                tick,
                stamp_ns: instant.stamp_ns,
                seen,
                predicted,
                filtered,
                transition,
            };
            let Some(track) = tracks.get_mut(&seen.id) else {
                let started = seen.measured_m.map(|position_m| AxisGaussian::start(position_m, variance));
                tracks.extend(started.map(|start| (seen.id, vec![step(start, start, Matrix3::identity())])));
                continue;
            };
            let Some(last) = track.last() else { continue };
            let dt_s = (instant.stamp_ns - last.stamp_ns) as f64 / 1e9;
            let transition = transition(dt_s);
            let predicted = last.filtered.after(&transition, &Matrix3::from(chain_noise(jerk_density, dt_s)));
            let mut filtered = predicted;
            if let Some(position_m) = seen.measured_m {
                let (nis, log_likelihood) = filtered.update(position_m, variance);
                outcome.add_innovation(tick, nis, log_likelihood);
            }
            track.push(step(predicted, filtered, transition));
        }
    }
    tracks.values().for_each(|track| finish(track, &mut outcome));
    outcome
}

/// Backward pass over a track. Errors count from the age [`SETTLED_S`] on.
fn finish(track: &[SmootherStep<'_>], outcome: &mut Outcome) {
    let Some((last, first)) = track.last().zip(track.first()) else { return };
    let mut smoothed = last.filtered;
    let mut estimates = vec![smoothed];
    for pair in track.windows(2).rev() {
        let [now, next] = pair else { continue };
        // G = P Fᵀ P₋⁻¹
        let Some(inverse) = next.predicted.covariance.try_inverse() else {
            outcome.fault_count += 1;
            return;
        };
        let gain = now.filtered.covariance * next.transition.transpose() * inverse;
        smoothed = AxisGaussian {
            mean: now.filtered.mean + gain * (smoothed.mean - next.predicted.mean),
            covariance: now.filtered.covariance
                + gain * (smoothed.covariance - next.predicted.covariance) * gain.transpose(),
        };
        estimates.push(smoothed);
    }
    for (step, estimate) in track.iter().zip(estimates.iter().rev()) {
        let age_s = (step.stamp_ns - first.stamp_ns) as f64 / 1e9;
        let Some(truth) = step.seen.truth.filter(|_| age_s >= SETTLED_S) else { continue };
        let row = |row: usize| [0, 1].map(|axis| estimate.mean[(row, axis)]);
        let smoothed = PlanarState { position_m: row(0), velocity_mps: row(1) };
        let error = Error::of(step.seen, step.stamp_ns, truth, smoothed);
        let off: Vector2<f64> = [0, 1].map(|axis| row(0)[axis] - truth.position_m[axis]).into();
        let nees = normalised_square(&off, &Matrix2::from_diagonal_element(estimate.covariance[(0, 0)]));
        outcome.fault_count += u64::from(nees.is_none());
        outcome.add_estimate(step.tick, error, nees);
    }
}

impl AxisGaussian {
    /// The state of a vehicle after its first measurement.
    fn start(position_m: [f64; 2], variance: f64) -> Self {
        let [speed, acceleration] = [UNKNOWN.speed_mps, ACCELERATION_MPS2];
        let mut mean = Matrix3x2::zeros();
        mean.set_row(0, &RowVector2::from(position_m));
        let variances = [variance, speed.powi(2), acceleration.powi(2)];
        Self { mean, covariance: Matrix3::from_diagonal(&variances.into()) }
    }

    fn after(&self, transition: &Matrix3<f64>, noise: &Matrix3<f64>) -> Self {
        Self {
            mean: transition * self.mean,
            covariance: transition * self.covariance * transition.transpose() + noise,
        }
    }

    /// Updates with a measured position. Returns its normalised squared innovation and its log-likelihood.
    fn update(&mut self, position_m: [f64; 2], variance: f64) -> (f64, f64) {
        let innovation = RowVector2::from(position_m) - self.mean.row(0);
        let of_innovation = self.covariance[(0, 0)] + variance;
        let gain = self.covariance.column(0) / of_innovation;
        self.mean += gain * innovation;
        self.covariance -= gain * gain.transpose() * of_innovation;
        let nis = innovation.norm_squared() / of_innovation;
        (nis, -(std::f64::consts::TAU * of_innovation).ln() - nis / 2.0)
    }
}

/// Transition matrix of position, velocity and acceleration.
fn transition(dt_s: f64) -> Matrix3<f64> {
    Matrix3::new(1.0, dt_s, dt_s.powi(2) / 2.0, 0.0, 1.0, dt_s, 0.0, 0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::super::Sensor;
    use super::super::course::tests::{NOWHERE, corner};
    use super::super::follower::Follower;
    use super::super::method::{Settings, TrackingMethod};
    use super::*;
    use crate::forecaster::Forecaster;

    const SENSOR: Sensor = Sensor { sigma_m: 0.05, gap_s: 1.6, seed: 1 };

    /// The forward pass is the filter of the process. Later measurements help most in gaps.
    #[test]
    fn the_smoother_errs_less_than_the_filter() {
        let forecaster = Forecaster::new(nn::Weights::onboard(), 1).unwrap();
        let recording = corner(6);
        let course = Course::new(&recording, [0, i64::MAX], SENSOR, &NOWHERE);
        let [filter, smoother] =
            [TrackingMethod::ConstantAcceleration, TrackingMethod::Smoother].map(|method| {
                let settings = Settings::first();
                Follower { method, settings, forecaster: &forecaster }.follow(&course)
            });
        assert_eq!(filter.errors.len(), smoother.errors.len());
        assert_eq!((filter.measured_count, smoother.fault_count), (smoother.measured_count, 0));
        for (is_visible, most) in [(true, 0.8), (false, 0.3)] {
            let mean = |outcome: &Outcome, of: fn(&Error) -> f64| {
                let errors = outcome.errors.iter().filter(|error| error.visible == is_visible);
                let (sum, len) = errors.fold((0.0, 0), |(sum, len), error| (sum + of(error), len + 1));
                sum / f64::from(len)
            };
            for of in [|error: &Error| error.position_m, |error: &Error| error.velocity_mps] {
                let ratio = mean(&smoother, of) / mean(&filter, of);
                assert!(ratio < most, "{ratio} of the filter's error, visible: {is_visible}");
            }
        }
        let inside = smoother.nees[0].summary(0.95).unwrap().unwrap();
        assert!((0.4..1.6).contains(&inside.per_degree), "{inside:?}");
    }
}
