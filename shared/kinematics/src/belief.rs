use nalgebra::{RealField, SMatrix, SVector};

use crate::{ControlGaussian, Moments, Motion, Normals};

/// A Gaussian over the state of an agent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief<const N: usize> {
    /// Mean.
    pub mean: SVector<f32, N>,
    /// Covariance, symmetric.
    pub covariance: SMatrix<f32, N, N>,
}

impl<const N: usize> Belief<N> {
    /// A state without uncertainty.
    #[must_use]
    pub fn certain(mean: SVector<f32, N>) -> Self {
        Self { mean, covariance: SMatrix::zeros() }
    }

    /// Moves the belief one step ahead: the linearised Gaussian.
    ///
    /// ```text
    /// m' = f(m, u)      Σ' = F_s Σ F_sᵀ + F_u S F_uᵀ,  S = J L Lᵀ J
    /// ```
    ///
    /// u is the saturated mean of `control`, and J is the slope of the saturation there. \[model §4\]
    ///
    /// Differs from \[paper\]: the mean is f of the previous mean. Its product with the Jacobian would drop
    /// the affine term.
    pub fn advance(&mut self, motion: &impl Motion<N>, control: &ControlGaussian) {
        self.advance_by(motion, &motion.acting(control));
    }

    /// Like [`Belief::advance`], by an [acting](Motion::acting) control.
    pub fn advance_by(&mut self, motion: &impl Motion<N>, acting: &ControlGaussian) {
        let at = motion.linearise(&self.mean, &acting.mean);
        let noise = at.by_control * acting.cholesky;
        let covariance = at.by_state * self.covariance * at.by_state.transpose() + noise * noise.transpose();
        self.covariance = (covariance + covariance.transpose()) * 0.5;
        self.mean = at.next;
    }

    /// Mean and covariance of the position.
    pub fn position(&self) -> Moments {
        Moments {
            mean: [self.mean[0], self.mean[1]],
            covariance: [self.covariance[(0, 0)], self.covariance[(0, 1)], self.covariance[(1, 1)]],
        }
    }

    /// A state drawn from the belief. Directions without variance keep the mean.
    #[must_use]
    pub fn sample(&self, normals: &mut Normals) -> SVector<f32, N> {
        let noise = SVector::from_fn(|_, _| normals.draw());
        self.mean + semidefinite_cholesky(&self.covariance) * noise
    }
}

/// The lower factor of a positive semidefinite matrix. A pivot that is not positive leaves its column zero.
#[must_use]
pub fn semidefinite_cholesky<T: RealField + Copy, const N: usize>(
    matrix: &SMatrix<T, N, N>,
) -> SMatrix<T, N, N> {
    let mut factor = SMatrix::<T, N, N>::zeros();
    for column in 0..N {
        // The part of an entry that is explained by the previous columns.
        let known = |factor: &SMatrix<T, N, N>, row: usize| {
            (0..column).fold(T::zero(), |sum, k| sum + factor[(row, k)] * factor[(column, k)])
        };
        let pivot = matrix[(column, column)] - known(&factor, column);
        if pivot <= T::zero() {
            continue;
        }
        let root = pivot.sqrt();
        factor[(column, column)] = root;
        for row in column + 1..N {
            factor[(row, column)] = (matrix[(row, column)] - known(&factor, row)) / root;
        }
    }
    factor
}
