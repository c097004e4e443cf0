use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

use crate::{FilterFault, Gaussian};

/// Most values that one update compares: x, y, ψ, v.
pub const MEASURED_MAX: usize = 4;

/// What a measurement tells beyond the prediction: values of components of the state, with independent errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation<const N: usize> {
    /// The component that each measured value observes.
    rows: [usize; MEASURED_MAX],
    residual: [f64; MEASURED_MAX],
    variance: [f64; MEASURED_MAX],
    len: usize,
}

/// How well an update's measurement fitted the prediction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Normalised innovation squared, yᵀ S⁻¹ y: chi-squared with `measured_len` degrees of freedom where the model holds.
    pub nis: f64,
    /// Logarithm of the measurement's density under the prediction: −½ (NIS + ln |S| + m ln 2π).
    pub log_likelihood: f64,
    /// Number of measured values, m.
    pub measured_len: usize,
}

impl<const N: usize> Innovation<N> {
    /// Of a position, observed directly as the first two components: measured less predicted, and variance per axis.
    #[must_use]
    pub fn of_position(residual: [f64; 2], variance: f64) -> Self {
        let mut innovation = Self { rows: [0; 4], residual: [0.0; 4], variance: [0.0; 4], len: 0 };
        innovation.push(0, residual[0], variance);
        innovation.push(1, residual[1], variance);
        innovation
    }

    /// Adds a direct observation of a component: measured less predicted, angles wrapped, and its variance.
    ///
    /// # Panics
    /// If more than [`MEASURED_MAX`] values are added, or the state has no such component.
    pub fn push(&mut self, component: usize, residual: f64, variance: f64) {
        assert!(self.len < MEASURED_MAX && component < N, "up to {MEASURED_MAX} values of {N} components");
        self.rows[self.len] = component;
        self.residual[self.len] = residual;
        self.variance[self.len] = variance;
        self.len += 1;
    }

    /// Logarithm of the measurement's density where the state is known for certain; not finite where a variance is not
    /// positive.
    #[must_use]
    pub fn log_density(&self) -> f64 {
        let of_value = |(_, residual, variance): (_, f64, f64)| {
            -0.5 * (residual * residual / variance + (TAU * variance).ln())
        };
        self.values().map(of_value).sum()
    }

    /// Component, residual and variance of each measured value.
    fn values(&self) -> impl Iterator<Item = (usize, f64, f64)> {
        let values = self.rows.iter().zip(&self.residual).zip(&self.variance).take(self.len);
        values.map(|((&row, &residual), &variance)| (row, residual, variance))
    }
}

/// An update's innovation y against its covariance S.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Misfit {
    /// yᵀ S⁻¹ y
    nis: f64,
    /// |S|
    det: f64,
    measured_len: usize,
}

impl Misfit {
    pub fn evidence(&self) -> Evidence {
        let &Self { nis, det, measured_len } = self;
        let log_likelihood = -0.5 * (nis + det.ln() + measured_len as f64 * TAU.ln());
        Evidence { nis, log_likelihood, measured_len }
    }

    fn is_finite(&self) -> bool {
        self.nis.is_finite() && self.det.is_normal()
    }
}

impl<const N: usize> Gaussian<N> {
    /// Becomes the posterior, in Joseph form.
    ///
    /// The measured values correct the state one after the other: as their errors are independent, that tells the same as
    /// all at once, and no matrix is factored. Of a component r, seen with the variance R:
    ///
    /// ```text
    /// s = P_rr + R      k = P e_r / s      x' = x + k y      P' = (I − k e_rᵀ) P (I − k e_rᵀ)ᵀ + k R kᵀ
    /// ```
    ///
    /// # Errors
    /// [`FilterFault`] where the innovation's covariance is not positive definite or a result is not finite; the state is
    /// then as before.
    pub(crate) fn correct(&mut self, innovation: &Innovation<N>) -> Result<Misfit, FilterFault> {
        let mut covariance = self.covariance;
        let mut shift = SVector::<f64, N>::zeros();
        // S = L D Lᵀ: the spread of each value, given those before, is its entry of D.
        let mut misfit = Misfit { nis: 0.0, det: 1.0, measured_len: innovation.len };
        for (row, residual, variance) in innovation.values() {
            let spread = covariance[(row, row)] + variance;
            if spread.is_nan() || spread <= 0.0 {
                return Err(FilterFault::NotPositive);
            }
            let gain = covariance.row(row).transpose() / spread;
            let residual = residual - shift[row];
            shift += gain * residual;
            misfit.nis += residual * residual / spread;
            misfit.det *= spread;
            covariance = joseph(&covariance, row, &gain, variance);
        }
        let posterior = Self { mean: self.mean + shift, covariance };
        if !(posterior.is_finite() && misfit.is_finite()) {
            return Err(FilterFault::NotFinite);
        }
        *self = posterior;
        Ok(misfit)
    }
}

/// The covariance once the component `row` was seen with that variance.
#[inline]
fn joseph<const N: usize>(
    covariance: &SMatrix<f64, N, N>,
    row: usize,
    gain: &SVector<f64, N>,
    variance: f64,
) -> SMatrix<f64, N, N> {
    let seen = covariance.row(row).transpose();
    // Column `row` of (I − k e_rᵀ) P, less k R.
    let rest = (seen - gain * seen[row]) - gain * variance;
    let mut posterior = SMatrix::zeros();
    for j in 0..N {
        for i in 0..=j {
            let value = covariance[(i, j)] - gain[i] * seen[j] - rest[i] * gain[j];
            posterior[(i, j)] = value;
            posterior[(j, i)] = value;
        }
    }
    posterior
}
