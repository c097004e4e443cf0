//! The expected residuals of an agent: the kernel mean of its neighbours' residuals, and its shrinkage.

use kinematics::MotionKind;
use wire::HORIZON_MAX;

use crate::Residuals;

/// λ: factor by which the shrinkage's sums decay per residual. About the last thousand residuals count.
const LASTING: f32 = 0.999;
/// ρ: ridge of the regression, in the squared units of residuals, by kind of motion.
const RIDGE: [[f32; 2]; 2] = [[5.0, 2e-3], [0.02, 0.02]];
/// ν: weight of the prior mean 0, in residuals of similarity 1, by kind of motion.
const PRIOR_WEIGHT: [f32; 2] = [1.0, 4.0];

/// The sums of a kernel-weighted mean of residuals.
#[derive(Clone, Debug, Default)]
pub(crate) struct KernelMean {
    /// Σ w
    weights: [[f32; 2]; HORIZON_MAX],
    /// Σ w δ
    sums: [[f32; 2]; HORIZON_MAX],
}

/// How well kernel means have predicted residuals, by step and component: sums of predicted · actual and of
/// predicted².
#[derive(Clone, Debug, Default)]
pub(crate) struct Shrinkage {
    steps: [[(f32, f32); 2]; HORIZON_MAX],
}

impl KernelMean {
    /// Adds the known residuals with a weight.
    pub(crate) fn add(&mut self, weight: f32, residuals: &Residuals) {
        let own = self.weights.as_flattened_mut().iter_mut().zip(self.sums.as_flattened_mut());
        for ((weights, sum), residual) in own.zip(residuals.steps().as_flattened()) {
            let known = !residual.is_nan();
            *weights += if known { weight } else { 0.0 };
            *sum += if known { weight * residual } else { 0.0 };
        }
    }

    /// The Nadaraya–Watson means with a prior, which shrinks them towards 0.
    ///
    /// ```text
    /// Δ_k = Σ w δ_k / (Σ w + ν)      ν = 1 bicycle, 4 displacement
    /// ```
    pub(crate) fn residuals(&self, kind: MotionKind) -> Residuals {
        let prior_weight = PRIOR_WEIGHT[kind as usize];
        Residuals::from_fn(|step, component| {
            let (weights, sum) = (self.weights[step][component], self.sums[step][component]);
            if weights > 0.0 { sum / (weights + prior_weight) } else { f32::NAN }
        })
    }
}

impl Shrinkage {
    /// Updates the sums with a predicted and an actual residual of a step.
    pub(crate) fn learn(&mut self, predicted: &Residuals, step: usize, component: usize, actual: f32) {
        let Some(predicted) = predicted.at(step, component) else { return };
        let (product, square) = &mut self.steps[step][component];
        *product = LASTING * *product + predicted * actual;
        *square = LASTING * *square + predicted * predicted;
    }

    /// The expected residuals for predicted ones: shrunk by the slope of a ridge regression of actual on
    /// predicted residuals so far.
    ///
    /// ```text
    /// Δ'_k = c_k Δ_k      c_k = Σ Δ_k δ_k / (Σ Δ_k² + ρ), within [0, 1]
    /// ```
    ///
    /// At a site of the model's training data, residuals have little in common; elsewhere they have much in
    /// common.
    pub(crate) fn shrink(&self, kind: MotionKind, predicted: &Residuals) -> Residuals {
        Residuals::from_fn(|step, component| {
            let (product, square) = self.steps[step][component];
            let slope = (product / (square + RIDGE[kind as usize][component])).clamp(0.0, 1.0);
            slope * predicted.steps()[step][component]
        })
    }

    /// The sums of `step_count` steps in the file's order.
    pub(crate) fn numbers(&self, step_count: usize) -> impl Iterator<Item = f32> {
        self.steps[..step_count].iter().flatten().flat_map(|&(product, square)| [product, square])
    }

    /// The inverse of [`Shrinkage::numbers`].
    pub(crate) fn of_numbers(numbers: &[f32]) -> Self {
        let mut shrinkage = Self::default();
        let sums = numbers.as_chunks::<2>().0.iter();
        shrinkage.steps.as_flattened_mut().iter_mut().zip(sums).for_each(|(own, sums)| *own = (*sums).into());
        shrinkage
    }
}
