//! Linear layers, perceptrons and the batch-normalised residual network.

use burn::tensor::{
    Tensor, activation,
    module::{batch_norm, batch_norm_train, conv2d, linear, max_pool2d},
    ops::{ConvOptions, MaxPoolOptions},
};

use crate::parameters::Weights;

/// Number of linear layers of the state and relation perceptrons.
pub(crate) const PERCEPTRON_LAYERS: usize = 4;
const BATCH_NORM_EPSILON: f64 = 1e-5;
/// Weight of a new batch in the running mean and variance.
const BATCH_NORM_MOMENTUM: f64 = 0.1;

/// `x Wᵀ + b` with the stored `[out, in]` matrix `name.weight` and `name.bias`.
pub(crate) fn dense(weights: &Weights, name: &str, input: Tensor<2>) -> Tensor<2> {
    let bias = weights.get::<1>(&format!("{name}.bias"));
    linear(input, weights.get::<2>(&format!("{name}.weight")).transpose(), Some(bias))
}

/// `layers` linear layers `name.0`, `name.1`, … with ReLU between them and none after the last.
pub(crate) fn perceptron(weights: &Weights, name: &str, layers: usize, input: Tensor<2>) -> Tensor<2> {
    (0..layers).fold(input, |values, layer| {
        let values = if layer == 0 { values } else { activation::relu(values) };
        dense(weights, &format!("{name}.{layer}"), values)
    })
}

/// Where the batch norms take their mean and variance from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Normalisation {
    /// From the batch; the running values are moved on.
    Batch,
    /// From the running values, as the onboard network does.
    Running,
}

/// New running values of the batch norms of one forward pass: (tensor name, value).
pub(crate) type Statistics = Vec<(String, Tensor<1>)>;

/// The ResNet-18 context network of one forward pass.
pub(crate) struct ContextNetwork<'a> {
    pub(crate) weights: &'a Weights,
    pub(crate) imagenet_stem: bool,
    pub(crate) normalisation: Normalisation,
    pub(crate) statistics: Statistics,
}

impl ContextNetwork<'_> {
    /// Embeds patches `[n, 3, P, P]` to `[n, 32]`.
    pub(crate) fn forward(&mut self, patches: Tensor<4>) -> Tensor<2> {
        let stem = if self.imagenet_stem { (2, 3) } else { (2, 1) };
        let mut values = self.convolution("conv1", patches, stem.0, stem.1);
        values = activation::relu(self.normalise("bn1", values));
        if self.imagenet_stem {
            values = max_pool2d(values, MaxPoolOptions::new([3, 3]).with_stride([2, 2]).with_padding([1, 1]));
        }
        for stage in 1..=4 {
            for block in 0..2 {
                values = self.block(stage, block, values);
            }
        }
        let [patches_len, channels, ..] = values.dims();
        let pooled = values.reshape([patches_len as i64, channels as i64, -1]).mean_dim(2);
        dense(self.weights, "fe.context.fc", pooled.reshape([patches_len, channels]))
    }

    fn block(&mut self, stage: usize, block: usize, input: Tensor<4>) -> Tensor<4> {
        let name = format!("layer{stage}.{block}");
        let shrinks = stage > 1 && block == 0;
        let stride = if shrinks { 2 } else { 1 };
        let inner = self.convolution(&format!("{name}.conv1"), input.clone(), stride, 1);
        let inner = activation::relu(self.normalise(&format!("{name}.bn1"), inner));
        let inner = self.convolution(&format!("{name}.conv2"), inner, 1, 1);
        let inner = self.normalise(&format!("{name}.bn2"), inner);
        let shortcut = if shrinks {
            let projected = self.convolution(&format!("{name}.downsample.0"), input, stride, 0);
            self.normalise(&format!("{name}.downsample.1"), projected)
        } else {
            input
        };
        activation::relu(inner + shortcut)
    }

    fn convolution(&self, name: &str, input: Tensor<4>, stride: usize, padding: usize) -> Tensor<4> {
        let kernel = self.weights.get::<4>(&format!("fe.context.{name}.weight"));
        conv2d(input, kernel, None, ConvOptions::new([stride, stride], [padding, padding], [1, 1], 1))
    }

    fn normalise(&mut self, name: &str, input: Tensor<4>) -> Tensor<4> {
        let name = format!("fe.context.{name}");
        let scale = self.weights.get::<1>(&format!("{name}.weight"));
        let shift = self.weights.get::<1>(&format!("{name}.bias"));
        let mean = self.weights.get::<1>(&format!("{name}.running_mean"));
        let variance = self.weights.get::<1>(&format!("{name}.running_var"));
        if self.normalisation == Normalisation::Running {
            return batch_norm(input, scale, shift, mean, variance, BATCH_NORM_EPSILON);
        }
        let [patches_len, _, height, width] = input.dims();
        let values_len = (patches_len * height * width) as f64;
        let unbiased = values_len / (values_len - 1.0).max(1.0);
        let batch = batch_norm_train(input, scale, shift, BATCH_NORM_EPSILON);
        let moved = |running: Tensor<1>, new: Tensor<1>| {
            running.inner() * (1.0 - BATCH_NORM_MOMENTUM) + new.inner() * BATCH_NORM_MOMENTUM
        };
        self.statistics.push((format!("{name}.running_mean"), moved(mean, batch.mean)));
        self.statistics.push((format!("{name}.running_var"), moved(variance, batch.variance * unbiased)));
        batch.output
    }
}
