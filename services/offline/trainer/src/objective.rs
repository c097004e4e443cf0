//! The objective of a training step. \[model §5\]
//!
//! **In:** an encoded [`Batch`] and the weights. **Out:** the [`LossParts`] (distances in metres) and the
//! gradients of all learned tensors.

mod draws;
mod loss;
mod paper;
mod plus;

use nn::ModelConfig;

use crate::batch::Batch;
use crate::net::context::Normalisation;
use crate::net::graph::encode;
use crate::net::matrix::Matrix;
use crate::net::tensors::{Gradients, Tensors};
use crate::optimiser::OptimiserOptions;
use crate::rollout::TypeForecast;
pub(crate) use draws::Draws;
pub use loss::{LossParts, Objective};

/// Loss and gradients of a part of a batch.
pub(crate) struct Differentiated {
    pub(crate) gradients: Gradients,
    pub(crate) parts: LossParts,
    /// New running values of the batch norms.
    pub(crate) statistics: Vec<(String, Vec<f32>)>,
}

/// The parts of the network that a step moves.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Learned {
    /// Whether the layers before the decoder learn.
    pub(crate) encoder: bool,
    /// Whether the context network learns, with batch norms by the batch.
    pub(crate) context: bool,
}

impl Learned {
    /// All parts but the frozen ones.
    pub(crate) fn of(options: &OptimiserOptions) -> Self {
        let encoder = !(options.is_frozen("fe.") && options.is_frozen("gdat."));
        Self { encoder, context: !options.is_frozen("fe.context.") }
    }
}

/// The loss of a part of a batch, and its gradients. `counted` is the number of counted agents in the whole
/// batch, and `done` the completed share of the training.
pub(crate) fn differentiate(
    objective: &Objective,
    config: &ModelConfig,
    weights: &Tensors,
    batch: &Batch<'_>,
    (counted, done): (usize, f32),
    draws: &Draws,
    learned: Learned,
) -> Differentiated {
    let mut gradients = Gradients::zeros(weights);
    let normalisation = if learned.context { Normalisation::Batch } else { Normalisation::Running };
    let encoded = encode(weights, config, &batch.graph, normalisation, learned.encoder);
    let mut d_encoding = Matrix::zeros(encoded.encoding.rows, encoded.encoding.cols);
    let forecasts = (0..3).filter_map(|of_type| TypeForecast::new(weights, config, batch, &encoded, of_type));
    let mut parts = LossParts::default();
    match *objective {
        Objective::Plus { .. } => {
            let plus = plus::Plus { objective, config, counted: counted.max(1) as f32, done };
            let mut first = 0;
            for forecast in forecasts {
                let of_type = draws.of(first..first + forecast.agents.len());
                first += forecast.agents.len();
                parts = parts.plus(plus.backward(&forecast, &mut gradients, &mut d_encoding, &of_type));
            }
        }
        Objective::Paper { .. } => {
            let counted = counted.max(1) as f32;
            let paper = paper::Paper { objective, config, weights, counted, normalisation };
            let forecasts: Vec<TypeForecast<'_>> = forecasts.collect();
            parts = paper.backward(batch, &forecasts, &encoded, &mut gradients, &mut d_encoding, draws);
        }
    }
    if learned.encoder {
        encoded.backward(weights, config, &mut gradients, &batch.graph, &d_encoding);
    }
    Differentiated { gradients, parts, statistics: encoded.statistics().to_vec() }
}

#[cfg(test)]
mod tests;
