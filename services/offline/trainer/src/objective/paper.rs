//! The objective of preset `paper`: one posterior draw, its divergence from the prior, and the discrepancy of
//! the draws' distribution. \[paper, Eq. loss\] \[model §5\]

use nn::ModelConfig;

use super::draws::Draws;
use super::loss::{LossParts, Objective, add_mean_gradient};
use crate::batch::Batch;
use crate::net::context::Normalisation;
use crate::net::dense::{perceptron, perceptron_backward};
use crate::net::graph::{Encoded, encode};
use crate::net::layout::LATENT;
use crate::net::matrix::Matrix;
use crate::net::score::{Truth, kl, mmd, squared_displacement};
use crate::net::tensors::{Gradients, Tensors};
use crate::rollout::TypeForecast;

/// Layers of the posterior's perceptron.
const ENCODER_LAYERS: usize = 3;

/// The paper's objective of a batch.
pub(super) struct Paper<'a> {
    pub(super) objective: &'a Objective,
    pub(super) config: &'a ModelConfig,
    pub(super) weights: &'a Tensors,
    /// Number of counted agents in the whole batch.
    pub(super) counted: f32,
    pub(super) normalisation: Normalisation,
}

impl Paper<'_> {
    /// Adds all gradients except those through the encodings of the history, which are added to `d_encoding`.
    pub(super) fn backward(
        &self,
        batch: &Batch<'_>,
        forecasts: &[TypeForecast<'_>],
        history: &Encoded,
        gradients: &mut Gradients,
        d_encoding: &mut Matrix,
        draws: &Draws,
    ) -> LossParts {
        let Objective::Paper { gamma, alpha, beta, sigma } = *self.objective else {
            unreachable!("the paper's objective is computed for Objective::Paper alone")
        };
        let Some(future_graph) = &batch.future else { return LossParts::default() };
        let future = encode(self.weights, self.config, future_graph, self.normalisation, true);
        let rows: Vec<u32> =
            forecasts.iter().flat_map(|forecast| forecast.agents.clone()).map(|agent| agent as u32).collect();
        let both = joined(&history.encoding.gather(&rows), &future.encoding.gather(&rows));
        let (mean, trace) = perceptron(self.weights, "encoder", ENCODER_LAYERS, both);

        let [noise, prior] = &draws.noise;
        let mut latent = mean.clone();
        latent.values.iter_mut().zip(&noise.values).for_each(|(z, noise)| *z += sigma as f32 * noise);
        let mut d_latent = Matrix::zeros(latent.rows, latent.cols);
        let steps = self.counted * self.config.horizon_len as f32;
        let weight = gamma as f32 / steps;
        let trajectory = self.displacement(forecasts, &latent, weight, gradients, d_encoding, &mut d_latent);

        let per_agent = 1.0 / self.counted;
        let divergence = kl(&mean, sigma as f32).iter().sum::<f32>() * per_agent;
        let mut spread = 0.0;
        if latent.rows > 1 {
            // The weight of this part of the batch in the discrepancy of the whole batch.
            let share = latent.rows as f32 * per_agent;
            let (discrepancy, gradient) = mmd(&latent, prior);
            spread = discrepancy * share;
            let weight = beta as f32 * share;
            d_latent.values.iter_mut().zip(&gradient.values).for_each(|(sum, d)| *sum += weight * d);
        }
        let weight = alpha as f32 * per_agent;
        d_latent.values.iter_mut().zip(&mean.values).for_each(|(sum, m)| *sum += weight * m);

        let weights = self.weights;
        if let Some(d_both) = perceptron_backward(weights, gradients, "encoder", &trace, d_latent, true) {
            let [d_history, d_future] = [0, 1].map(|side| half(&d_both, side));
            d_encoding.scatter_add(&rows, &d_history);
            let mut by_future = Matrix::zeros(future.encoding.rows, future.encoding.cols);
            by_future.scatter_add(&rows, &d_future);
            future.backward(weights, self.config, gradients, future_graph, &by_future);
        }
        LossParts { trajectory, single: 0.0, probability: divergence, spread }
    }

    /// Squared displacement of the forecasts, with one latent variable per agent.
    fn displacement(
        &self,
        forecasts: &[TypeForecast<'_>],
        latent: &Matrix,
        weight: f32,
        gradients: &mut Gradients,
        d_encoding: &mut Matrix,
        d_latent: &mut Matrix,
    ) -> f32 {
        let (mut sum, mut first) = (0.0, 0);
        for forecast in forecasts {
            let rows = first..first + forecast.agents.len();
            first = rows.end;
            let rollout = forecast.decode(&latent.rows_of(rows.clone()), None, true);
            let (positions, counts) = forecast.truth();
            let truth = Truth { positions: &positions, counts: &counts, draw_count: 1 };
            let (value, d_positions) = squared_displacement(&rollout.positions, &truth, weight);
            sum += value;
            let mut d_raw = Matrix::zeros(rollout.unroll.raw.rows, rollout.unroll.raw.cols);
            add_mean_gradient(&mut d_raw, &forecast.positions_backward(&rollout.mean, &d_positions));
            let by_latent = forecast.backward(gradients, &rollout, &d_raw, d_encoding);
            d_latent.values[rows.start * LATENT..rows.end * LATENT].copy_from_slice(&by_latent.values);
        }
        sum
    }
}

/// Two matrices of the same shape side by side.
fn joined(a: &Matrix, b: &Matrix) -> Matrix {
    let rows = (0..a.rows).flat_map(|row| [a.row(row), b.row(row)]).flatten().copied();
    Matrix::new(a.rows, a.cols + b.cols, rows.collect())
}

/// The left (0) or right (1) half of the columns.
fn half(matrix: &Matrix, side: usize) -> Matrix {
    let width = matrix.cols / 2;
    let rows = (0..matrix.rows).flat_map(|row| &matrix.row(row)[side * width..][..width]).copied();
    Matrix::new(matrix.rows, width, rows.collect())
}
