use nalgebra::{Const, SMatrix, SVector};
use thiserror::Error;

/// Why a prediction or update was not done; the state is as before.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum FilterFault {
    /// The innovation's covariance has no Cholesky factor.
    #[error("innovation covariance is not positive definite")]
    NotPositive,
    /// A mean or covariance came out as not finite.
    #[error("state is not finite")]
    NotFinite,
}

/// A Gaussian over a state of `N` components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian<const N: usize> {
    /// Mean.
    pub mean: SVector<f64, N>,
    /// Covariance, exactly symmetric.
    pub covariance: SMatrix<f64, N, N>,
}

/// A measurement that observes `M` components of the state directly, with independent errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation<const M: usize> {
    /// The components that are observed.
    pub rows: [usize; M],
    /// Measured less predicted; angles wrapped.
    pub residual: [f64; M],
    /// Variance of each measured value.
    pub variance: [f64; M],
}

impl<const N: usize> Gaussian<N> {
    /// The covariance after a step with the given Jacobian and diagonal process noise: J P Jᵀ + Q.
    #[must_use]
    pub fn propagated(&self, jacobian: &SMatrix<f64, N, N>, noise: &SVector<f64, N>) -> SMatrix<f64, N, N> {
        let moved = jacobian * self.covariance * jacobian.transpose() + SMatrix::from_diagonal(noise);
        symmetrised(&moved)
    }

    /// The posterior in Joseph form and the normalised innovation squared.
    ///
    /// # Errors
    /// [`FilterFault`] where the innovation's covariance can't be factored or a result is not finite.
    pub fn corrected<const M: usize>(&self, innovation: &Innovation<M>) -> Result<(Self, f64), FilterFault> {
        let mut observed = SMatrix::<f64, M, N>::zeros();
        for (m, &row) in innovation.rows.iter().enumerate() {
            observed[(m, row)] = 1.0;
        }
        let noise = SMatrix::<f64, M, M>::from_diagonal(&SVector::from(innovation.variance));
        let residual = SVector::from(innovation.residual);
        let cross = self.covariance * observed.transpose();
        let factor = (observed * cross + noise).cholesky().ok_or(FilterFault::NotPositive)?;
        let gain = factor.solve(&cross.transpose()).transpose();
        let kept = SMatrix::<f64, N, N>::identity() - gain * observed;
        let covariance = kept * self.covariance * kept.transpose() + gain * noise * gain.transpose();
        let posterior = Self { mean: self.mean + gain * residual, covariance: symmetrised(&covariance) };
        let nis = residual.dot(&factor.solve(&residual));
        if posterior.is_finite() && nis.is_finite() {
            Ok((posterior, nis))
        } else {
            Err(FilterFault::NotFinite)
        }
    }

    /// Whether all numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.mean.iter().chain(self.covariance.iter()).all(|x| x.is_finite())
    }

    /// The Gaussian of y = f(x) by linearisation: `mean` = f(x), `jacobian` = ∂f/∂x.
    #[must_use]
    pub fn transformed<const R: usize>(
        &self,
        mean: SVector<f64, R>,
        jacobian: &SMatrix<f64, R, N>,
    ) -> Gaussian<R> {
        let covariance = jacobian * self.covariance * jacobian.transpose();
        Gaussian { mean, covariance: symmetrised(&covariance) }
    }
}

fn symmetrised<const N: usize>(matrix: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N>
where
    Const<N>: nalgebra::DimName,
{
    (matrix + matrix.transpose()) * 0.5
}
