//! What a training step minimises.

use burn::tensor::{Device, Tensor};
use nn::ModelConfig;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use crate::batch::{Batch, floats};
use crate::loss;
use crate::model::{self, LATENT, Statistics};
use crate::parameters::{Weights, host};
use crate::rollout::{Rollout, TypeForecast};

/// Weights of the terms of the loss.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Objective {
    /// γ · mean squared displacement + α · KL + β · MMD of one posterior draw. \[paper, Eq. loss\]
    Paper {
        /// Weight of the displacement.
        gamma: f64,
        /// Weight of the KL divergence.
        alpha: f64,
        /// Weight of the maximum mean discrepancy.
        beta: f64,
        /// Deviation of the posterior.
        sigma: f64,
    },
    /// Best of the learned points, by the unsquared distance.
    Plus {
        /// Weight of a random mode, which keeps modes that never win alive.
        random_mode: f64,
        /// Weight of the point of the single best forecast.
        single: f64,
        /// Weight of the cross-entropy of the mode probabilities to the winner.
        probability: f64,
        /// Weight of the energy score, which calibrates the covariances.
        spread: f64,
        /// Weight of a vehicle beside any other agent: its errors, and even more their gradients, are larger.
        vehicle: f64,
        /// Modes, nearest by the base control, among which the network's own output chooses the winner.
        candidates: usize,
    },
}

impl Objective {
    /// The paper's loss.
    #[must_use]
    pub const fn paper() -> Self {
        Self::Paper { gamma: 1.0, alpha: 0.1, beta: 1.0, sigma: 1.0 }
    }

    /// The default loss.
    #[must_use]
    pub const fn plus() -> Self {
        Self::Plus {
            random_mode: 0.05,
            single: 0.3,
            probability: 0.05,
            spread: 0.05,
            vehicle: 0.3,
            candidates: 8,
        }
    }
}

/// The parts of a loss, for the progress line; which are in use depends on the [`Objective`].
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct LossParts {
    /// Error of the winner, or of the posterior draw.
    pub trajectory: f32,
    /// Error of the single best forecast.
    pub single: f32,
    /// Cross-entropy of the mode probabilities, or KL divergence of the posterior.
    pub probability: f32,
    /// Energy score, or maximum mean discrepancy.
    pub spread: f32,
}

impl LossParts {
    /// These parts moved by `share` towards `new`.
    #[must_use]
    pub(crate) fn mixed(self, new: Self, share: f32) -> Self {
        let mix = |old: f32, new: f32| old + (new - old) * share;
        Self {
            trajectory: mix(self.trajectory, new.trajectory),
            single: mix(self.single, new.single),
            probability: mix(self.probability, new.probability),
            spread: mix(self.spread, new.spread),
        }
    }
}

/// A loss that can be differentiated, its parts, and the new statistics of the batch norms.
pub(crate) struct Step {
    pub(crate) loss: Tensor<1>,
    pub(crate) parts: LossParts,
    pub(crate) statistics: Statistics,
}

/// The loss of a batch; `None` where no agent of it counts.
pub(crate) fn loss(
    objective: &Objective,
    config: &ModelConfig,
    (leaves, frozen): (&Weights, &Weights),
    batch: &Batch,
    random: &mut impl Rng,
) -> Option<Step> {
    let counted = host(batch.counts.clone().max_dim(1).sum())[0];
    if counted == 0.0 {
        return None;
    }
    let mut statistics = Statistics::new();
    let encoded = model::encode(leaves, config, &batch.graph, &mut statistics);
    let forecasts: Vec<TypeForecast<'_>> =
        (0..3).filter_map(|of_type| TypeForecast::new(leaves, config, batch, &encoded, of_type)).collect();
    let terms = match *objective {
        Objective::Plus { candidates, vehicle, .. } => {
            let per_type = forecasts.iter().map(|forecast| {
                let weight = if forecast.agent_type == 0 { vehicle } else { 1.0 };
                plus(forecast, frozen, config, candidates, random).map(|term| term * weight)
            });
            let sums =
                per_type.reduce(|sum, terms| std::array::from_fn(|i| sum[i].clone() + terms[i].clone()))?;
            sums.map(|sum| sum / counted)
        }
        Objective::Paper { sigma, .. } => {
            let future = batch.future.as_ref()?;
            let future = model::encode(leaves, config, future, &mut statistics);
            let mean = model::posterior(leaves, &encoded, &future);
            paper(&forecasts, &mean, sigma, random)?
        }
    };
    let weights = match *objective {
        Objective::Plus { random_mode, single, probability, spread, .. } => {
            [1.0, random_mode, single, probability, spread]
        }
        Objective::Paper { gamma, alpha, beta, .. } => [gamma, 0.0, 0.0, alpha, beta],
    };
    let parts = terms.clone().map(|term| host(term)[0]);
    let parts = LossParts { trajectory: parts[0], single: parts[2], probability: parts[3], spread: parts[4] };
    let weighted = terms.into_iter().zip(weights).map(|(term, weight)| term * weight);
    let loss = weighted.reduce(|sum, term| sum + term)?;
    Some(Step { loss, parts, statistics })
}

/// Sums over the agents of one type: winner, random mode, single best, cross-entropy, energy score.
fn plus(
    forecast: &TypeForecast<'_>,
    frozen: &Weights,
    config: &ModelConfig,
    candidates: usize,
    random: &mut impl Rng,
) -> [Tensor<1>; 5] {
    let agents_len = forecast.agents.len();
    let winners = winners(&forecast.frozen(frozen), config.modes, candidates.clamp(1, config.modes));
    let modes: Vec<usize> = winners
        .iter()
        .flat_map(|&winner| [winner, random.random_range(0..config.modes), config.modes])
        .collect();
    const DRAWS: usize = 3;
    let rollout = forecast.by_points(&modes, DRAWS);
    let (truth, counts) = forecast.truth(DRAWS);
    let error = loss::trajectory_error(loss::distance(rollout.positions.clone(), truth.clone()), &counts);
    let error = error.reshape([agents_len, DRAWS]);
    let of_draw = |draw: usize| error.clone().narrow(1, draw, 1).sum();

    let device = rollout.positions.device();
    let noisy = [0, 1].map(|_| forecast.positions(noisy_controls(&rollout, &device, random), DRAWS));
    let energy = loss::energy_score(noisy, truth, &counts).sum() / DRAWS as f64;

    let counts = forecast.truth(1).1.max_dim(1).reshape([agents_len]);
    let mut one_hot = vec![0.0; agents_len * config.modes];
    winners.iter().enumerate().for_each(|(agent, winner)| one_hot[agent * config.modes + winner] = 1.0);
    let one_hot = floats(one_hot, [agents_len, config.modes], &device.inner());
    let entropy = loss::mode_cross_entropy(forecast.mode_logits(), one_hot) * counts;
    [of_draw(0), of_draw(1), of_draw(2), entropy.sum(), energy]
}

/// Controls drawn about their mean, which gets no gradient: u = μ + L ε.
fn noisy_controls(rollout: &Rollout, device: &Device, random: &mut impl Rng) -> Tensor<3> {
    let shape = rollout.mean.dims();
    let noise: Vec<f32> =
        (0..shape.iter().product()).map(|_| Distribution::<f32>::sample(&StandardNormal, random)).collect();
    let noise = floats(noise, shape, &device.clone().inner());
    let diagonal = rollout.controls.ln_diagonal().exp() * noise.clone();
    let below = rollout.controls.off_diagonal() * noise.narrow(2, 0, 1);
    let below = Tensor::cat(vec![Tensor::zeros_like(&below), below], 2);
    rollout.mean.clone().detach() + diagonal + below
}

/// The mode of every agent with the least error, by the network's own forecasts of the `candidates` modes that are
/// nearest by the base control.
fn winners(forecast: &TypeForecast<'_>, modes_len: usize, candidates: usize) -> Vec<usize> {
    let agents_len = forecast.agents.len();
    let errors = |positions: Tensor<3>, draws_len: usize| {
        let (truth, counts) = forecast.truth(draws_len);
        host(loss::trajectory_error(loss::distance(positions, truth), &counts))
    };
    let all: Vec<usize> = (0..agents_len).flat_map(|_| 0..modes_len).collect();
    let near: Vec<usize> = if candidates == modes_len {
        all
    } else {
        let by_base = errors(forecast.by_base(&all, modes_len), modes_len);
        by_base.chunks_exact(modes_len).flat_map(|errors| smallest(errors, candidates)).collect()
    };
    let errors = errors(forecast.by_points(&near, candidates).positions, candidates);
    let best = errors.chunks_exact(candidates).map(|errors| smallest(errors, 1)[0]);
    best.enumerate().map(|(agent, draw)| near[agent * candidates + draw]).collect()
}

/// Indices of the `len` smallest values, smallest first.
fn smallest(values: &[f32], len: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    order.truncate(len);
    order
}

/// The paper's terms: squared displacement, nothing, nothing, KL divergence, maximum mean discrepancy.
fn paper(
    forecasts: &[TypeForecast<'_>],
    mean: &Tensor<2>,
    sigma: f64,
    random: &mut impl Rng,
) -> Option<[Tensor<1>; 5]> {
    let [agents_len, _] = mean.dims();
    let device = mean.device().inner();
    let mut normal = |rows_len: usize| {
        let values = (0..rows_len * LATENT).map(|_| Distribution::<f32>::sample(&StandardNormal, random));
        floats(values.collect(), [rows_len, LATENT], &device)
    };
    let latent = mean.clone() + normal(agents_len) * sigma;
    let squared = forecasts.iter().map(|forecast| {
        let latent = latent.clone().slice([forecast.agents.clone()]).unsqueeze_dim::<3>(1);
        let (truth, counts) = forecast.truth(1);
        let counted = counts.clone().sum();
        loss::mean_squared_displacement(forecast.with_latent(latent, None).positions, truth, &counts)
            * counted
    });
    let squared = squared.reduce(|sum, term| sum + term)?;
    let counted = forecasts.iter().map(|forecast| forecast.truth(1).1.sum()).reduce(|sum, len| sum + len)?;
    let divergence = loss::kl(mean.clone(), sigma).mean();
    let discrepancy =
        if agents_len > 1 { loss::mmd(&latent, &normal(agents_len)) } else { Tensor::zeros([1], &device) };
    let zero = Tensor::zeros([1], &device);
    Some([squared / counted, zero.clone(), zero, divergence, discrepancy])
}
