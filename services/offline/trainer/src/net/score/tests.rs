use super::*;
use crate::tests::check::{check, values, weighted};
use crate::tests::golden::Golden;

const STEPS: usize = 5;
const DRAWS: usize = 3;
const AGENTS: usize = 4;
const ROWS: usize = AGENTS * DRAWS;

fn matrix(rows: usize, cols: usize, scale: f32, seed: u64) -> Matrix {
    Matrix::new(rows, cols, values(rows * cols, scale, seed))
}

fn trajectories(seed: u64) -> Matrix {
    matrix(ROWS, STEPS * 2, 2.0, seed)
}

/// True positions and counts: one agent with a complete truth, some without a first or last step, and one
/// that does not count.
fn truth() -> (Matrix, Matrix) {
    let counts = [[1, 1, 1, 1, 1], [0, 1, 0, 1, 1], [1, 1, 1, 0, 0], [0; 5]];
    let counts = counts.as_flattened().iter().map(|&counts| counts as f32).collect();
    (matrix(AGENTS, STEPS * 2, 2.0, 1), Matrix::new(AGENTS, STEPS, counts))
}

/// √(‖a − b‖² + 10⁻⁶) at a step of two rows, in double precision.
fn distance(a: &[f32], b: &[f32], step: usize) -> f64 {
    let squared = |axis: usize| (f64::from(a[2 * step + axis]) - f64::from(b[2 * step + axis])).powi(2);
    (squared(0) + squared(1) + 1e-6).sqrt()
}

#[test]
fn errors_are_means_over_the_steps_that_count_and_the_last() {
    let (positions, (truth, counts)) = (trajectories(2), truth());
    let held = Truth { positions: &truth, counts: &counts, draw_count: DRAWS };
    let errors = trajectory_error(&positions, &held, 0.5);
    for (row, error) in errors.iter().enumerate() {
        let agent = row / DRAWS;
        let counted: Vec<usize> = (0..STEPS).filter(|&step| counts.row(agent)[step] > 0.0).collect();
        let at = |step: usize| distance(positions.row(row), truth.row(agent), step);
        let mean = counted.iter().map(|&step| at(step)).sum::<f64>() / counted.len().max(1) as f64;
        let last = if counted.contains(&(STEPS - 1)) { 0.5 * at(STEPS - 1) } else { 0.0 };
        assert!((f64::from(*error) - mean - last).abs() < 1e-5, "row {row}: {error}");
    }
    assert!(errors[..9].iter().all(|error| *error > 0.0) && errors[9..] == [0.0; 3]);
}

#[test]
fn gradient_of_the_errors_agrees_with_differences() {
    let (positions, (truth, counts)) = (trajectories(2), truth());
    let truth = Truth { positions: &truth, counts: &counts, draw_count: DRAWS };
    let weights = values(ROWS, 1.0, 3);
    let gradient = trajectory_error_backward(&positions, &truth, 0.5, &weights);
    check("trajectory error", &positions.values, &gradient.values, (1e-2, 60), |moved| {
        let moved = Matrix::new(ROWS, STEPS * 2, moved.to_vec());
        weighted(&trajectory_error(&moved, &truth, 0.5), &weights)
    });
}

#[test]
fn a_perfect_forecast_has_a_finite_gradient() {
    let (positions, counts) = truth();
    let truth = Truth { positions: &positions, counts: &counts, draw_count: 1 };
    let weights = [1.0; AGENTS];
    let (scores, gradients) = energy_score([&positions, &positions], &truth, &weights);
    assert!(scores.iter().all(|score| score.abs() < 1e-3), "{scores:?}");
    for gradient in [trajectory_error_backward(&positions, &truth, 0.5, &weights)].iter().chain(&gradients) {
        assert!(gradient.values.iter().all(|value| *value == 0.0), "{gradient:?}");
    }
}

#[test]
fn energy_score_and_gradients_agree_with_the_definition() {
    let (draws, (truth, counts)) = ([trajectories(4), trajectories(5)], truth());
    let held = Truth { positions: &truth, counts: &counts, draw_count: DRAWS };
    let weights = values(ROWS, 1.0, 6);
    let (scores, gradients) = energy_score([&draws[0], &draws[1]], &held, &weights);
    for (row, score) in scores.iter().enumerate() {
        let agent = row / DRAWS;
        let rows = [draws[0].row(row), draws[1].row(row), truth.row(agent)];
        let at = |step: usize| {
            let between = |a: usize, b: usize| distance(rows[a], rows[b], step);
            f64::from(counts.row(agent)[step]) * 0.5 * (between(0, 2) + between(1, 2) - between(0, 1))
        };
        let counted = f64::from(counts.row(agent).iter().sum::<f32>().max(1.0));
        let expected = (0..STEPS).map(at).sum::<f64>() / counted;
        assert!((f64::from(*score) - expected).abs() < 1e-5, "row {row}: {score}, not {expected}");
    }
    for (moving, gradient) in gradients.iter().enumerate() {
        check("energy score", &draws[moving].values, &gradient.values, (1e-2, 60), |moved| {
            let moved = Matrix::new(ROWS, STEPS * 2, moved.to_vec());
            let mut draws = [&draws[0], &draws[1]];
            draws[moving] = &moved;
            weighted(&energy_score(draws, &held, &weights).0, &weights)
        });
    }
}

#[test]
fn cross_entropy_of_a_winner_is_its_negative_log_likelihood() {
    let logits = Matrix::new(2, 3, vec![0.0, 3.0_f32.ln(), 0.0, 1e4, 0.0, -1e4]);
    let (sum, gradient) = mode_cross_entropy(&logits, &one_hot(&[1, 0], 3), &[2.0, 1.0]);
    assert!((sum - 2.0 * (5.0_f32 / 3.0).ln()).abs() < 1e-5, "{sum}");
    let expected = [0.4, -0.8, 0.4, 0.0, 0.0, 0.0];
    for (ours, expected) in gradient.values.iter().zip(expected) {
        assert!((ours - expected).abs() < 1e-5, "{gradient:?}");
    }
}

#[test]
fn gradient_of_the_cross_entropy_agrees_with_differences() {
    const MODES: usize = 6;
    let (logits, weights) = (matrix(AGENTS, MODES, 3.0, 7), values(AGENTS, 1.0, 8));
    let mut target = matrix(AGENTS, MODES, 1.0, 9);
    for row in target.values.chunks_exact_mut(MODES) {
        row.iter_mut().for_each(|share| *share = share.abs());
        let sum: f32 = row.iter().sum();
        row.iter_mut().for_each(|share| *share /= sum);
    }
    let (_, gradient) = mode_cross_entropy(&logits, &target, &weights);
    check("cross-entropy", &logits.values, &gradient.values, (1e-2, 24), |moved| {
        f64::from(mode_cross_entropy(&Matrix::new(AGENTS, MODES, moved.to_vec()), &target, &weights).0)
    });
}

#[test]
fn squared_displacement_agrees_with_the_definition() {
    let (positions, (truth, counts)) = (trajectories(10), truth());
    let held = Truth { positions: &truth, counts: &counts, draw_count: DRAWS };
    let (sum, gradient) = squared_displacement(&positions, &held, 0.25);
    let at = |row: usize, step: usize| {
        let squared = distance(positions.row(row), truth.row(row / DRAWS), step).powi(2) - 1e-6;
        f64::from(counts.row(row / DRAWS)[step]) * squared
    };
    let expected: f64 = (0..ROWS).flat_map(|row| (0..STEPS).map(move |step| at(row, step))).sum();
    assert!((f64::from(sum) - 0.25 * expected).abs() < 1e-3, "{sum}, not a quarter of {expected}");
    check("squared displacement", &positions.values, &gradient.values, (1e-2, 60), |moved| {
        f64::from(squared_displacement(&Matrix::new(ROWS, STEPS * 2, moved.to_vec()), &held, 0.25).0)
    });
}

#[test]
fn gradients_of_the_latent_terms_agree_with_differences() {
    const LATENT: usize = 32;
    let (mean, prior) = (matrix(9, LATENT, 1.5, 11), matrix(13, LATENT, 1.0, 12));
    let (_, gradient) = mmd(&mean, &prior);
    check("mmd", &mean.values, &gradient.values, (0.1, 40), |moved| {
        f64::from(mmd(&Matrix::new(9, LATENT, moved.to_vec()), &prior).0)
    });
    check("kl", &mean.values, &mean.values, (1e-2, 40), |moved| {
        let divergence = kl(&Matrix::new(9, LATENT, moved.to_vec()), 0.5);
        divergence.iter().copied().map(f64::from).sum()
    });
}

#[test]
fn latent_terms_agree_with_the_golden_vectors() {
    for golden in Golden::all() {
        let [posterior, prior] = ["loss.posterior", "loss.prior"].map(|name| {
            let (shape, values) = golden.tensor(name);
            Matrix::new(shape[0], shape[1], values)
        });
        for (sigma, name) in [(1.0, "loss.kl_sigma_1"), (0.5, "loss.kl_sigma_0.5")] {
            golden.check(name, &kl(&posterior, sigma), &golden.tensor(name).1);
        }
        golden.check("loss.mmd", &[mmd(&posterior, &prior).0], &golden.tensor("loss.mmd").1);
    }
}
