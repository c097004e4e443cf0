//! Samples the Gaussian controls of the decoder's head. \[model §3, Decoder\]

use std::ops::RangeInclusive;

use super::super::matrix::Matrix;

/// Columns of a step in the head's output: μ₁, μ₂, ln l₁₁, ln l₂₂, l₂₁.
const RAW: usize = 5;
/// The range to which ln l₁₁ and ln l₂₂ are clamped.
const LN_DIAGONAL: RangeInclusive<f32> = -5.0..=2.0;

/// Controls sampled about their mean, u = μ + L ε with `noise` ε `[rows, horizon × 2]` from N(0, I).
///
/// ```text
/// L = | l₁₁  0  |
///     | l₂₁ l₂₂ |
/// ```
///
/// Only L comes from the head's output `raw` `[rows, horizon × 5]`. `mean` has the shape of the noise and
/// includes the base control.
pub(crate) fn noisy_controls(raw: &Matrix, mean: &Matrix, noise: &Matrix) -> Matrix {
    assert_shapes(raw, [mean, noise]);
    let diagonal = diagonal(raw);
    let mut controls = mean.clone();
    for (((control, raw), noise), diagonal) in
        pairs_mut(&mut controls).iter_mut().zip(steps(raw)).zip(pairs(noise)).zip(&diagonal)
    {
        control[0] += diagonal[0] * noise[0];
        control[1] += diagonal[1] * noise[1] + raw[4] * noise[0];
    }
    controls
}

/// The backward pass of [`noisy_controls`]: adds to the gradient by the columns of L in `d_raw`. The mean has
/// no gradient here.
pub(crate) fn noisy_controls_backward(raw: &Matrix, noise: &Matrix, d_controls: &Matrix, d_raw: &mut Matrix) {
    assert_shapes(raw, [noise, d_controls]);
    assert_eq!((raw.rows, raw.cols), (d_raw.rows, d_raw.cols), "shape of the gradient");
    let diagonal = diagonal(raw);
    let d_steps = d_raw.values.as_chunks_mut::<RAW>().0.iter_mut();
    for ((((d_step, raw), noise), d_control), diagonal) in
        d_steps.zip(steps(raw)).zip(pairs(noise)).zip(pairs(d_controls)).zip(&diagonal)
    {
        for axis in 0..2 {
            if LN_DIAGONAL.contains(&raw[2 + axis]) {
                d_step[2 + axis] += d_control[axis] * noise[axis] * diagonal[axis];
            }
        }
        d_step[4] += d_control[1] * noise[0];
    }
}

/// l₁₁ and l₂₂ of every step.
fn diagonal(raw: &Matrix) -> Vec<[f32; 2]> {
    let held = |ln: f32| ln.clamp(*LN_DIAGONAL.start(), *LN_DIAGONAL.end());
    let mut diagonal: Vec<[f32; 2]> = steps(raw).iter().map(|step| [held(step[2]), held(step[3])]).collect();
    nn::kernels::exp_in_place(diagonal.as_flattened_mut());
    diagonal
}

fn steps(raw: &Matrix) -> &[[f32; RAW]] {
    raw.values.as_chunks().0
}

fn pairs(matrix: &Matrix) -> &[[f32; 2]] {
    matrix.values.as_chunks().0
}

fn pairs_mut(matrix: &mut Matrix) -> &mut [[f32; 2]] {
    matrix.values.as_chunks_mut().0
}

fn assert_shapes(raw: &Matrix, pairs: [&Matrix; 2]) {
    for matrix in pairs {
        assert_eq!(
            (raw.rows, raw.cols * 2),
            (matrix.rows, matrix.cols * RAW),
            "shape beside the raw controls"
        );
    }
}
