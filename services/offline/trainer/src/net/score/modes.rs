//! The cross-entropy of the mode head.

use super::super::matrix::Matrix;

/// Cross-entropy of mode logits `[agents, modes]` to the probabilities of `target`, whose rows sum to 1.
/// Returns the sum over the agents, weighted by `agent_weights`, and its gradient by the logits.
///
/// ```text
/// Σ_i w_i Σ_k −t_ik ln softmax(l_i)_k        by l_ik:  w_i (softmax(l_i)_k − t_ik)
/// ```
pub(crate) fn mode_cross_entropy(logits: &Matrix, target: &Matrix, agent_weights: &[f32]) -> (f32, Matrix) {
    assert_eq!((logits.rows, logits.cols), (target.rows, target.cols), "a target for every logit");
    assert_eq!(agent_weights.len(), logits.rows, "a weight for every agent");
    let mut gradient = logits.clone();
    let mut sum = 0.0;
    for (agent, weight) in agent_weights.iter().enumerate() {
        let (logits, target) = (gradient.row_mut(agent), target.row(agent));
        let largest = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let ln_sum = largest + logits.iter().map(|logit| (logit - largest).exp()).sum::<f32>().ln();
        for (logit, target) in logits.iter_mut().zip(target) {
            let ln_probability = *logit - ln_sum;
            sum -= weight * target * ln_probability;
            *logit = weight * (ln_probability.exp() - target);
        }
    }
    (sum, gradient)
}

/// The target `[agents, modes]` that is 1 for the winner of every agent and 0 for all other modes.
pub(crate) fn one_hot(winners: &[usize], modes_len: usize) -> Matrix {
    let mut target = Matrix::zeros(winners.len(), modes_len);
    winners.iter().enumerate().for_each(|(agent, &winner)| target.row_mut(agent)[winner] = 1.0);
    target
}
