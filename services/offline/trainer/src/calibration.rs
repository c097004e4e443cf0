//! Calibration of the covariances on validation data. \[model §5\]
//!
//! **In:** weights and validation scenes. **Out:** one factor per agent type, dimensionless.
//!
//! The energy score trains the shape of the covariances. Their scale on held-out scenes is one factor per
//! agent type, by which all control deviations of the type are multiplied. It is chosen so that the 90 %
//! highest-density regions of the mixtures hold 90 % of the validation's positions, pooled over agents and
//! steps. The factor is folded into the last layer of the decoder, so readers of the weights do not need it.

use std::collections::BTreeMap;

use kinematics::{Belief, ControlGaussian};
use nn::ModelConfig;
use scene::AgentType;

use crate::TrainError;
use crate::agent_view::SceneView;
use crate::base::BaseControl;
use crate::batch::{Batch, BatchOptions};
use crate::net::context::Normalisation;
use crate::net::dense;
use crate::net::graph::encode;
use crate::net::gru::mode_logits;
use crate::net::layout::TYPE_NAMES;
use crate::net::motion::Start;
use crate::net::tensors::Tensors;
use crate::rollout::{RAW, Rollout, TypeForecast};
use crate::samples::{MapKind, Samples};
use crate::view;

/// Share of the positions inside the regions after calibration.
const LEVEL: f64 = 0.9;
/// Maximum number of agents per type in the calibration.
const AGENTS_MAX: usize = 1000;
/// A type with fewer agents is not calibrated.
const AGENTS_MIN: usize = 50;
/// Maximum number of agents shown from a crowd.
const SCENE_AGENTS: usize = 48;
/// Smallest and largest factor.
const FACTORS: [f64; 2] = [0.2, 5.0];
/// Bisection steps for the factor, which then has a precision of 0.1 %.
const HALVINGS: usize = 12;

/// The mixture over the positions of one step, and the true position.
struct Step {
    means_m: Vec<[f32; 2]>,
    covariances: Vec<[f32; 3]>,
    truth_m: [f32; 2],
}

/// The forecasts of one agent.
struct Forecast {
    probability: Vec<f32>,
    steps: Vec<Step>,
}

/// The inputs of calibration.
#[derive(Clone, Copy)]
pub(crate) struct Calibration<'a> {
    pub(crate) config: &'a ModelConfig,
    pub(crate) base: &'a BaseControl,
    pub(crate) validation: &'a Samples,
}

impl Calibration<'_> {
    /// Calibrates every type with enough agents. Returns the factors by type name.
    pub(crate) fn apply(&self, weights: &mut Tensors) -> Result<BTreeMap<String, f64>, TrainError> {
        let forecasts = self.forecasts(weights)?;
        let mut factors = BTreeMap::new();
        for (name, forecasts) in TYPE_NAMES.iter().zip(&forecasts) {
            if forecasts.len() < AGENTS_MIN {
                continue;
            }
            let factor = factor(forecasts);
            widen(weights, name, factor as f32);
            factors.insert((*name).to_owned(), (factor * 1e4).round() / 1e4);
        }
        Ok(factors)
    }

    /// Forecasts by the agents' types, evenly spread over the validation scenes.
    fn forecasts(&self, weights: &Tensors) -> Result<[Vec<Forecast>; 3], TrainError> {
        let mut forecasts = [Vec::new(), Vec::new(), Vec::new()];
        for set in &self.validation.sets {
            let stride = set.counted_count().div_ceil(AGENTS_MAX).max(1);
            for window in set.windows.iter().step_by(stride) {
                let map = self.validation.map(window.recording, MapKind::Online);
                let scene = self.validation.scene(window)?;
                self.add(weights, &view::plain(&scene, map, SCENE_AGENTS), &mut forecasts)?;
            }
        }
        Ok(forecasts)
    }

    fn add(
        &self,
        weights: &Tensors,
        scene: &SceneView<'_>,
        forecasts: &mut [Vec<Forecast>; 3],
    ) -> Result<(), TrainError> {
        let config = self.config;
        let batch = Batch::new(std::slice::from_ref(scene), BatchOptions::of_run(config, self.base))?;
        let encoded = encode(weights, config, &batch.graph, Normalisation::Running, false);
        for (of_type, forecasts) in forecasts.iter_mut().enumerate() {
            let Some(forecast) = TypeForecast::new(weights, config, &batch, &encoded, of_type) else {
                continue;
            };
            let agents_len = forecast.agents.len();
            let modes: Vec<usize> = (0..agents_len).flat_map(|_| 0..config.modes).collect();
            let rollout = forecast.by_points(&modes, false);
            let hidden = &forecast.burn_in.hidden;
            let (logits, _) = mode_logits(weights, &forecast.name(), &forecast.encoding, hidden);
            for agent in 0..agents_len {
                let number = forecast.agents.start + agent;
                let start = &batch.starts[number];
                let rows = agent * config.modes..(agent + 1) * config.modes;
                let modes: Vec<PositionMoments> =
                    rows.map(|row| moments(config, forecast.agent_type, start, &rollout, row)).collect();
                let truth = batch.truth.row(number).as_chunks::<2>().0;
                let known = truth.iter().zip(batch.counts.row(number)).enumerate();
                let steps = known.filter(|(_, (_, counts))| **counts > 0.0).map(|(step, (truth, _))| Step {
                    means_m: modes.iter().map(|mode| mode[step].0).collect(),
                    covariances: modes.iter().map(|mode| mode[step].1).collect(),
                    truth_m: *truth,
                });
                let probability = dense::softmax(logits.row(agent));
                forecasts.push(Forecast { probability, steps: steps.collect() });
            }
        }
        Ok(())
    }
}

/// Mean and covariance (xx, xy, yy) of the position at every step.
type PositionMoments = Vec<([f32; 2], [f32; 3])>;

/// The linearised Gaussian of one row of a rollout, in the agent frame.
fn moments(
    config: &ModelConfig,
    agent_type: AgentType,
    start: &Start,
    rollout: &Rollout,
    row: usize,
) -> PositionMoments {
    let raw = rollout.unroll.raw.row(row).as_chunks::<RAW>().0;
    let means = rollout.mean.row(row).as_chunks::<2>().0;
    let controls = raw.iter().zip(means).map(|(raw, mean)| {
        let cholesky = nn::control_gaussian(*raw).cholesky;
        ControlGaussian::new(*mean, cholesky)
    });
    if agent_type == AgentType::Vehicle {
        let (vehicle, state) = start.bicycle(config);
        let mut belief = Belief::certain(state);
        let steps = controls.map(|control| {
            belief.advance(&vehicle, &control);
            let position = belief.position();
            (position.mean, position.covariance)
        });
        return steps.collect();
    }
    // Displacements are independent, so their covariances add up.
    let mut covariance = [0.0; 3];
    let positions = rollout.positions.row(row).as_chunks::<2>().0;
    let steps = controls.zip(positions).map(|(control, position)| {
        let of_step = control.cholesky * control.cholesky.transpose();
        for (sum, value) in covariance.iter_mut().zip([of_step[(0, 0)], of_step[(0, 1)], of_step[(1, 1)]]) {
            *sum += value;
        }
        (*position, covariance)
    });
    steps.collect()
}

/// The factor at which the regions hold the share [`LEVEL`] of the positions.
fn factor(forecasts: &[Forecast]) -> f64 {
    let [mut low, mut high] = FACTORS.map(f64::ln);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if covered(forecasts, middle.exp()) < LEVEL {
            low = middle;
        } else {
            high = middle;
        }
    }
    (0.5 * (low + high)).exp()
}

/// Share of the positions inside the regions if all deviations are multiplied by `factor`.
fn covered(forecasts: &[Forecast], factor: f64) -> f64 {
    let square = (factor * factor) as f32;
    let (mut inside, mut step_count) = (0_usize, 0_usize);
    for (number, forecast) in forecasts.iter().enumerate() {
        for step in &forecast.steps {
            let covariances: Vec<[f32; 3]> =
                step.covariances.iter().map(|covariance| covariance.map(|value| value * square)).collect();
            let probability = &forecast.probability;
            let level = metrics::highest_density_level(
                &step.means_m,
                &covariances,
                probability,
                step.truth_m,
                number as u64,
            );
            inside += usize::from(level <= LEVEL);
            step_count += 1;
        }
    }
    inside as f64 / step_count.max(1) as f64
}

/// Multiplies the Cholesky factors of a type's controls by `factor`: ln l₁₁ and ln l₂₂ by their biases, l₂₁
/// by its row.
fn widen(weights: &mut Tensors, type_name: &str, factor: f32) {
    let name = |part: &str| format!("decoder.{type_name}.head.{part}");
    if let Some(bias) = weights.0.get_mut(&name("bias")) {
        bias.values[2] += factor.ln();
        bias.values[3] += factor.ln();
        bias.values[4] *= factor;
    }
    if let Some(matrix) = weights.0.get_mut(&name("weight")) {
        let cols = matrix.values.len() / RAW;
        matrix.values[4 * cols..].iter_mut().for_each(|value| *value *= factor);
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    /// A Gaussian with half of the true standard deviation.
    #[test]
    fn a_deviation_of_half_the_true_one_is_doubled() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut normal = || -> f32 { StandardNormal.sample(&mut random) };
        let forecasts: Vec<Forecast> = (0..800)
            .map(|_| Forecast {
                probability: vec![1.0],
                steps: vec![Step {
                    means_m: vec![[0.0; 2]],
                    covariances: vec![[0.25, 0.0, 0.25]],
                    truth_m: [normal(), normal()],
                }],
            })
            .collect();
        let factor = factor(&forecasts);
        assert!((factor - 2.0).abs() < 0.15, "{factor}");
    }

    #[test]
    fn widening_scales_the_cholesky_factor() {
        let config = crate::options::onboard_config();
        let mut weights = crate::net::layout::initial(&config, 1);
        let hidden = crate::net::matrix::Matrix::new(1, 128, vec![0.1; 128]);
        let gaussian = |weights: &Tensors| {
            let raw = dense::dense(weights, "decoder.vehicle.head", &hidden);
            nn::control_gaussian(raw.values.try_into().unwrap())
        };
        let before = gaussian(&weights);
        widen(&mut weights, "vehicle", 1.5);
        let after = gaussian(&weights);
        assert_eq!(before.mean, after.mean);
        for (before, after) in before.cholesky.iter().zip(after.cholesky) {
            assert!((after - 1.5 * before).abs() < 1e-5, "{after} is not 1.5 times {before}");
        }
    }
}
