//! Adam with gradient clipping, a warmed-up cosine schedule, and the running average that is shipped.

use std::collections::BTreeMap;

use burn::tensor::{Gradients, Tensor};

use crate::model;
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
        Self { learning_rate: 4e-3, warm_up_steps: 100, clip_norm: 10.0, average_decay: 0.99 }
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
    /// Units in which parts of some tensors are learned, see [`units`](model::units).
    units: BTreeMap<String, Tensor<1>>,
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
        let units = parameters.tensors.iter().filter_map(|(name, parameter)| {
            let units = model::units(name, &parameter.shape)?;
            let units = Tensor::from_data(units.as_slice(), &parameter.value.device());
            Some((name.clone(), units))
        });
        Self {
            options,
            steps: 0,
            moments: moments.collect(),
            average: parameters.clone(),
            units: units.collect(),
        }
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
            .filter_map(|name| {
                let gradient = weights.leaf(name)?.grad_remove(&mut gradients)?;
                Some((name.clone(), in_units(gradient, self.units.get(name))))
            })
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
            let change = moments.first.clone() / deviation * (rate / first_bias);
            parameter.value = parameter.value.clone() - in_units(change, self.units.get(&name));
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

/// By the chain rule a gradient, and a step back, is multiplied by the unit that its parameter is learned in.
fn in_units(values: Tensor<1>, units: Option<&Tensor<1>>) -> Tensor<1> {
    match units {
        Some(units) => values * units.clone(),
        None => values,
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;

    const HEAD: &str = "decoder.vehicle.head.bias";

    fn parameters(name: &str, values: &[f32]) -> Parameters {
        let mut parameters = Parameters::default();
        parameters.insert(name, &[values.len()], values.to_vec(), Role::Learned, &Device::flex());
        parameters
    }

    fn update(adam: &mut Adam, parameters: &mut Parameters, name: &str, target: f32) -> f64 {
        let leaves = parameters.leaves();
        let loss = (leaves.get::<1>(name) - target).square().sum();
        adam.step(parameters, &leaves, loss.backward(), 0.05)
    }

    #[test]
    fn the_minimum_of_a_parabola_is_found_and_averaged() {
        let mut parameters = parameters("a", &[3.0, -2.0]);
        let mut adam = Adam::new(OptimiserOptions::default(), &parameters);
        for _ in 0..400 {
            update(&mut adam, &mut parameters, "a", 1.0);
        }
        for values in [parameters.values("a").unwrap(), adam.average().values("a").unwrap()] {
            assert!(values.iter().all(|value| (value - 1.0).abs() < 0.05), "{values:?}");
        }
    }

    #[test]
    fn a_gradient_that_is_no_number_moves_nothing() {
        let mut parameters = parameters("a", &[3.0]);
        let mut adam = Adam::new(OptimiserOptions::default(), &parameters);
        assert!(!update(&mut adam, &mut parameters, "a", f32::NAN).is_finite());
        assert_eq!((parameters.values("a").unwrap(), adam.steps), (vec![3.0], 0));
    }

    #[test]
    fn a_head_moves_in_its_units() {
        let mut parameters = parameters(HEAD, &[0.0; 5]);
        let mut adam = Adam::new(OptimiserOptions::default(), &parameters);
        update(&mut adam, &mut parameters, HEAD, 1.0);
        let moved = parameters.values(HEAD).unwrap();
        let units = model::units(HEAD, &[5]).unwrap();
        for (moved, unit) in moved.iter().zip(units) {
            assert!((moved - 0.05 * unit).abs() < 1e-5, "moved by {moved} in units of {unit}");
        }
    }

    #[test]
    fn the_rate_climbs_and_falls_to_zero() {
        let parameters = parameters("a", &[0.0]);
        let adam = Adam::new(OptimiserOptions::default(), &parameters);
        let rates: Vec<f64> = [0, 49, 99, 550, 1000].map(|step| adam.rate(step, 1000)).to_vec();
        assert!(rates[0] < rates[1] && rates[1] < rates[2] && rates[2] > rates[3], "{rates:?}");
        assert!((rates[3] - 0.5 * rates[2]).abs() < 1e-9 && rates[4] < 1e-12, "{rates:?}");
    }
}
