//! The training losses, term by term. \[model §5\]

use burn::tensor::{Tensor, activation};

/// Keeps the square root of a distance differentiable at zero, m².
const ROOT_EPSILON: f64 = 1e-6;
/// Scales s of the inverse multiquadric kernels C/(C + ‖·‖²), C = 2 · 32 · s.
const KERNEL_SCALES: [f64; 7] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];

/// Distances `[rows, steps]` between two sets of trajectories `[rows, steps, 2]`.
#[must_use]
pub fn distance(a: Tensor<3>, b: Tensor<3>) -> Tensor<2> {
    let [rows_len, steps_len, _] = a.dims();
    ((a - b).square().sum_dim(2).reshape([rows_len, steps_len]) + ROOT_EPSILON).sqrt()
}

/// Mean over the steps that count plus half of the last one, `[rows]`: `counts` `[rows, steps]` is 1 where the truth is
/// known and 0 elsewhere.
#[must_use]
pub fn trajectory_error(distance: Tensor<2>, counts: &Tensor<2>) -> Tensor<1> {
    let [rows_len, steps_len] = distance.dims();
    let known = distance * counts.clone();
    let mean = known.clone().sum_dim(1) / counts.clone().sum_dim(1).clamp_min(1.0);
    (mean + known.narrow(1, steps_len - 1, 1) * 0.5).reshape([rows_len])
}

/// Mean squared displacement of the posterior's mean trajectory over the steps that count: the paper's first term.
#[must_use]
pub fn mean_squared_displacement(predicted: Tensor<3>, truth: Tensor<3>, counts: &Tensor<2>) -> Tensor<1> {
    let [rows_len, steps_len, _] = predicted.dims();
    let squared = (predicted - truth).square().sum_dim(2).reshape([rows_len, steps_len]) * counts.clone();
    squared.sum() / counts.clone().sum().clamp_min(1.0)
}

/// KL(N(m, σ²) ‖ N(0, I)) of every agent, `[agents]`: ½‖m‖² and what σ adds.
#[must_use]
pub fn kl(mean: Tensor<2>, sigma: f64) -> Tensor<1> {
    let [agents_len, latent_len] = mean.dims();
    let of_sigma = 0.5 * latent_len as f64 * (sigma * sigma - 1.0 - (sigma * sigma).ln());
    mean.square().sum_dim(1).reshape([agents_len]) * 0.5 + of_sigma
}

/// Unbiased squared maximum mean discrepancy between two sets of latents `[n, 32]`, n > 1 each.
#[must_use]
pub fn mmd(a: &Tensor<2>, b: &Tensor<2>) -> Tensor<1> {
    let latent_len = a.dims()[1];
    let kernel = |x: &Tensor<2>, y: &Tensor<2>| {
        let squared = squared_distances(x.clone(), y.clone());
        KERNEL_SCALES
            .map(|scale| {
                let c = 2.0 * latent_len as f64 * scale;
                (squared.clone() + c).recip() * c
            })
            .into_iter()
            .reduce(|sum, kernel| sum + kernel)
            .expect("there are kernel scales")
    };
    let within = |x: &Tensor<2>| {
        let len = x.dims()[0] as f64;
        // The diagonal of every kernel is 1 and does not count.
        (kernel(x, x).sum() - len * KERNEL_SCALES.len() as f64) / (len * (len - 1.0))
    };
    within(a) + within(b) - kernel(a, b).mean() * 2.0
}

/// Squared distances `[n, m]` between the rows of `a` and `b`; exactly zero between equal rows.
fn squared_distances(a: Tensor<2>, b: Tensor<2>) -> Tensor<2> {
    let [a_len, width] = a.dims();
    let b_len = b.dims()[0];
    let a = a.unsqueeze_dim::<3>(1).expand([a_len, b_len, width]);
    let b = b.unsqueeze_dim::<3>(0).expand([a_len, b_len, width]);
    (a - b).square().sum_dim(2).reshape([a_len, b_len])
}

/// Cross-entropy of every agent's mode logits `[agents, modes]` to its winner, a one-hot row of `winner`.
#[must_use]
pub fn mode_cross_entropy(logits: Tensor<2>, winner: Tensor<2>) -> Tensor<1> {
    let agents_len = logits.dims()[0];
    -(activation::log_softmax(logits, 1) * winner).sum_dim(1).reshape([agents_len])
}

/// Energy score of a forecast that is known by two draws, per trajectory `[rows]`:
///
/// ```text
/// ½ (‖X₁ − y‖ + ‖X₂ − y‖) − ½ ‖X₁ − X₂‖        mean over the steps that count
/// ```
///
/// A proper score: on average no spread of the draws does better than the true one, so it calibrates the covariances of
/// the controls by what they do to positions, correlations between steps included.
#[must_use]
pub fn energy_score(draws: [Tensor<3>; 2], truth: Tensor<3>, counts: &Tensor<2>) -> Tensor<1> {
    let [rows_len, ..] = truth.dims();
    let [a, b] = draws;
    let spread = distance(a.clone(), b.clone());
    let score = (distance(a, truth.clone()) + distance(b, truth) - spread) * 0.5 * counts.clone();
    (score.sum_dim(1) / counts.clone().sum_dim(1).clamp_min(1.0)).reshape([rows_len])
}
