//! Compares gradients with central differences.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Random values in ± `scale`.
pub(crate) fn values(len: usize, scale: f32, seed: u64) -> Vec<f32> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..len).map(|_| (random.random::<f32>() * 2.0 - 1.0) * scale).collect()
}

/// A weighted sum of a layer's outputs: a loss whose gradient by them is `weights`.
pub(crate) fn weighted(outputs: &[f32], weights: &[f32]) -> f64 {
    outputs.iter().zip(weights).map(|(y, w)| f64::from(*y) * f64::from(*w)).sum()
}

/// Compares `gradient` of `loss` at `at` with central differences of width `step`, along the gradient itself
/// and along `axes` axes drawn at random.
pub(crate) fn check(
    name: &str,
    at: &[f32],
    gradient: &[f32],
    (step, axes): (f32, usize),
    mut loss: impl FnMut(&[f32]) -> f64,
) {
    assert_eq!(at.len(), gradient.len(), "{name}: length of the gradient");
    let mut difference = |direction: &[f32]| {
        let mut moved = |sign: f32| {
            let moved: Vec<f32> = at.iter().zip(direction).map(|(x, d)| x + sign * step * d).collect();
            loss(&moved)
        };
        (moved(1.0) - moved(-1.0)) / (2.0 * f64::from(step))
    };
    let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
    assert!(norm > 0.0, "{name}: the gradient is zero everywhere");
    let along: Vec<f32> = gradient.iter().map(|g| (f64::from(*g) / norm) as f32).collect();
    let slope = difference(&along);
    assert!(
        (slope - norm).abs() < 0.02 * norm + 1e-4,
        "{name}: {norm} by the backward pass, {slope} by differences"
    );
    let mut random = ChaCha8Rng::seed_from_u64(7);
    for _ in 0..axes {
        let axis = random.random_range(0..at.len());
        let mut direction = vec![0.0; at.len()];
        direction[axis] = 1.0;
        let (ours, slope) = (f64::from(gradient[axis]), difference(&direction));
        assert!(
            (slope - ours).abs() < 0.03 * ours.abs() + 0.01 * norm,
            "{name}[{axis}]: {ours} by the backward pass, {slope} by differences"
        );
    }
}
