//! Weights of hypotheses and particles: sums in the log domain, effective size and resampling.

/// ln Σ exp(x), without intermediate overflow or underflow. It is −∞ for no values.
#[must_use]
pub fn log_sum_exp(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = values.clone().fold(f64::NEG_INFINITY, f64::max);
    if most == f64::NEG_INFINITY {
        return most;
    }
    most + values.map(|value| (value - most).exp()).sum::<f64>().ln()
}

/// Shifts the logarithms of weights so that the weights sum to 1, if any weight is above 0. `of` returns the
/// logarithm in an item.
///
/// The largest logarithm is subtracted first. It may be so far from 0 that the sum would round the others
/// off.
pub fn normalise<T>(items: &mut [T], of: impl Fn(&mut T) -> &mut f64) {
    let most = items.iter_mut().map(|item| *of(item)).fold(f64::NEG_INFINITY, f64::max);
    if !most.is_finite() {
        return;
    }
    let mut sum = 0.0;
    for item in items.iter_mut() {
        let log_weight = of(item);
        *log_weight -= most;
        sum += log_weight.exp();
    }
    for item in items {
        *of(item) -= sum.ln();
    }
}

/// Effective size of weights that sum to 1, 1 / Σ w²: the number of equal weights that carry the same amount
/// of information.
#[must_use]
pub fn effective_size(weights: impl Iterator<Item = f64>) -> f64 {
    1.0 / weights.map(|weight| weight * weight).sum::<f64>()
}

/// Systematic resampling: the numbers that `chosen_count` equally spaced points (i + u) / len select in the
/// cumulative weights, in rising order. `offset` is u, within \[0, 1). The weights sum to 1.
pub fn systematic(
    weights: impl Iterator<Item = f64>,
    offset: f64,
    chosen_count: usize,
) -> impl Iterator<Item = usize> {
    let mut weights = weights.enumerate();
    let (mut last, mut reached) = weights.next().unwrap_or((0, 1.0));
    (0..chosen_count).map(move |i| {
        let point = (i as f64 + offset) / chosen_count as f64;
        while reached < point {
            // A point beyond the last weight by rounding belongs to the last weight.
            let Some((number, weight)) = weights.next() else { break };
            (last, reached) = (number, reached + weight);
        }
        last
    })
}
