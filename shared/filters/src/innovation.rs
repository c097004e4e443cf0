use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

use crate::{FilterFault, Gaussian};

/// Most values that one update compares: x, y, ψ, v.
pub const MEASURED_MAX: usize = 4;

/// What a measurement tells beyond the prediction: values of components of the state, with independent errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation<const N: usize> {
    /// Residual and variance of each component that was measured.
    values: [Option<(f64, f64)>; MEASURED_MAX],
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
        let [x, y] = residual.map(|residual| Some((residual, variance)));
        Self { values: [x, y, None, None] }
    }

    /// Adds a direct observation of a component: measured less predicted, angles wrapped, and its variance.
    ///
    /// # Panics
    /// If the component is none of the first [`MEASURED_MAX`] of the state.
    pub fn set(&mut self, component: usize, residual: f64, variance: f64) {
        assert!(component < MEASURED_MAX.min(N), "the first {MEASURED_MAX} of {N} components");
        self.values[component] = Some((residual, variance));
    }

    /// Logarithm of the measurement's density where the state is known for certain; not finite where a variance is not
    /// positive.
    #[must_use]
    pub fn log_density(&self) -> f64 {
        let of_value = |&(residual, variance): &(f64, f64)| {
            -0.5 * (residual * residual / variance + (TAU * variance).ln())
        };
        self.values.iter().flatten().map(of_value).sum()
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
        let mut correction = Correction {
            covariance: self.covariance,
            shift: SVector::zeros(),
            misfit: Misfit { nis: 0.0, det: 1.0, measured_len: 0 },
        };
        let [x, y, third, fourth] = innovation.values;
        correction.see::<0>(x)?;
        correction.see::<1>(y)?;
        correction.see::<2>(third)?;
        correction.see::<3>(fourth)?;
        let Correction { covariance, shift, misfit } = correction;
        let posterior = Self { mean: self.mean + shift, covariance };
        if !(posterior.is_finite() && misfit.is_finite()) {
            return Err(FilterFault::NotFinite);
        }
        *self = posterior;
        Ok(misfit)
    }
}

/// What the values seen so far make of a state.
struct Correction<const N: usize> {
    covariance: SMatrix<f64, N, N>,
    /// By how much they move the mean.
    shift: SVector<f64, N>,
    /// S = L D Lᵀ: the spread of each value, given those before, is its entry of D.
    misfit: Misfit,
}

impl<const N: usize> Correction<N> {
    /// Takes in a value of the component `ROW`, if there is one: residual and variance.
    #[inline]
    fn see<const ROW: usize>(&mut self, value: Option<(f64, f64)>) -> Result<(), FilterFault> {
        let Some((residual, variance)) = value else { return Ok(()) };
        let seen = self.covariance.column(ROW).into_owned();
        let spread = seen[ROW] + variance;
        if spread.is_nan() || spread <= 0.0 {
            return Err(FilterFault::NotPositive);
        }
        let gain = seen / spread;
        let residual = residual - self.shift[ROW];
        self.shift += gain * residual;
        self.misfit.nis += residual * residual / spread;
        self.misfit.det *= spread;
        self.misfit.measured_len += 1;
        // Column `ROW` of (I − k e_rᵀ) P, less k R.
        let rest = (seen - gain * seen[ROW]) - gain * variance;
        for j in 0..N {
            for i in 0..=j {
                let value = self.covariance[(i, j)] - gain[i] * seen[j] - rest[i] * gain[j];
                self.covariance[(i, j)] = value;
                self.covariance[(j, i)] = value;
            }
        }
        Ok(())
    }
}
