//! The figures of a validation.

use metrics::Errors;

/// Minimum error of a baseline in a comparison, m. Smaller errors occur only in synthetic data, such as
/// uniform motion.
pub(crate) const BASELINE_MIN_M: f64 = 0.01;

/// Validation figures of one data set.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SetScore {
    /// Name of the set.
    pub set: String,
    /// Number of forecast windows.
    pub windows: usize,
    /// Number of forecast agents.
    pub agents: usize,
    /// minADE₂₀ and minFDE₂₀ of the network's modes.
    pub best_of_modes: Errors,
    /// The network's single best forecast (K = 1).
    pub single: Errors,
    /// minADE₂₀ and minFDE₂₀ of the base control's modes, without the network.
    pub base_best_of_modes: Errors,
    /// The single base control, without the network.
    pub base_single: Errors,
    /// Constant velocity.
    pub constant_velocity: Errors,
    /// The best of 20 residual anchors, fitted to the set's own training part.
    pub anchors_best_of_20: Errors,
}

impl SetScore {
    /// Errors relative to the baselines: below 1 is better.
    pub fn relative(&self) -> f64 {
        let sum = |errors: Errors| errors.ade_m + 0.5 * errors.fde_m;
        let ratio = |ours: Errors, theirs: Errors| sum(ours) / sum(theirs).max(BASELINE_MIN_M);
        (ratio(self.best_of_modes, self.anchors_best_of_20)
            + 0.3 * ratio(self.single, self.constant_velocity))
            / 1.3
    }
}

/// The figure that compares checkpoints: the mean of [`SetScore::relative`] over the sets.
#[must_use]
pub(crate) fn choose_by(scores: &[SetScore]) -> f64 {
    scores.iter().map(SetScore::relative).sum::<f64>() / scores.len().max(1) as f64
}

/// A figure rounded to four decimals, because further digits are noise.
pub(crate) fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
