//! The terms of the loss and their weights.

use crate::net::matrix::Matrix;

/// Weights of the terms of the loss.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Objective {
    /// γ · mean squared displacement + α · KL + β · MMD of one posterior draw. \[paper, Eq. loss\]
    Paper {
        /// Weight of the displacement.
        gamma: f64,
        /// Weight of the KL divergence.
        alpha: f64,
        /// Weight of the maximum mean discrepancy.
        beta: f64,
        /// Deviation of the posterior.
        sigma: f64,
    },
    /// Variety loss: best of the learned points, by the unsquared distance.
    Plus {
        /// Weight of a random mode, which gives modes that never win a gradient; it falls to 0 over the
        /// training.
        random_mode: f64,
        /// Weight of the point of the single best forecast.
        single: f64,
        /// Weight of the cross-entropy of the mode probabilities to the winner.
        probability: f64,
        /// Weight of the energy score, which calibrates the covariances.
        spread: f64,
        /// Weight of a vehicle relative to any other agent: a vehicle's errors are larger, and its gradients
        /// even more so.
        vehicle: f64,
        /// Number of modes, the nearest by the base control, that are decoded to find the winner.
        candidates: usize,
        /// Weight of the error of the last step relative to the mean over all steps; 0.5 in options that lack
        /// it.
        #[serde(default = "last_step")]
        last_step: f64,
    },
}

const fn last_step() -> f64 {
    0.5
}

impl Objective {
    /// The paper's loss.
    #[must_use]
    pub const fn paper() -> Self {
        Self::Paper { gamma: 1.0, alpha: 0.1, beta: 1.0, sigma: 1.0 }
    }

    /// The default loss.
    #[must_use]
    pub const fn plus() -> Self {
        Self::Plus {
            random_mode: 0.05,
            single: 0.3,
            probability: 0.05,
            spread: 0.05,
            vehicle: 0.3,
            candidates: 8,
            last_step: last_step(),
        }
    }

    /// The weighted sum of the parts.
    pub(crate) fn weigh(&self, parts: LossParts) -> f64 {
        let LossParts { trajectory, single, probability, spread } = parts;
        let [trajectory, single, probability, spread] =
            [trajectory, single, probability, spread].map(f64::from);
        match *self {
            Self::Plus { single: of_single, probability: of_probability, spread: of_spread, .. } => {
                trajectory + of_single * single + of_probability * probability + of_spread * spread
            }
            Self::Paper { alpha, beta, .. } => trajectory + alpha * probability + beta * spread,
        }
    }
}

/// The parts of a loss before they are weighted. The [`Objective`] determines which ones are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LossParts {
    /// Error of the winner, or of the posterior draw.
    pub trajectory: f32,
    /// Error of the single best forecast.
    pub single: f32,
    /// Cross-entropy of the mode probabilities, or KL divergence of the posterior.
    pub probability: f32,
    /// Energy score, or maximum mean discrepancy.
    pub spread: f32,
}

impl LossParts {
    /// Exponential moving average: these parts moved by `share` towards `new`.
    #[must_use]
    pub(crate) fn mixed(self, new: Self, share: f32) -> Self {
        self.zipped(new, |old, new| old + (new - old) * share)
    }

    /// The sum with the losses of another part of the same batch.
    pub(crate) fn plus(self, other: Self) -> Self {
        self.zipped(other, |own, other| own + other)
    }

    /// All parts times a factor.
    pub(crate) fn times(self, factor: f32) -> Self {
        self.zipped(self, |part, _| part * factor)
    }

    /// Combines each part with the same part of another loss.
    fn zipped(self, other: Self, combine: impl Fn(f32, f32) -> f32) -> Self {
        Self {
            trajectory: combine(self.trajectory, other.trajectory),
            single: combine(self.single, other.single),
            probability: combine(self.probability, other.probability),
            spread: combine(self.spread, other.spread),
        }
    }

    /// Whether all parts are finite.
    pub(crate) fn is_finite(self) -> bool {
        [self.trajectory, self.single, self.probability, self.spread].into_iter().all(f32::is_finite)
    }
}

/// Adds the gradient by the means of the controls to the gradient by the head's output.
pub(super) fn add_mean_gradient(d_raw: &mut Matrix, d_mean: &Matrix) {
    let (raw, _) = d_raw.values.as_chunks_mut::<{ nn::RAW_CONTROL }>();
    for (raw, mean) in raw.iter_mut().zip(d_mean.values.as_chunks::<2>().0) {
        raw[0] += mean[0];
        raw[1] += mean[1];
    }
}
