//! The terms of the loss and their gradients. \[model §5\]
//!
//! Trajectories are matrices `[rows, horizon × 2]` in agent frames, m. The draws of an agent are in
//! consecutive rows. Each term is a weighted sum over rows or agents. The caller chooses the weights, because
//! it knows the size of the whole batch. Gradients are those of the weighted sum.

mod distance;
mod modes;
mod paper;

pub(crate) use modes::{mode_cross_entropy, one_hot};
pub(crate) use paper::{kl, mmd, squared_displacement};

use self::distance::{distances, distances_backward};
use super::matrix::Matrix;

/// The targets of some trajectories.
#[derive(Clone, Copy)]
pub(crate) struct Truth<'a> {
    /// True positions `[agents, horizon × 2]`.
    pub(crate) positions: &'a Matrix,
    /// 1 if the true position is known and counts, otherwise 0, `[agents, horizon]`.
    pub(crate) counts: &'a Matrix,
    /// Trajectories per agent: row r belongs to agent r / `draw_count`.
    pub(crate) draw_count: usize,
}

impl Truth<'_> {
    /// Weights of an agent's steps `[agents, horizon]`. The weighted sum is the mean over the counted steps,
    /// plus `last` times the last one if it counts.
    fn step_weights(&self, last: f32) -> Matrix {
        let mut weights = self.counts.clone();
        for steps in weights.values.chunks_exact_mut(self.counts.cols.max(1)) {
            let counted = steps.iter().sum::<f32>().max(1.0);
            let end = steps.last().copied().unwrap_or_default() * last;
            steps.iter_mut().for_each(|weight| *weight /= counted);
            steps.last_mut().into_iter().for_each(|weight| *weight += end);
        }
        weights
    }
}

/// Distance to the truth of every row, m: the mean over the counted steps, plus `last_weight` times the
/// distance at the last step.
pub(crate) fn trajectory_error(positions: &Matrix, truth: &Truth<'_>, last_weight: f32) -> Vec<f32> {
    let weights = truth.step_weights(last_weight);
    let distances = distances(positions, truth.positions, truth.draw_count);
    (0..positions.rows).map(|row| dot(weights.row(row / truth.draw_count), distances.row(row))).collect()
}

/// Gradient by the positions of the sum over rows of `row_weights` times [`trajectory_error`].
pub(crate) fn trajectory_error_backward(
    positions: &Matrix,
    truth: &Truth<'_>,
    last_weight: f32,
    row_weights: &[f32],
) -> Matrix {
    let slopes = slopes(truth, last_weight, row_weights);
    distances_backward(positions, truth.positions, truth.draw_count, &slopes)
}

/// Energy score of forecasts with two draws X per row, and the gradients by the draws of its sum weighted by
/// `row_weights`:
///
/// ```text
/// ½ (‖X₁ − y‖ + ‖X₂ − y‖) − ½ ‖X₁ − X₂‖        mean over the steps that count
/// ```
///
/// This score is proper: its expectation is least for the true distribution. So it calibrates the covariances
/// of the controls by the resulting positions, including correlations between steps.
pub(crate) fn energy_score(
    draws: [&Matrix; 2],
    truth: &Truth<'_>,
    row_weights: &[f32],
) -> (Vec<f32>, [Matrix; 2]) {
    let weights = truth.step_weights(0.0);
    let to_truth = draws.map(|draw| distances(draw, truth.positions, truth.draw_count));
    let between = distances(draws[0], draws[1], 1);
    let score = |row: usize| {
        let mean = |distances: &Matrix| dot(weights.row(row / truth.draw_count), distances.row(row));
        0.5 * (mean(&to_truth[0]) + mean(&to_truth[1]) - mean(&between))
    };
    let scores = (0..between.rows).map(score).collect();

    let halves: Vec<f32> = row_weights.iter().map(|weight| 0.5 * weight).collect();
    let slopes = slopes(truth, 0.0, &halves);
    let apart = distances_backward(draws[0], draws[1], 1, &slopes);
    let [mut first, mut second] =
        draws.map(|draw| distances_backward(draw, truth.positions, truth.draw_count, &slopes));
    first.values.iter_mut().zip(&apart.values).for_each(|(by_first, apart)| *by_first -= apart);
    second.add(&apart);
    (scores, [first, second])
}

/// Gradient of a weighted sum of step errors by the error of each step `[rows, horizon]`.
fn slopes(truth: &Truth<'_>, last_weight: f32, row_weights: &[f32]) -> Matrix {
    let weights = truth.step_weights(last_weight);
    assert_eq!(row_weights.len(), weights.rows * truth.draw_count, "a weight for every row");
    let mut slopes = Vec::with_capacity(row_weights.len() * weights.cols);
    for (row, row_weight) in row_weights.iter().enumerate() {
        slopes.extend(weights.row(row / truth.draw_count).iter().map(|weight| weight * row_weight));
    }
    Matrix::new(row_weights.len(), weights.cols, slopes)
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests;
