//! Adam with gradient clipping, a warmed-up cosine schedule, and the running average of the weights, which
//! becomes the shipped weights.

use std::collections::BTreeMap;

use nn::ModelConfig;

use crate::kernel::kernel;
use crate::net::layout::units;
use crate::net::tensors::{Gradients, TensorRole, Tensors};

/// Parameters of Adam.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimiserOptions {
    /// Largest learning rate, reached after the warm-up.
    pub learning_rate: f64,
    /// Steps over which the rate rises from zero.
    pub warm_up_steps: u64,
    /// Largest Euclidean norm of the whole gradient; a larger one is scaled down.
    pub clip_norm: f64,
    /// Decay of the running average of the weights, reached gradually.
    pub average_decay: f64,
    /// Decoupled weight decay: share of a weight that an update at learning rate 1 subtracts. Biases do not
    /// decay.
    pub weight_decay: f64,
    /// Tensors that keep their values, by the beginnings of their names: `fe.` and `gdat.` are the encoder. A
    /// frozen context network normalises by its running values.
    pub frozen: Vec<String>,
}

impl OptimiserOptions {
    /// Whether the tensors of this name, or all whose names begin with it, keep their values.
    pub(crate) fn is_frozen(&self, name: &str) -> bool {
        self.frozen.iter().any(|frozen| name.starts_with(frozen.as_str()))
    }
}

impl Default for OptimiserOptions {
    fn default() -> Self {
        Self {
            learning_rate: 3e-3,
            warm_up_steps: 200,
            clip_norm: 10.0,
            average_decay: 0.995,
            weight_decay: 0.0,
            frozen: Vec::new(),
        }
    }
}

const BETA_1: f64 = 0.9;
const BETA_2: f64 = 0.999;
const EPSILON: f32 = 1e-8;

/// Adam's moments of one tensor.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Moments {
    pub(crate) first: Vec<f32>,
    pub(crate) second: Vec<f32>,
    /// Units in which the tensor is learned, see [`units`]; empty if all are 1.
    units: Vec<f32>,
}

/// Adam's state and the running average of the weights.
#[derive(Clone, Debug)]
pub(crate) struct Adam {
    options: OptimiserOptions,
    /// Updates made so far.
    pub(crate) steps: u64,
    pub(crate) moments: BTreeMap<String, Moments>,
    pub(crate) average: Tensors,
}

impl Adam {
    /// An optimiser that starts from a model's `weights`.
    pub(crate) fn new(options: OptimiserOptions, config: &ModelConfig, weights: &Tensors) -> Self {
        let learned = weights.0.iter().filter(|(_, tensor)| tensor.role == TensorRole::Learned);
        let moments = learned.map(|(name, tensor)| {
            let zeros = vec![0.0; tensor.values.len()];
            let units = units(config, name, &tensor.shape).unwrap_or_default();
            (name.clone(), Moments { first: zeros.clone(), second: zeros, units })
        });
        Self { options, steps: 0, moments: moments.collect(), average: weights.clone() }
    }

    /// Learning rate of update `step` (from zero) out of `steps`: linear warm-up, then half a cosine down to
    /// zero.
    pub(crate) fn rate(&self, step: u64, steps: u64) -> f64 {
        let warm_up = self.options.warm_up_steps.max(1);
        if step < warm_up {
            return self.options.learning_rate * (step + 1) as f64 / warm_up as f64;
        }
        let done = (step - warm_up) as f64 / steps.saturating_sub(warm_up).max(1) as f64;
        self.options.learning_rate * 0.5 * (1.0 + (std::f64::consts::PI * done.min(1.0)).cos())
    }

    /// Moves `weights` against `gradients` at learning rate `rate`. Returns the gradient's norm before
    /// clipping. A gradient that is not finite leaves the weights unchanged.
    pub(crate) fn step(&mut self, weights: &mut Tensors, gradients: &mut Gradients, rate: f64) -> f64 {
        let mut square = 0.0;
        for ((name, (_, gradient)), moments) in gradients.0.iter_mut().zip(self.moments.values()) {
            if self.options.is_frozen(name) {
                gradient.fill(0.0);
            }
            in_units(gradient, &moments.units);
            square += gradient.iter().map(|&value| f64::from(value) * f64::from(value)).sum::<f64>();
        }
        let norm = square.sqrt();
        if !norm.is_finite() {
            return norm;
        }
        self.steps += 1;
        let exponent = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let scale = if norm > self.options.clip_norm { self.options.clip_norm / norm } else { 1.0 };
        for ((name, (_, gradient)), moments) in gradients.0.iter().zip(self.moments.values_mut()) {
            let Some(tensor) = weights.0.get_mut(name).filter(|_| !self.options.is_frozen(name)) else {
                continue;
            };
            let decays = tensor.shape.len() > 1;
            let keep = if decays { (1.0 - rate * self.options.weight_decay) as f32 } else { 1.0 };
            let rate = (rate / (1.0 - BETA_1.powi(exponent))) as f32;
            let second_bias = (1.0 / (1.0 - BETA_2.powi(exponent))) as f32;
            update(gradient, moments, &mut tensor.values, keep, scale as f32, rate, second_bias);
        }
        self.update_average(weights);
        norm
    }

    fn update_average(&mut self, weights: &Tensors) {
        let steps = self.steps as f64;
        let decay = self.options.average_decay.min((1.0 + steps) / (10.0 + steps)) as f32;
        for (average, tensor) in self.average.0.values_mut().zip(weights.0.values()) {
            if tensor.role != TensorRole::Fixed {
                mix(&mut average.values, &tensor.values, decay);
            }
        }
    }
}

/// Multiplies values by the units in which their parameters are learned. For gradients this is the chain
/// rule; steps are scaled in the same way.
fn in_units(values: &mut [f32], units: &[f32]) {
    values.iter_mut().zip(units).for_each(|(value, unit)| *value *= unit);
}

kernel! {
    /// One tensor's update.
    fn update<'a>(
        gradient: &'a [f32],
        moments: &'a mut Moments,
        values: &'a mut [f32],
        keep: f32,
        scale: f32,
        rate: f32,
        second_bias: f32,
    ) {
        let (beta_1, beta_2) = (BETA_1 as f32, BETA_2 as f32);
        let Moments { first, second, units } = moments;
        let len = values.len();
        let (gradient, first, second) = (&gradient[..len], &mut first[..len], &mut second[..len]);
        for i in 0..len {
            let g = gradient[i] * scale;
            first[i] = first[i] * beta_1 + g * (1.0 - beta_1);
            second[i] = second[i] * beta_2 + g * g * (1.0 - beta_2);
            let change = first[i] / ((second[i] * second_bias).sqrt() + EPSILON) * rate;
            values[i] = values[i] * keep - if units.is_empty() { change } else { change * units[i] };
        }
    }
}

kernel! {
    /// One tensor's running average.
    fn mix<'a>(average: &'a mut [f32], new: &'a [f32], decay: f32) {
        average.iter_mut().zip(new).for_each(|(old, new)| *old = *old * decay + new * (1.0 - decay));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::onboard_config;

    const HEAD: &str = "decoder.vehicle.head.bias";

    fn weights(name: &str, values: &[f32]) -> Tensors {
        let mut weights = Tensors::default();
        weights.insert(name, &[values.len()], values.to_vec(), TensorRole::Learned);
        weights
    }

    /// A step down (value − target)².
    fn update(adam: &mut Adam, weights: &mut Tensors, name: &str, target: f32) -> f64 {
        let mut gradients = Gradients::zeros(weights);
        let values = weights.get(name);
        gradients.get_mut(name).iter_mut().zip(values).for_each(|(g, value)| *g = 2.0 * (value - target));
        adam.step(weights, &mut gradients, 0.05)
    }

    #[test]
    fn the_minimum_of_a_parabola_is_found_and_averaged() {
        let mut weights = weights("a", &[3.0, -2.0]);
        let options = OptimiserOptions { average_decay: 0.9, ..OptimiserOptions::default() };
        let mut adam = Adam::new(options, &onboard_config(), &weights);
        for _ in 0..400 {
            update(&mut adam, &mut weights, "a", 1.0);
        }
        for values in [weights.get("a"), adam.average.get("a")] {
            assert!(values.iter().all(|value| (value - 1.0).abs() < 0.05), "{values:?}");
        }
    }

    #[test]
    fn weights_decay_and_biases_do_not() {
        let mut weights = Tensors::default();
        weights.insert("weight", &[1, 2], vec![1.0, -2.0], TensorRole::Learned);
        weights.insert("bias", &[2], vec![1.0, -2.0], TensorRole::Learned);
        weights.insert("base", &[1, 2], vec![1.0, -2.0], TensorRole::Fixed);
        let options = OptimiserOptions { weight_decay: 0.5, ..OptimiserOptions::default() };
        let mut adam = Adam::new(options, &onboard_config(), &weights);
        let mut gradients = Gradients::zeros(&weights);
        for _ in 0..3 {
            adam.step(&mut weights, &mut gradients, 0.2);
        }
        let kept = 0.9_f32.powi(3);
        for (value, expected) in weights.get("weight").iter().zip([kept, -2.0 * kept]) {
            assert!((value - expected).abs() < 1e-6, "{value} for {expected}");
        }
        assert_eq!([weights.get("bias"), weights.get("base")], [[1.0, -2.0]; 2]);
    }

    #[test]
    fn frozen_tensors_keep_their_values() {
        let mut weights = Tensors::default();
        for name in ["fe.a", "gdat.a", "decoder.a"] {
            weights.insert(name, &[1, 1], vec![1.0], TensorRole::Learned);
        }
        let frozen = ["fe.", "gdat."].map(str::to_owned).to_vec();
        let options = OptimiserOptions { weight_decay: 0.5, frozen, ..OptimiserOptions::default() };
        let mut adam = Adam::new(options, &onboard_config(), &weights);
        let mut gradients = Gradients::zeros(&weights);
        gradients.0.values_mut().for_each(|(_, gradient)| gradient.fill(2.0));
        assert_eq!(adam.step(&mut weights, &mut gradients, 0.2), 2.0);
        assert_eq!([weights.get("fe.a"), weights.get("gdat.a")], [[1.0]; 2]);
        assert!(weights.get("decoder.a")[0] < 1.0);
    }

    #[test]
    fn a_non_finite_gradient_changes_no_weight() {
        let mut weights = weights("a", &[3.0]);
        let mut adam = Adam::new(OptimiserOptions::default(), &onboard_config(), &weights);
        assert!(!update(&mut adam, &mut weights, "a", f32::NAN).is_finite());
        assert_eq!((weights.get("a"), adam.steps), (&[3.0][..], 0));
    }

    #[test]
    fn a_head_is_learned_in_its_units() {
        let mut weights = weights(HEAD, &[0.0; 5]);
        let mut adam = Adam::new(OptimiserOptions::default(), &onboard_config(), &weights);
        update(&mut adam, &mut weights, HEAD, 1.0);
        let units = units(&onboard_config(), HEAD, &[5]).unwrap();
        for (moved, unit) in weights.get(HEAD).iter().zip(units) {
            assert!((moved - 0.05 * unit).abs() < 1e-5, "moved by {moved} in units of {unit}");
        }
    }

    #[test]
    fn the_learning_rate_rises_and_falls_to_zero() {
        let options = OptimiserOptions { warm_up_steps: 100, ..OptimiserOptions::default() };
        let adam = Adam::new(options, &onboard_config(), &weights("a", &[0.0]));
        let rates: Vec<f64> = [0, 49, 99, 550, 1000].map(|step| adam.rate(step, 1000)).to_vec();
        assert!(rates[0] < rates[1] && rates[1] < rates[2] && rates[2] > rates[3], "{rates:?}");
        assert!((rates[3] - 0.5 * rates[2]).abs() < 1e-9 && rates[4] < 1e-12, "{rates:?}");
    }
}
