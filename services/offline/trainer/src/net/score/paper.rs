//! The terms of the loss of preset `paper`. \[paper, Eq. loss\] \[model §5\]

use super::super::matrix::{Into, Matrix, by_input, forward};
use super::Truth;
use crate::kernel::kernel;

/// Scales s of the inverse multiquadric kernels C/(C + ‖·‖²), C = 2 · 32 · s for latents of 32 components.
const KERNEL_SCALES: [f32; 7] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];

/// Squared displacements from the truth, summed over the counted steps and multiplied by `weight`, and the
/// gradient by the positions. The paper's mean has `weight` = 1 / number of steps.
pub(crate) fn squared_displacement(positions: &Matrix, truth: &Truth<'_>, weight: f32) -> (f32, Matrix) {
    assert_eq!(positions.rows, truth.positions.rows * truth.draw_count, "rows of trajectories");
    assert_eq!(positions.cols, truth.positions.cols, "steps of trajectories");
    let mut gradient = positions.clone();
    let mut sum = 0.0;
    for row in 0..positions.rows {
        let agent = row / truth.draw_count;
        let steps = gradient.row_mut(row).as_chunks_mut::<2>().0.iter_mut();
        let known = truth.positions.row(agent).as_chunks::<2>().0.iter().zip(truth.counts.row(agent));
        for (step, (truth, counts)) in steps.zip(known) {
            let [x, y] = [step[0] - truth[0], step[1] - truth[1]];
            sum += counts * (x * x + y * y);
            *step = [x, y].map(|difference| 2.0 * weight * counts * difference);
        }
    }
    (weight * sum, gradient)
}

/// KL(N(m, σ²) ‖ N(0, I)) of every agent's `mean` `[agents, latent]`: ½‖m‖² plus a term of σ. The gradient by
/// m is m.
pub(crate) fn kl(mean: &Matrix, sigma: f32) -> Vec<f32> {
    let of_sigma = 0.5 * mean.cols as f32 * (sigma * sigma - 1.0 - 2.0 * sigma.ln());
    let squared = |row: &[f32]| row.iter().map(|value| value * value).sum::<f32>();
    (0..mean.rows).map(|agent| 0.5 * squared(mean.row(agent)) + of_sigma).collect()
}

/// Unbiased squared maximum mean discrepancy between two sets of latents, `[n, latent]` with n > 1 each, and
/// its gradient by `a`.
pub(crate) fn mmd(a: &Matrix, b: &Matrix) -> (f32, Matrix) {
    assert!(a.rows > 1 && b.rows > 1, "more than one latent in each set, not {} and {}", a.rows, b.rows);
    let of_set = |len: usize| 1.0 / (len as f64 * (len as f64 - 1.0));
    let of_both = -2.0 / (a.rows as f64 * b.rows as f64);
    let (within_a, across) = (Pairs::within(a), Pairs::new(a, b));
    let value =
        of_set(a.rows) * within_a.sum() + of_set(b.rows) * Pairs::within(b).sum() + of_both * across.sum();
    let mut gradient = Matrix::zeros(a.rows, a.cols);
    // Each latent of `a` is on both sides of the kernels within its set.
    within_a.add_gradient((2.0 * of_set(a.rows)) as f32, &mut gradient);
    across.add_gradient(of_both as f32, &mut gradient);
    (value as f32, gradient)
}

/// The kernels of all pairs of rows of `a` and `b`, summed over the scales.
struct Pairs<'a> {
    a: &'a Matrix,
    b: &'a Matrix,
    /// `[a, b]`.
    values: Matrix,
    /// Derivatives by the squared distance `[a, b]`.
    slopes: Matrix,
}

impl<'a> Pairs<'a> {
    fn new(a: &'a Matrix, b: &'a Matrix) -> Self {
        let norms = |x: &Matrix| -> Vec<f32> {
            (0..x.rows).map(|row| x.row(row).iter().map(|value| value * value).sum()).collect()
        };
        let (mut values, mut slopes) = (Matrix::zeros(a.rows, b.rows), Matrix::zeros(a.rows, b.rows));
        forward(a.view(), b.view(), values.view_mut(), Into::Replace);
        kernels(&mut values, &mut slopes, [&norms(a), &norms(b)], a.cols);
        Self { a, b, values, slopes }
    }

    /// Pairs within one set; a row is not paired with itself.
    fn within(a: &'a Matrix) -> Self {
        let mut pairs = Self::new(a, a);
        for row in 0..a.rows {
            pairs.values.row_mut(row)[row] = 0.0;
            pairs.slopes.row_mut(row)[row] = 0.0;
        }
        pairs
    }

    fn sum(&self) -> f64 {
        self.values.values.iter().copied().map(f64::from).sum()
    }

    /// Adds the gradient by the left rows of `weight` times the sum: Σ_j 2 k'_ij (a_i − b_j).
    fn add_gradient(mut self, weight: f32, gradient: &mut Matrix) {
        self.slopes.values.iter_mut().for_each(|slope| *slope *= -2.0 * weight);
        by_input(self.slopes.view(), self.b.view(), gradient.view_mut(), Into::Add);
        for row in 0..self.a.rows {
            let sum: f32 = self.slopes.row(row).iter().sum();
            gradient.row_mut(row).iter_mut().zip(self.a.row(row)).for_each(|(value, a)| *value -= sum * a);
        }
    }
}

kernel! {
    /// Replaces products a·b by the sum of the kernels of ‖a − b‖², and sets the slopes by ‖a − b‖². `norms`
    /// are the squared norms of the rows of a and of b.
    fn kernels<'a>(
        values: &'a mut Matrix,
        slopes: &'a mut Matrix,
        norms: [&'a [f32]; 2],
        latent_len: usize,
    ) {
        let [a_norms, b_norms] = norms;
        let constants = KERNEL_SCALES.map(|scale| 2.0 * latent_len as f32 * scale);
        for (row, a_norm) in a_norms.iter().enumerate() {
            let columns = values.row_mut(row).iter_mut().zip(slopes.row_mut(row)).zip(b_norms);
            for ((value, slope), b_norm) in columns {
                let squared = (a_norm + b_norm - 2.0 * *value).max(0.0);
                (*value, *slope) = (0.0, 0.0);
                for c in constants {
                    let near = 1.0 / (squared + c);
                    *value += c * near;
                    *slope -= c * near * near;
                }
            }
        }
    }
}
