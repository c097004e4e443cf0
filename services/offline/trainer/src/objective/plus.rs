//! The objective of preset `plus`: best of the learned points, by the unsquared distance. \[model §5\]

use nn::ModelConfig;
use wire::AgentType;

use super::draws::{DRAWS, Draws};
use super::loss::{LossParts, Objective, add_mean_gradient};
use crate::net::dense::perceptron_backward;
use crate::net::gru;
use crate::net::matrix::Matrix;
use crate::net::motion::{noisy_controls, noisy_controls_backward};
use crate::net::score::{
    Truth, energy_score, mode_cross_entropy, one_hot, trajectory_error, trajectory_error_backward,
};
use crate::net::tensors::Gradients;
use crate::rollout::{Rollout, TypeForecast};

/// The plus objective of a batch.
pub(super) struct Plus<'a> {
    pub(super) objective: &'a Objective,
    pub(super) config: &'a ModelConfig,
    /// Number of counted agents in the whole batch.
    pub(super) counted: f32,
    /// Completed share of the training.
    pub(super) done: f32,
}

/// The best modes of every agent.
struct Winners {
    /// By the mean error.
    mean: Vec<usize>,
    /// By the error of the last step.
    last: Vec<usize>,
    /// By the sum that the loss weighs.
    both: Vec<usize>,
}

/// The weights of [`Objective::Plus`] for one agent of a type, divided by the number of agents.
struct Scale {
    draws: [f32; DRAWS],
    probability: f32,
    spread: f32,
    last_step: f32,
}

impl Plus<'_> {
    /// Adds the gradients of the agents of one type. Returns their parts of the loss.
    pub(super) fn backward(
        &self,
        forecast: &TypeForecast<'_>,
        gradients: &mut Gradients,
        d_encoding: &mut Matrix,
        draws: &Draws,
    ) -> LossParts {
        let scale = self.scale(forecast.agent_type);
        let winners = self.winners(forecast, scale.last_step);
        let modes: Vec<usize> = (0..forecast.agents.len())
            .flat_map(|agent| {
                [winners.mean[agent], winners.last[agent], draws.modes[agent], self.config.modes]
            })
            .collect();
        let rollout = forecast.by_points(&modes, true);
        let mut d_raw = Matrix::zeros(rollout.unroll.raw.rows, rollout.unroll.raw.cols);
        let [trajectory, single] = displacement(forecast, &rollout, &scale, &mut d_raw);
        let spread = energy(forecast, &rollout, &scale, &mut d_raw, draws);
        let d_latent = forecast.backward(gradients, &rollout, &d_raw, d_encoding);
        forecast.points_backward(gradients, &modes, &d_latent);
        let probability = self.probabilities(forecast, &winners.both, &scale, gradients);
        LossParts { trajectory, single, probability, spread }
    }

    fn scale(&self, agent_type: AgentType) -> Scale {
        let Objective::Plus { random_mode, single, probability, spread, vehicle, last_step, .. } =
            *self.objective
        else {
            unreachable!("the plus objective is computed for Objective::Plus alone")
        };
        let vehicle = if agent_type == AgentType::Vehicle { vehicle } else { 1.0 };
        let per_agent = |weight: f64| (weight * vehicle) as f32 / self.counted;
        Scale {
            draws: [1.0, 1.0, random_mode * f64::from(1.0 - self.done), single].map(per_agent),
            probability: per_agent(probability),
            spread: per_agent(spread) / DRAWS as f32,
            last_step: last_step as f32,
        }
    }

    /// The best modes of every agent by the network's own forecasts. Only the modes that are nearest by the
    /// base control are compared.
    fn winners(&self, forecast: &TypeForecast<'_>, last_step: f32) -> Winners {
        let modes_len = self.config.modes;
        let candidates = match *self.objective {
            Objective::Plus { candidates, .. } => candidates.clamp(1, modes_len),
            Objective::Paper { .. } => modes_len,
        };
        let agents_len = forecast.agents.len();
        let (positions, counts) = forecast.truth();
        let errors = |trajectories: &Matrix, last_step: f32| {
            let draw_count = trajectories.rows / agents_len;
            let truth = Truth { positions: &positions, counts: &counts, draw_count };
            trajectory_error(trajectories, &truth, last_step)
        };
        let all: Vec<usize> = (0..agents_len).flat_map(|_| 0..modes_len).collect();
        let near: Vec<usize> = if candidates == modes_len || !self.config.base {
            all
        } else {
            let by_base = errors(&forecast.positions(&forecast.base(&all)), last_step);
            by_base.chunks_exact(modes_len).flat_map(|errors| smallest(errors, candidates)).collect()
        };
        let per_agent = near.len() / agents_len;
        let forecasts = forecast.by_points(&near, false).positions;
        let (mean, with_last) = (errors(&forecasts, 0.0), errors(&forecasts, 1.0));
        let best = |error: &dyn Fn(f32, f32) -> f32| {
            let errors: Vec<f32> = mean.iter().zip(&with_last).map(|(m, l)| error(*m, l - m)).collect();
            let of_agent =
                |(agent, errors): (usize, &[f32])| near[agent * per_agent + smallest(errors, 1)[0]];
            errors.chunks_exact(per_agent).enumerate().map(of_agent).collect()
        };
        Winners {
            mean: best(&|mean, _| mean),
            last: best(&|_, last| last),
            both: best(&|mean, last| mean + last_step * last),
        }
    }

    /// Cross-entropy of the mode probabilities to the winners.
    fn probabilities(
        &self,
        forecast: &TypeForecast<'_>,
        winners: &[usize],
        scale: &Scale,
        gradients: &mut Gradients,
    ) -> f32 {
        let name = forecast.name();
        let hidden = &forecast.burn_in.hidden;
        let (logits, trace) = gru::mode_logits(forecast.weights(), &name, &forecast.encoding, hidden);
        let target = one_hot(winners, self.config.modes);
        let weights = vec![scale.probability; winners.len()];
        let (entropy, d_logits) = mode_cross_entropy(&logits, &target, &weights);
        let mode_head = format!("{name}.mode");
        perceptron_backward(forecast.weights(), gradients, &mode_head, &trace, d_logits, false);
        if scale.probability == 0.0 { 0.0 } else { entropy / scale.probability / self.counted }
    }
}

/// Displacement of the draws. Adds its gradient to `d_raw` and returns the mean errors of the winners and of
/// the single best forecast. The first winner is scored by the mean over the steps, the second by the last
/// step, and the others by both.
fn displacement(
    forecast: &TypeForecast<'_>,
    rollout: &Rollout,
    scale: &Scale,
    d_raw: &mut Matrix,
) -> [f32; 2] {
    let (positions, counts) = forecast.truth();
    let truth = Truth { positions: &positions, counts: &counts, draw_count: DRAWS };
    let [by_mean, by_last, any, single] = scale.draws;
    let agents_len = forecast.agents.len();
    // (mean + last) minus mean leaves the last step.
    let parts = [(scale.last_step, [0.0, by_last, any, single]), (0.0, [by_mean, -by_last, 0.0, 0.0])];
    let mut d_positions = Matrix::zeros(rollout.positions.rows, rollout.positions.cols);
    let mut sums = [0.0; 2];
    for (last_step, weights) in parts {
        let weights = weights.repeat(agents_len);
        d_positions.add(&trajectory_error_backward(&rollout.positions, &truth, last_step, &weights));
        let errors = trajectory_error(&rollout.positions, &truth, last_step);
        let sum = |draws: [usize; 2]| {
            let of = |draw: usize| errors.iter().zip(&weights).skip(draw).step_by(DRAWS);
            draws.into_iter().flat_map(of).map(|(error, weight)| error * weight).sum::<f32>()
        };
        sums[0] += sum([0, 1]);
        sums[1] +=
            errors.iter().skip(3).step_by(DRAWS).sum::<f32>() * if last_step > 0.0 { by_mean } else { 0.0 };
    }
    add_mean_gradient(d_raw, &forecast.positions_backward(&rollout.mean, &d_positions));
    sums
}

/// Energy score of the positions under controls drawn about their means. Adds its gradient by the covariances
/// to `d_raw` and returns its mean.
fn energy(
    forecast: &TypeForecast<'_>,
    rollout: &Rollout,
    scale: &Scale,
    d_raw: &mut Matrix,
    draws: &Draws,
) -> f32 {
    let raw = &rollout.unroll.raw;
    let noise = &draws.noise;
    let controls = noise.each_ref().map(|noise| noisy_controls(raw, &rollout.mean, noise));
    let [first, second] = controls.each_ref().map(|controls| forecast.positions(controls));
    let (positions, counts) = forecast.truth();
    let truth = Truth { positions: &positions, counts: &counts, draw_count: DRAWS };
    let row_weights = vec![scale.spread; rollout.mean.rows];
    let (scores, d_positions) = energy_score([&first, &second], &truth, &row_weights);
    for ((noise, controls), d_positions) in noise.iter().zip(&controls).zip(&d_positions) {
        let d_controls = forecast.positions_backward(controls, d_positions);
        noisy_controls_backward(raw, noise, &d_controls, d_raw);
    }
    scores.iter().sum::<f32>() * scale.draws[0] / DRAWS as f32
}

/// Indices of the `len` smallest values, smallest first.
fn smallest(values: &[f32], len: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    order.truncate(len);
    order
}
