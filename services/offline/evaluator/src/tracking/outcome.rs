//! The errors of a method over a course.

use metrics::tracking::{Consistency, PlanarState};

/// Degrees of freedom of a position.
pub(crate) const DEGREES: u32 = 2;
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
    /// Mean negative log-likelihood of a measurement.
    pub(crate) fn nll(outcomes: &[Self]) -> f64 {
        let measured_count: u64 = outcomes.iter().map(|outcome| outcome.measured_count).sum();
        -outcomes.iter().map(|outcome| outcome.log_likelihood_sum).sum::<f64>() / measured_count.max(1) as f64
    }
}
