//! Linear layers and perceptrons.

use super::matrix::{Into, Matrix, by_bias, by_input, by_matrix, forward};
use super::tensors::{Gradients, Tensors};

/// `x Wᵀ + b` with the matrix `name.weight` `[out, in]` and `name.bias`.
pub(crate) fn dense(weights: &Tensors, name: &str, x: &Matrix) -> Matrix {
    let matrix = weights.matrix(&format!("{name}.weight"));
    let bias = weights.get(&format!("{name}.bias"));
    let mut y = Matrix::new(x.rows, matrix.rows, bias.repeat(x.rows));
    forward(x.view(), matrix, y.view_mut(), Into::Add);
    y
}

/// Adds to the gradients of a linear layer; `x` is its input and `dy` the gradient of its output.
pub(crate) fn dense_weights_backward(gradients: &mut Gradients, name: &str, x: &Matrix, dy: &Matrix) {
    by_matrix(dy.view(), x.view(), gradients.matrix_mut(&format!("{name}.weight")));
    by_bias(dy, gradients.get_mut(&format!("{name}.bias")));
}

/// Gradient of a linear layer by its input.
pub(crate) fn dense_input_backward(weights: &Tensors, name: &str, dy: &Matrix) -> Matrix {
    let matrix = weights.matrix(&format!("{name}.weight"));
    let mut dx = Matrix::zeros(dy.rows, matrix.cols);
    by_input(dy.view(), matrix, dx.view_mut(), Into::Replace);
    dx
}

/// max(x, 0) in place.
pub(crate) fn relu(values: &mut Matrix) {
    values.values.iter_mut().for_each(|value| *value = value.max(0.0));
}

/// Sets the gradient to zero at the zeros of the rectified values.
pub(crate) fn relu_backward(rectified: &Matrix, gradient: &mut Matrix) {
    for (gradient, value) in gradient.values.iter_mut().zip(&rectified.values) {
        if *value <= 0.0 {
            *gradient = 0.0;
        }
    }
}

/// The inputs of a perceptron's layers.
#[derive(Debug)]
pub(crate) struct PerceptronTrace(Vec<Matrix>);

/// `layers` linear layers `name.0`, `name.1`, … with a ReLU between each two, but not after the last.
pub(crate) fn perceptron(
    weights: &Tensors,
    name: &str,
    layers: usize,
    x: Matrix,
) -> (Matrix, PerceptronTrace) {
    let mut inputs = vec![x];
    for layer in 0..layers {
        let mut y = dense(weights, &format!("{name}.{layer}"), &inputs[layer]);
        if layer + 1 < layers {
            relu(&mut y);
        }
        inputs.push(y);
    }
    let y = inputs.pop().unwrap_or_default();
    (y, PerceptronTrace(inputs))
}

/// The backward pass of [`perceptron`]; computes the gradient by its input only if `by_input`.
pub(crate) fn perceptron_backward(
    weights: &Tensors,
    gradients: &mut Gradients,
    name: &str,
    trace: &PerceptronTrace,
    mut dy: Matrix,
    by_input: bool,
) -> Option<Matrix> {
    for (layer, x) in trace.0.iter().enumerate().rev() {
        let name = format!("{name}.{layer}");
        dense_weights_backward(gradients, &name, x, &dy);
        if layer == 0 && !by_input {
            return None;
        }
        dy = dense_input_backward(weights, &name, &dy);
        if layer > 0 {
            relu_backward(x, &mut dy);
        }
    }
    Some(dy)
}

/// Probabilities of logits.
pub(crate) fn softmax(logits: &[f32]) -> Vec<f32> {
    let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let exponentials: Vec<f32> = logits.iter().map(|logit| (logit - largest).exp()).collect();
    let sum: f32 = exponentials.iter().sum();
    exponentials.iter().map(|value| value / sum).collect()
}
