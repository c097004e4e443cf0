use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

use crate::gaussian::symmetrised;
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
        let measured = self.residual.iter().zip(&self.variance).take(self.len);
        measured
            .map(|(residual, variance)| -0.5 * (residual * residual / variance + (TAU * variance).ln()))
            .sum()
    }
}

impl<const N: usize> Gaussian<N> {
    /// The posterior in Joseph form.
    ///
    /// # Errors
    /// [`FilterFault`] where the innovation's covariance can't be factored or a result is not finite.
    pub fn corrected(&self, innovation: &Innovation<N>) -> Result<(Self, Evidence), FilterFault> {
        match innovation.len {
            2 => self.corrected_by::<2>(innovation),
            3 => self.corrected_by::<3>(innovation),
            _ => self.corrected_by::<4>(innovation),
        }
    }

    fn corrected_by<const M: usize>(
        &self,
        innovation: &Innovation<N>,
    ) -> Result<(Self, Evidence), FilterFault> {
        // H picks components: H P is rows of P, H P Hᵀ their columns.
        let rows = &innovation.rows[..M];
        let residual = SVector::<f64, M>::from_fn(|m, _| innovation.residual[m]);
        let observed = SMatrix::<f64, M, N>::from_fn(|m, column| self.covariance[(rows[m], column)]);
        let mut spread = SMatrix::<f64, M, M>::from_fn(|m, other| observed[(m, rows[other])]);
        for m in 0..M {
            spread[(m, m)] += innovation.variance[m];
        }
        let factor = spread.cholesky().ok_or(FilterFault::NotPositive)?;
        let gain = factor.solve(&observed).transpose();
        let mut kept = SMatrix::<f64, N, N>::identity();
        let mut noisy = gain;
        for (m, &row) in rows.iter().enumerate() {
            for component in 0..N {
                kept[(component, row)] -= gain[(component, m)];
                noisy[(component, m)] *= innovation.variance[m];
            }
        }
        let covariance = kept * self.covariance * kept.transpose() + noisy * gain.transpose();
        let posterior = Self { mean: self.mean + gain * residual, covariance: symmetrised(&covariance) };
        let nis = residual.dot(&factor.solve(&residual));
        let log_root: f64 = (0..M).map(|row| factor.l_dirty()[(row, row)].ln()).sum();
        let log_likelihood = -0.5 * (nis + M as f64 * TAU.ln()) - log_root;
        if posterior.is_finite() && log_likelihood.is_finite() {
            Ok((posterior, Evidence { nis, log_likelihood, measured_len: M }))
        } else {
            Err(FilterFault::NotFinite)
        }
    }
}
