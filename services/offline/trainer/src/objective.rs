//! The objective of a training step. \[model §5\]
//!
//! **In:** an encoded [`Batch`] and the weights. **Out:** the [`LossParts`] (distances in metres) and the
//! gradients of all learned tensors.

mod loss;
mod paper;
mod plus;

use nn::ModelConfig;
use rand::Rng;

use crate::batch::Batch;
use crate::net::context::Normalisation;
use crate::net::graph::encode;
use crate::net::matrix::Matrix;
use crate::net::tensors::{Gradients, Tensors};
use crate::rollout::TypeForecast;
pub(crate) use loss::LossParts;
pub use loss::Objective;

/// Loss and gradients of a part of a batch.
pub(crate) struct Differentiated {
    pub(crate) gradients: Gradients,
    pub(crate) parts: LossParts,
    /// New running values of the batch norms.
    pub(crate) statistics: Vec<(String, Vec<f32>)>,
}

/// The loss of a part of a batch, and its gradients. `counted` is the number of counted agents in the whole
/// batch, and `done` the completed share of the training.
pub(crate) fn differentiate(
    objective: &Objective,
    config: &ModelConfig,
    weights: &Tensors,
    batch: &Batch<'_>,
    (counted, done): (usize, f32),
    random: &mut impl Rng,
) -> Differentiated {
    let mut gradients = Gradients::zeros(weights);
    let encoded = encode(weights, config, &batch.graph, Normalisation::Batch, true);
    let mut d_encoding = Matrix::zeros(encoded.encoding.rows, encoded.encoding.cols);
    let forecasts = (0..3).filter_map(|of_type| TypeForecast::new(weights, config, batch, &encoded, of_type));
    let mut parts = LossParts::default();
    match *objective {
        Objective::Plus { .. } => {
            let plus = plus::Plus { objective, config, counted: counted.max(1) as f32, done };
            for forecast in forecasts {
                parts = parts.plus(plus.backward(&forecast, &mut gradients, &mut d_encoding, random));
            }
        }
        Objective::Paper { .. } => {
            let paper = paper::Paper { objective, config, weights, counted: counted.max(1) as f32 };
            let forecasts: Vec<TypeForecast<'_>> = forecasts.collect();
            parts = paper.backward(batch, &forecasts, &encoded, &mut gradients, &mut d_encoding, random);
        }
    }
    encoded.backward(weights, config, &mut gradients, &batch.graph, &d_encoding);
    Differentiated { gradients, parts, statistics: encoded.statistics().to_vec() }
}

#[cfg(test)]
mod tests;
