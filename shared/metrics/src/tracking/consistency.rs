use std::collections::BTreeMap;

use nalgebra::{SMatrix, SVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::frame::{TrackingError, check};
use crate::Share;

/// Largest number of degrees of freedom of a χ² quantile. The cost of its series grows with the square root.
const DEGREES_MAX: u64 = 1 << 32;

/// The normalised square of an error: eᵀ P⁻¹ e.
///
/// This is the NEES for a state and its P, and the NIS for an innovation and its S. Returns `None` if the
/// covariance is not positive definite, or if the covariance or the result is not finite. Cost: one Cholesky
/// factorisation.
#[must_use]
pub fn normalised_square<const N: usize>(
    error: &SVector<f64, N>,
    covariance: &SMatrix<f64, N, N>,
) -> Option<f64> {
    if !covariance.iter().all(|x| x.is_finite()) {
        return None;
    }
    let whitened = covariance.cholesky()?.l().solve_lower_triangular(error)?;
    Some(whitened.norm_squared()).filter(|square| square.is_finite())
}

/// A closed range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Bounds {
    /// Whether `value` is within the bounds.
    #[must_use]
    pub fn contain(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// The range that contains a χ² variable of `degrees` degrees of freedom with probability `level`. The
/// remaining probability is split equally below and above.
///
/// The sum of N independent squares of n degrees each has N n degrees. The bounds of the mean are the bounds
/// of the sum divided by N.
///
/// # Errors
/// If `degrees` is 0 or above 2³², or `level` is not between 0 and 1.
pub fn chi_square_bounds(degrees: u64, level: f64) -> Result<Bounds, TrackingError> {
    check("degrees", degrees as f64, (1..=DEGREES_MAX).contains(&degrees), "between 1 and 2^32")?;
    check("level", level, level > 0.0 && level < 1.0, "between 0 and 1")?;
    let invalid = |_| TrackingError::Value { name: "degrees", value: degrees as f64, range: "above 0" };
    let distribution = ChiSquared::new(degrees as f64).map_err(invalid)?;
    let below = (1.0 - level) / 2.0;
    Ok(Bounds { low: distribution.inverse_cdf(below), high: distribution.inverse_cdf(1.0 - below) })
}

/// Whether a filter's covariances are consistent with its errors. The input is the normalised squares
/// ([`normalised_square`]) of many runs, tick by tick.
///
/// A run is a seed or an independent track. If the filter is consistent, the squares of all runs at one tick
/// add up to a χ² variable. The sum should then be within its [`chi_square_bounds`]. Each tick is compared
/// separately, because the squares of a state at several ticks of one run are correlated. The squares of
/// innovations are not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Consistency {
    ticks: BTreeMap<u64, TickSum>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct TickSum {
    square_count: u64,
    sum: f64,
    degrees: u64,
}

/// The result of [`Consistency`] for all ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsistencySummary {
    /// Squares counted.
    pub square_count: u64,
    /// Ticks with at least one square.
    pub tick_count: u64,
    /// Share of the ticks whose sum is within its bounds.
    pub inside: f64,
    /// Mean square per degree of freedom, over all ticks. It is 1 if the covariances are consistent and
    /// larger if they are too small.
    pub per_degree: f64,
}

impl Consistency {
    /// Counts the normalised square of one run at a tick (its number or stamp). The error has `degrees`
    /// components.
    ///
    /// # Errors
    /// If the square is not finite or is negative, or if `degrees` is 0.
    pub fn add(&mut self, tick: u64, square: f64, degrees: u32) -> Result<(), TrackingError> {
        check("square", square, square.is_finite() && square >= 0.0, "finite and at least 0")?;
        check("degrees", f64::from(degrees), degrees > 0, "above 0")?;
        let sum = TickSum { square_count: 1, sum: square, degrees: degrees.into() };
        self.ticks.entry(tick).or_default().merge(&sum);
        Ok(())
    }

    /// Adds the counts of `other`, as further runs over the same ticks.
    pub fn merge(&mut self, other: &Self) {
        for (&tick, sum) in &other.ticks {
            self.ticks.entry(tick).or_default().merge(sum);
        }
    }

    /// Compares all ticks with the bounds of this level (0.95 is usual). Returns `None` if nothing was
    /// counted.
    ///
    /// # Errors
    /// If the level is not between 0 and 1, or one tick has more than 2³² degrees of freedom.
    pub fn summary(&self, level: f64) -> Result<Option<ConsistencySummary>, TrackingError> {
        // Quantiles are expensive, and most ticks have equal degrees.
        let mut bounds_of = BTreeMap::new();
        let (mut total, mut inside) = (TickSum::default(), Share::default());
        for tick in self.ticks.values() {
            let bounds = match bounds_of.get(&tick.degrees) {
                Some(bounds) => *bounds,
                None => chi_square_bounds(tick.degrees, level)?,
            };
            bounds_of.insert(tick.degrees, bounds);
            inside.add(bounds.contain(tick.sum));
            total.merge(tick);
        }
        Ok(inside.value().map(|share| ConsistencySummary {
            square_count: total.square_count,
            tick_count: inside.len(),
            inside: share,
            per_degree: total.sum / total.degrees as f64,
        }))
    }
}

impl TickSum {
    fn merge(&mut self, other: &Self) {
        self.square_count += other.square_count;
        self.sum += other.sum;
        self.degrees += other.degrees;
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{ChiSquared as Sampled, Distribution};

    use super::*;

    fn assert_close(value: f64, expected: f64, relative: f64) {
        assert!((value / expected - 1.0).abs() < relative, "{value}, expected {expected}");
    }

    #[test]
    fn bounds_equal_published_tables() {
        let table = [
            (1, 0.000_982_069_117, 5.023_886_187_314_888),
            (2, 0.050_635_615_968_579_75, 7.377_758_908_227_871),
            (10, 3.246_972_780_236_84, 20.483_177_350_807_39),
            (100, 74.221_927_474_923_73, 129.561_197_185_836_6),
        ];
        for (degrees, low, high) in table {
            let bounds = chi_square_bounds(degrees, 0.95).unwrap();
            assert_close(bounds.low, low, 1e-9);
            assert_close(bounds.high, high, 1e-9);
        }
    }

    /// P(χ² ≤ x) of 2k degrees: 1 − e^(−x/2) Σ_(i<k) (x/2)^i / i!, each term in logarithms.
    fn even_cdf(half_degrees: u32, x: f64) -> f64 {
        let half = x / 2.0;
        let mut log_term = -half;
        let mut above = 0.0;
        for i in 1..=half_degrees {
            above += log_term.exp();
            log_term += half.ln() - f64::from(i).ln();
        }
        1.0 - above
    }

    #[test]
    fn bounds_are_the_exact_quantiles_of_even_degrees() {
        for half_degrees in [1, 7, 500, 2_500, 50_000] {
            let bounds = chi_square_bounds(2 * u64::from(half_degrees), 0.95).unwrap();
            assert!((even_cdf(half_degrees, bounds.low) - 0.025).abs() < 1e-9, "{half_degrees}: {bounds:?}");
            assert!((even_cdf(half_degrees, bounds.high) - 0.975).abs() < 1e-9, "{half_degrees}: {bounds:?}");
        }
    }

    #[test]
    fn bounds_of_large_sums_are_nearly_normal() {
        const Z: f64 = 1.959_963_984_540_054;
        for degrees in [1 << 20, 1 << 26, DEGREES_MAX] {
            let bounds = chi_square_bounds(degrees, 0.95).unwrap();
            let (mean, sigma) = (degrees as f64, (2.0 * degrees as f64).sqrt());
            // Cornish-Fisher expansion up to the skewness.
            let skew = 2.0 / 3.0 * (Z * Z - 1.0);
            assert_close((bounds.low - mean - skew) / sigma, -Z, 1e-3);
            assert_close((bounds.high - mean - skew) / sigma, Z, 1e-3);
        }
    }

    #[test]
    fn bounds_of_invalid_parameters_are_refused() {
        for (name, degrees, level) in [
            ("degrees", 0, 0.95),
            ("degrees", DEGREES_MAX + 1, 0.95),
            ("level", 1, 0.0),
            ("level", 1, 1.0),
            ("level", 1, f64::NAN),
        ] {
            let refused = chi_square_bounds(degrees, level).unwrap_err();
            assert!(
                matches!(refused, TrackingError::Value { name: found, .. } if found == name),
                "{refused}"
            );
        }
    }

    #[test]
    fn normalised_square_equals_value_by_hand() {
        let covariance = Matrix2::new(4.0, 1.0, 1.0, 2.0);
        // P⁻¹ = [2, −1; −1, 4] / 7.
        let square = normalised_square(&Vector2::new(1.0, -2.0), &covariance).unwrap();
        assert_close(square, 22.0 / 7.0, 1e-14);
        assert_eq!(normalised_square(&Vector2::zeros(), &-covariance), None);
        assert_eq!(normalised_square(&Vector2::new(f64::NAN, 0.0), &covariance), None);
        assert_eq!(
            normalised_square(&Vector2::zeros(), &Matrix2::from_diagonal_element(f64::INFINITY)),
            None
        );
    }

    /// Two hundred runs of three hundred ticks, with covariances `scale` times too small.
    fn summary(scale: f64) -> ConsistencySummary {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut whole = Consistency::default();
        for _ in 0..200 {
            let mut run = Consistency::default();
            for tick in 0..300 {
                // Measurements of two and of three components.
                let degrees = 2 + u32::from(tick % 3 == 0);
                let square = Sampled::new(f64::from(degrees)).unwrap().sample(&mut rng);
                run.add(tick, scale * square, degrees).unwrap();
            }
            whole.merge(&run);
        }
        whole.summary(0.95).unwrap().unwrap()
    }

    #[test]
    fn summary_separates_right_covariances_from_wrong_ones() {
        let right = summary(1.0);
        assert_eq!((right.square_count, right.tick_count), (60_000, 300));
        assert!((0.91..0.99).contains(&right.inside), "{right:?}");
        assert_close(right.per_degree, 1.0, 0.02);
        let small = summary(1.3);
        assert!(small.inside < 0.2, "{small:?}");
        assert_close(small.per_degree, 1.3, 0.02);
    }

    #[test]
    fn invalid_squares_are_refused_and_none_have_no_summary() {
        let mut consistency = Consistency::default();
        for (name, square, degrees) in
            [("square", f64::NAN, 2), ("square", -1.0, 2), ("square", f64::INFINITY, 2), ("degrees", 1.0, 0)]
        {
            let refused = consistency.add(0, square, degrees).unwrap_err();
            assert!(
                matches!(refused, TrackingError::Value { name: found, .. } if found == name),
                "{refused}"
            );
        }
        assert_eq!(consistency.summary(0.95), Ok(None));
    }
}
