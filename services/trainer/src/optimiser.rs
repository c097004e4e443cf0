//! Adam with gradient clipping, a warmed-up cosine schedule, and the running average that is shipped.

use std::collections::BTreeMap;

use burn::tensor::{Gradients, Tensor};

use crate::parameters::{Parameters, Role, Weights, host};

/// What [`Adam`] is set to.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiserOptions {
    /// Highest learning rate, reached after the warm-up.
    pub learning_rate: f64,
    /// Steps over which the rate climbs from zero.
    pub warm_up_steps: u64,
    /// Greatest Euclidean norm of the whole gradient; a longer one is scaled down.
    pub clip_norm: f64,
    /// Decay of the running average of the weights, reached gradually.
    pub average_decay: f64,
}

impl Default for OptimiserOptions {
    fn default() -> Self {
        Self { learning_rate: 1.5e-3, warm_up_steps: 100, clip_norm: 10.0, average_decay: 0.995 }
    }
}

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
const EPSILON: f64 = 1e-8;

/// First and second moment of one tensor's gradient.
#[derive(Clone, Debug)]
pub(crate) struct Moments {
    pub(crate) first: Tensor<1>,
    pub(crate) second: Tensor<1>,
}

/// Adam's state and the running average of the weights.
#[derive(Clone, Debug)]
pub struct Adam {
    options: OptimiserOptions,
    /// Updates made so far.
    pub(crate) steps: u64,
    pub(crate) moments: BTreeMap<String, Moments>,
    pub(crate) average: Parameters,
}

impl Adam {
    /// An optimiser that starts from `parameters`.
    #[must_use]
    pub fn new(options: OptimiserOptions, parameters: &Parameters) -> Self {
        let learned = parameters.tensors.iter().filter(|(_, parameter)| parameter.role == Role::Learned);
        let moments = learned.map(|(name, parameter)| {
            let zeros = Tensor::zeros_like(&parameter.value);
            (name.clone(), Moments { first: zeros.clone(), second: zeros })
        });
        Self { options, steps: 0, moments: moments.collect(), average: parameters.clone() }
    }

    /// The running average of the weights.
    #[must_use]
    pub fn average(&self) -> &Parameters {
        &self.average
    }

    /// Learning rate of update `step` (from zero) out of `steps`: linear warm-up, then half a cosine down to zero.
    #[must_use]
    pub fn rate(&self, step: u64, steps: u64) -> f64 {
        let warm_up = self.options.warm_up_steps.max(1);
        if step < warm_up {
            return self.options.learning_rate * (step + 1) as f64 / warm_up as f64;
        }
        let done = (step - warm_up) as f64 / steps.saturating_sub(warm_up).max(1) as f64;
        self.options.learning_rate * 0.5 * (1.0 + (std::f64::consts::PI * done.min(1.0)).cos())
    }

    /// Moves `parameters` against the gradient of `weights` at learning rate `rate`; returns the gradient's norm
    /// before clipping. A gradient that is not finite moves nothing.
    pub fn step(
        &mut self,
        parameters: &mut Parameters,
        weights: &Weights,
        mut gradients: Gradients,
        rate: f64,
    ) -> f64 {
        let gradients: Vec<(String, Tensor<1>)> = self
            .moments
            .keys()
            .filter_map(|name| Some((name.clone(), weights.leaf(name)?.grad_remove(&mut gradients)?)))
            .collect();
        let square: f64 =
            gradients.iter().map(|(_, gradient)| f64::from(host(gradient.clone().square().sum())[0])).sum();
        let norm = square.sqrt();
        if !norm.is_finite() {
            return norm;
        }
        let scale = if norm > self.options.clip_norm { self.options.clip_norm / norm } else { 1.0 };
        self.steps += 1;
        let exponent = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let (first_bias, second_bias) = (1.0 - BETA_1.powi(exponent), 1.0 - BETA_2.powi(exponent));
        for (name, gradient) in gradients {
            let (Some(moments), Some(parameter)) =
                (self.moments.get_mut(&name), parameters.tensors.get_mut(&name))
            else {
                continue;
            };
            let gradient = gradient * scale;
            moments.first = moments.first.clone() * BETA_1 + gradient.clone() * (1.0 - BETA_1);
            moments.second = moments.second.clone() * BETA_2 + gradient.square() * (1.0 - BETA_2);
            let deviation = (moments.second.clone() / second_bias).sqrt() + EPSILON;
            parameter.value = parameter.value.clone() - moments.first.clone() / deviation * (rate / first_bias);
        }
        self.update_average(parameters);
        norm
    }

    fn update_average(&mut self, parameters: &Parameters) {
        let steps = self.steps as f64;
        let decay = self.options.average_decay.min((1.0 + steps) / (10.0 + steps));
        for (name, average) in &mut self.average.tensors {
            if let Some(parameter) = parameters.tensors.get(name)
                && parameter.role != Role::Fixed
            {
                average.value = average.value.clone() * decay + parameter.value.clone() * (1.0 - decay);
            }
        }
    }
}
