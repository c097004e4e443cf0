use kinematics::semidefinite_cholesky;
use nalgebra::{Const, SMatrix, SVector};
use thiserror::Error;

/// Why a prediction or update failed. The state is unchanged.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum FilterFault {
    /// The innovation's covariance has no Cholesky factor.
    #[error("innovation covariance is not positive definite")]
    NotPositive,
    /// The prediction time exceeds [`GAP_MAX_NS`](crate::GAP_MAX_NS). Its steps would take longer than a
    /// tick.
    #[error("prediction over {0} ns")]
    TooLong(u64),
    /// A mean or covariance is not finite.
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

impl<const N: usize> Gaussian<N> {
    /// Independent components with the given means and variances.
    #[must_use]
    pub fn new(mean: [f64; N], variance: [f64; N]) -> Self {
        Self { mean: mean.into(), covariance: SMatrix::from_diagonal(&SVector::from(variance)) }
    }

    /// The covariance after a step with the given Jacobian and diagonal process noise: J P Jᵀ + Q.
    ///
    /// The Jacobian must be upper triangular. This holds if each component depends only on itself and on
    /// later components, as position does on velocity and velocity on acceleration. The values below the
    /// diagonal are not read.
    #[must_use]
    #[inline]
    pub fn propagated(&self, jacobian: &SMatrix<f64, N, N>, noise: &SVector<f64, N>) -> SMatrix<f64, N, N> {
        debug_assert!(*jacobian == jacobian.upper_triangle(), "{jacobian} is not upper triangular");
        // The upper triangles of J P and of a symmetric product are enough.
        let mut moved = SMatrix::<f64, N, N>::zeros();
        for j in 0..N {
            for i in 0..=j {
                moved[(i, j)] = (i..N).map(|k| jacobian[(i, k)] * self.covariance[(k, j)]).sum();
            }
        }
        let mut propagated = SMatrix::<f64, N, N>::zeros();
        for j in 0..N {
            for i in 0..=j {
                let value: f64 = (j..N).map(|k| moved[(i, k)] * jacobian[(j, k)]).sum();
                propagated[(i, j)] = value;
                propagated[(j, i)] = value;
            }
            propagated[(j, j)] += noise[j];
        }
        propagated
    }

    /// A state drawn from the Gaussian, using standard normal numbers. Directions without variance keep the
    /// mean.
    #[must_use]
    pub fn sample(&self, mut normal: impl FnMut() -> f64) -> SVector<f64, N> {
        self.mean + semidefinite_cholesky(&self.covariance) * SVector::from_fn(|_, _| normal())
    }

    /// Whether all numbers are finite.
    #[inline]
    pub fn is_finite(&self) -> bool {
        // A sum that contains a non-finite number is not finite.
        (self.mean + self.covariance.column_sum()).sum().is_finite()
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

pub(crate) fn symmetrised<const N: usize>(matrix: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N>
where
    Const<N>: nalgebra::DimName,
{
    (matrix + matrix.transpose()) * 0.5
}
