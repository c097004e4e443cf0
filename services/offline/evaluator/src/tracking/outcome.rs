//! The errors of a method over a course.

use metrics::tracking::{Consistency, PlanarState};

use super::Seen;

/// Degrees of freedom of a position.
const DEGREES: u32 = 2;
/// Age from which a track's errors count.
pub(crate) const SETTLED_S: f64 = 1.0;

/// The error of an estimate at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Error {
    pub(crate) id: u64,
    pub(crate) stamp_ns: i64,
    pub(crate) visible: bool,
    pub(crate) truth: PlanarState,
    pub(crate) estimate: PlanarState,
    /// Norms of the differences.
    pub(crate) position_m: f64,
    pub(crate) velocity_mps: f64,
}

impl Error {
    /// The error of the estimate of an agent with this truth.
    pub(crate) fn of(seen: &Seen, stamp_ns: i64, truth: PlanarState, estimate: PlanarState) -> Self {
        let norm = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        Self {
            id: seen.id,
            stamp_ns,
            visible: seen.measured_m.is_some(),
            truth,
            estimate,
            position_m: norm(estimate.position_m, truth.position_m),
            velocity_mps: norm(estimate.velocity_mps, truth.velocity_mps),
        }
    }
}

/// The result of a run over a course.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outcome {
    pub(crate) errors: Vec<Error>,
    /// Normalised squared errors of positions, at measured instants and in gaps.
    pub(crate) nees: [Consistency; 2],
    /// Normalised squared innovations.
    pub(crate) nis: Consistency,
    /// Sum of the log-likelihoods of measurements.
    pub(crate) log_likelihood_sum: f64,
    pub(crate) measured_count: u64,
    /// Predictions and updates that failed.
    pub(crate) fault_count: u64,
}

impl Outcome {
    /// Adds the normalised squared innovation of a measurement and its log-likelihood.
    pub(crate) fn add_innovation(&mut self, tick: u64, nis: f64, log_likelihood: f64) {
        self.fault_count += u64::from(self.nis.add(tick, nis, DEGREES).is_err());
        self.log_likelihood_sum += log_likelihood;
        self.measured_count += 1;
    }

    /// Adds an estimate and the normalised squared error of its position, if there is one.
    pub(crate) fn add_estimate(&mut self, tick: u64, error: Error, nees: Option<f64>) {
        self.errors.push(error);
        let added = nees.map(|nees| self.nees[usize::from(!error.visible)].add(tick, nees, DEGREES));
        self.fault_count += u64::from(added.is_some_and(|added| added.is_err()));
    }

    /// Mean negative log-likelihood of a measurement.
    pub(crate) fn nll(outcomes: &[Self]) -> f64 {
        let measured_count: u64 = outcomes.iter().map(|outcome| outcome.measured_count).sum();
        -outcomes.iter().map(|outcome| outcome.log_likelihood_sum).sum::<f64>() / measured_count.max(1) as f64
    }
}
