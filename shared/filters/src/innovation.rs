use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

use crate::{FilterFault, Gaussian};

/// Largest number of values in one observation: x, y, ψ, v.
pub const MEASURED_MAX: usize = 4;

/// The innovation of a measurement: residuals of measured components of the state, with independent errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation<const N: usize> {
    /// Residual and variance of each measured component.
    values: [Option<(f64, f64)>; MEASURED_MAX],
    /// The second value measures y − `skew` x.
    skew: f64,
}

/// How well a measurement fits the prediction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Normalised innovation squared, yᵀ S⁻¹ y. It is χ² distributed with `measured_count` degrees of freedom
    /// if the model holds.
    pub nis: f64,
    /// Logarithm of the measurement's density under the prediction: −½ (NIS + ln |S| + m ln 2π).
    pub log_likelihood: f64,
    /// Number of measured values, m.
    pub measured_count: usize,
}

impl<const N: usize> Innovation<N> {
    /// The innovation of a position, which is the first two components: measured minus predicted, with the
    /// variance per axis.
    #[must_use]
    pub fn of_position(residual: [f64; 2], variance: f64) -> Self {
        let [x, y] = residual.map(|residual| Some((residual, variance)));
        Self { values: [x, y, None, None], skew: 0.0 }
    }

    /// As [`Innovation::of_position`], with errors of the covariance R = (xx, xy, yy). With R = L D Lᵀ, the
    /// values L⁻¹ (x, y) have independent errors of the variances D.
    #[must_use]
    pub fn of_elongated([x, y]: [f64; 2], [xx, xy, yy]: [f64; 3]) -> Self {
        let skew = xy / xx;
        let values = [Some((x, xx)), Some((y - skew * x, yy - skew * xy)), None, None];
        Self { values, skew }
    }

    /// Adds a measured component: measured minus predicted (angles wrapped), with its variance.
    ///
    /// # Panics
    /// If the component is not one of the first [`MEASURED_MAX`] of the state.
    pub fn set(&mut self, component: usize, residual: f64, variance: f64) {
        assert!(component < MEASURED_MAX.min(N), "the first {MEASURED_MAX} of {N} components");
        self.values[component] = Some((residual, variance));
    }

    /// Logarithm of the measurement's density given the exact state. It is not finite if a variance is not
    /// positive.
    pub fn log_density(&self) -> f64 {
        let of_value = |&(residual, variance): &(f64, f64)| {
            -0.5 * (residual * residual / variance + (TAU * variance).ln())
        };
        self.values.iter().flatten().map(of_value).sum()
    }
}

/// Statistics of an innovation y and its covariance S.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Misfit {
    /// yᵀ S⁻¹ y
    nis: f64,
    /// |S|
    det: f64,
    measured_count: usize,
}

impl Misfit {
    pub fn evidence(&self) -> Evidence {
        let &Self { nis, det, measured_count } = self;
        let log_likelihood = -0.5 * (nis + det.ln() + measured_count as f64 * TAU.ln());
        Evidence { nis, log_likelihood, measured_count }
    }

    fn is_finite(&self) -> bool {
        self.nis.is_finite() && self.det.is_normal()
    }
}

impl<const N: usize> Gaussian<N> {
    /// Replaces the prior by the posterior, in Joseph form.
    ///
    /// The measured values update the state sequentially. Their errors are independent, so the result equals
    /// a joint update, and no matrix is factored. For a component r, measured with the variance R:
    ///
    /// ```text
    /// s = P_rr + R      k = P e_r / s      x' = x + k y      P' = (I − k e_rᵀ) P (I − k e_rᵀ)ᵀ + k R kᵀ
    /// ```
    ///
    /// # Errors
    /// [`FilterFault`] if the innovation's covariance is not positive definite or a result is not finite. The
    /// state is then unchanged.
    pub(crate) fn correct(&mut self, innovation: &Innovation<N>) -> Result<Misfit, FilterFault> {
        let mut correction = Correction {
            covariance: self.covariance,
            shift: SVector::zeros(),
            misfit: Misfit { nis: 0.0, det: 1.0, measured_count: 0 },
        };
        let [x, y, third, fourth] = innovation.values;
        correction.update::<0>(x, 0.0)?;
        correction.update::<1>(y, innovation.skew)?;
        correction.update::<2>(third, 0.0)?;
        correction.update::<3>(fourth, 0.0)?;
        let Correction { covariance, shift, misfit } = correction;
        let posterior = Self { mean: self.mean + shift, covariance };
        if !(posterior.is_finite() && misfit.is_finite()) {
            return Err(FilterFault::NotFinite);
        }
        *self = posterior;
        Ok(misfit)
    }
}

/// The posterior after the first few values.
struct Correction<const N: usize> {
    covariance: SMatrix<f64, N, N>,
    /// Change of the mean.
    shift: SVector<f64, N>,
    /// With S = L D Lᵀ, the variance of a value given the previous values is its entry of D.
    misfit: Misfit,
}

impl<const N: usize> Correction<N> {
    /// Updates by a value of the component `ROW` minus `skew` times the first, if there is one. The value is a
    /// residual and its variance.
    #[inline]
    fn update<const ROW: usize>(&mut self, value: Option<(f64, f64)>, skew: f64) -> Result<(), FilterFault> {
        let Some((residual, variance)) = value else { return Ok(()) };
        let mut column = self.covariance.column(ROW).into_owned();
        let (mut own_variance, mut shift) = (column[ROW], self.shift[ROW]);
        if skew != 0.0 {
            column -= skew * self.covariance.column(0);
            own_variance = column[ROW] - skew * column[0];
            shift -= skew * self.shift[0];
        }
        let innovation_variance = own_variance + variance;
        if innovation_variance.is_nan() || innovation_variance <= 0.0 {
            return Err(FilterFault::NotPositive);
        }
        let gain = column / innovation_variance;
        let residual = residual - shift;
        self.shift += gain * residual;
        self.misfit.nis += residual * residual / innovation_variance;
        self.misfit.det *= innovation_variance;
        self.misfit.measured_count += 1;
        // With e_r for the measured combination of components: (I − k e_rᵀ) P e_r − k R.
        let rest = (column - gain * own_variance) - gain * variance;
        for j in 0..N {
            for i in 0..=j {
                let value = self.covariance[(i, j)] - gain[i] * column[j] - rest[i] * gain[j];
                self.covariance[(i, j)] = value;
                self.covariance[(j, i)] = value;
            }
        }
        Ok(())
    }
}
