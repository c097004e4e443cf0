use nalgebra::{Matrix2, RealField, SMatrix, SVector, Vector2};

/// The Gaussian of a control u = μ + L ε.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlGaussian {
    /// Mean μ.
    pub mean: Vector2<f32>,
    /// Lower Cholesky factor L of the covariance.
    pub cholesky: Matrix2<f32>,
}

impl ControlGaussian {
    /// From μ and L = \[l11, l21, l22\].
    #[must_use]
    pub fn new(mean: [f32; 2], [l11, l21, l22]: [f32; 3]) -> Self {
        Self { mean: Vector2::from(mean), cholesky: Matrix2::new(l11, 0.0, l21, l22) }
    }

    /// Zero mean and independent components.
    #[must_use]
    pub fn centred(deviation: [f32; 2]) -> Self {
        Self::new([0.0; 2], [deviation[0], 0.0, deviation[1]])
    }
}

/// A step and its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linearised<T: RealField, const N: usize> {
    /// The state after the step.
    pub next: SVector<T, N>,
    /// Derivative of the next state with respect to the state, F_s.
    pub by_state: SMatrix<T, N, N>,
    /// Derivative of the next state with respect to the control, F_u.
    pub by_control: SMatrix<T, N, 2>,
}

/// A motion model with `N` state components and two control components. The first two state components are
/// the position.
pub trait Motion<const N: usize> {
    /// The saturated `control`, and the derivative of each component with respect to the same unsaturated
    /// component.
    fn saturate(&self, control: &Vector2<f32>) -> (Vector2<f32>, Vector2<f32>);

    /// The Gaussian of the saturated control: the saturated mean and the factor J L. J is the slope of the
    /// saturation at the mean. \[model §4\]
    #[must_use]
    fn acting(&self, control: &ControlGaussian) -> ControlGaussian {
        let (mean, slope) = self.saturate(&control.mean);
        let mut cholesky = control.cholesky;
        for row in 0..2 {
            cholesky.row_mut(row).scale_mut(slope[row]);
        }
        ControlGaussian { mean, cholesky }
    }

    /// The state one step later under a saturated control.
    #[must_use]
    fn step(&self, state: &SVector<f32, N>, control: &Vector2<f32>) -> SVector<f32, N>;

    /// Like [`Motion::step`], with derivatives.
    #[must_use]
    fn linearise(&self, state: &SVector<f32, N>, control: &Vector2<f32>) -> Linearised<f32, N>;
}
