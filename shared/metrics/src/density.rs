//! The density of a forecast at the true position (KDE-NLL).

use crate::Point;

/// Lower bound of the log density per m²: one far outlier must not outweigh a thousand good forecasts.
pub const LOG_DENSITY_MIN: f64 = -20.0;
/// Smallest bandwidth: samples that coincide have the uncertainty of a measurement.
const BANDWIDTH_MIN_M: f64 = 0.01;

/// Log density at `truth` of the weighted samples of one step. The kernel is a product of Gaussians with
/// Silverman's bandwidth:
///
/// ```text
/// h_d = σ_d (4 / (n (D + 2)))^(1 / (D + 4)),   D = 2,   n = (Σ w)² / Σ w²
/// ```
///
/// σ_d is the weighted standard deviation of the samples on axis d. The result is at least
/// [`LOG_DENSITY_MIN`], and equals it if no weight is positive.
///
/// # Panics
/// If the numbers of weights and samples differ.
#[must_use]
pub fn kde_log_density(samples: &[Point], weights: &[f32], truth: Point) -> f64 {
    assert_eq!(samples.len(), weights.len(), "one weight per sample");
    let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
    let squares: f64 = weights.iter().map(|&w| f64::from(w) * f64::from(w)).sum();
    if total <= 0.0 {
        return LOG_DENSITY_MIN;
    }
    let shrink = (total * total / squares).powf(-1.0 / 6.0);
    let bandwidths_m =
        [0, 1].map(|axis| (deviation(samples, weights, total, axis) * shrink).max(BANDWIDTH_MIN_M));
    let exponents = samples.iter().map(|sample| {
        let scaled = |axis: usize| (f64::from(truth[axis]) - f64::from(sample[axis])) / bandwidths_m[axis];
        -0.5 * (scaled(0).powi(2) + scaled(1).powi(2))
    });
    // The largest exponent is factored out so that far truths do not underflow.
    let largest = exponents.clone().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = exponents.zip(weights).map(|(e, &w)| f64::from(w) / total * (e - largest).exp()).sum();
    let volume = std::f64::consts::TAU * bandwidths_m[0] * bandwidths_m[1];
    (largest + sum.ln() - volume.ln()).max(LOG_DENSITY_MIN)
}

fn deviation(samples: &[Point], weights: &[f32], total: f64, axis: usize) -> f64 {
    let weighted = |value: &dyn Fn(f64) -> f64| -> f64 {
        samples.iter().zip(weights).map(|(s, &w)| f64::from(w) * value(f64::from(s[axis]))).sum::<f64>()
            / total
    };
    let mean = weighted(&|x| x);
    weighted(&|x| (x - mean).powi(2)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn density_of_four_samples_equals_value_by_hand() {
        // σ = 1 on both axes and n = 4, so h = 4^(−1/6). Every sample is one h-scaled unit per axis from the
        // centre.
        let samples = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
        let h = 4.0_f64.powf(-1.0 / 6.0);
        let expected = -1.0 / (h * h) - (std::f64::consts::TAU * h * h).ln();
        let found = kde_log_density(&samples, &[1.0; 4], [0.0, 0.0]);
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }

    #[test]
    fn density_rises_with_the_weight_of_near_samples() {
        let near = kde_log_density(&[[0.0, 0.0], [4.0, 4.0]], &[0.9, 0.1], [0.0, 0.0]);
        let even = kde_log_density(&[[0.0, 0.0], [4.0, 4.0]], &[0.5, 0.5], [0.0, 0.0]);
        assert!(near > even);
    }

    #[test]
    fn far_truths_and_zero_weights_have_the_lower_bound() {
        assert_eq!(kde_log_density(&[[0.0, 0.0]], &[1.0], [1e4, 0.0]), LOG_DENSITY_MIN);
        assert_eq!(kde_log_density(&[[0.0, 0.0]], &[0.0], [0.0, 0.0]), LOG_DENSITY_MIN);
        assert_eq!(kde_log_density(&[], &[], [0.0, 0.0]), LOG_DENSITY_MIN);
    }

    proptest! {
        #[test]
        fn the_density_integrates_to_one(
            samples in prop::collection::vec([-2.0f32..2.0, -2.0f32..2.0], 5..20),
        ) {
            let weights = vec![1.0; samples.len()];
            let cell = 0.1_f32;
            let mut sum = 0.0;
            for i in -80..80 {
                for j in -80..80 {
                    sum += kde_log_density(&samples, &weights, [i as f32 * cell, j as f32 * cell]).exp();
                }
            }
            prop_assert!((sum * f64::from(cell * cell) - 1.0).abs() < 0.02, "{}", sum * 0.01);
        }
    }
}
