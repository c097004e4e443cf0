use super::*;
use crate::net::dense::perceptron_backward;
use crate::net::tensors::TensorRole;
use crate::tests::check::{check, values, weighted};
use crate::tests::golden::Golden;

const NAME: &str = "decoder.pedestrian";
const MODES: usize = 4;

/// Random weights of a decoder.
fn weights() -> Tensors {
    let mut weights = Tensors::default();
    let shapes: [(&str, &[usize]); 10] = [
        ("gru.weight_ih", &[GATES, FEATURES + ENCODING + LATENT]),
        ("gru.weight_hh", &[GATES, HIDDEN]),
        ("gru.bias_ih", &[GATES]),
        ("gru.bias_hh", &[GATES]),
        ("head.weight", &[CONTROL, HIDDEN]),
        ("head.bias", &[CONTROL]),
        ("mode.0.weight", &[64, ENCODING + HIDDEN]),
        ("mode.0.bias", &[64]),
        ("mode.1.weight", &[MODES, 64]),
        ("mode.1.bias", &[MODES]),
    ];
    for (seed, (name, shape)) in shapes.into_iter().enumerate() {
        let len = shape.iter().product();
        weights.insert(&format!("{NAME}.{name}"), shape, values(len, 0.15, seed as u64), TensorRole::Learned);
    }
    weights
}

fn matrix(rows: usize, cols: usize, seed: u64) -> Matrix {
    Matrix::new(rows, cols, values(rows * cols, 1.0, seed))
}

/// States and presence of agents that appear late, disappear early or miss a step.
fn history(agents_len: usize, step_count: usize) -> (Matrix, Matrix) {
    let absent = |agent: usize, step: usize| match agent % 4 {
        0 => step < 2,
        1 => step == 3,
        2 => step + 1 == step_count,
        _ => false,
    };
    let present = (0..agents_len * step_count).map(|i| f32::from(!absent(i / step_count, i % step_count)));
    (matrix(agents_len, step_count * FEATURES, 20), Matrix::new(agents_len, step_count, present.collect()))
}

/// Hidden states, encodings and latent variables.
fn inputs(agents_len: usize, draw_count: usize) -> [Matrix; 3] {
    [
        matrix(agents_len, HIDDEN, 30),
        matrix(agents_len, ENCODING, 31),
        matrix(agents_len * draw_count, LATENT, 32),
    ]
}

/// Compares the gradients by `tensors` with differences of `loss` in the weights.
fn check_tensors(
    weights: &Tensors,
    gradients: &mut Gradients,
    tensors: &[&str],
    loss: impl Fn(&Tensors) -> f64,
) {
    for tensor in tensors {
        let name = format!("{NAME}.{tensor}");
        let gradient = gradients.get_mut(&name).to_vec();
        check(tensor, weights.get(&name), &gradient, (1e-2, 8), |values| {
            let mut moved = weights.clone();
            moved.insert(&name, &weights.tensor(&name).shape, values.to_vec(), TensorRole::Learned);
            loss(&moved)
        });
    }
}

#[test]
fn gradients_of_the_burn_in_agree_with_differences() {
    let weights = weights();
    let (state, present) = history(6, 5);
    let d_hidden = matrix(6, HIDDEN, 21);
    let mut gradients = Gradients::zeros(&weights);
    burn_in(&weights, NAME, &state, &present).backward(&weights, &mut gradients, d_hidden.clone());
    check_tensors(
        &weights,
        &mut gradients,
        &["gru.weight_ih", "gru.weight_hh", "gru.bias_ih", "gru.bias_hh"],
        |weights| weighted(&burn_in(weights, NAME, &state, &present).hidden.values, &d_hidden.values),
    );
}

#[test]
fn absent_steps_do_not_count() {
    let weights = weights();
    let (state, present) = history(7, 6);
    let whole = burn_in(&weights, NAME, &state, &present);
    for agent in 0..7 {
        let steps = (0..6).filter(|&step| present.row(agent)[step] > 0.0);
        let states: Vec<f32> =
            steps.flat_map(|step| &state.row(agent)[step * FEATURES..][..FEATURES]).copied().collect();
        let step_count = states.len() / FEATURES;
        let state = Matrix::new(1, states.len(), states);
        let alone = burn_in(&weights, NAME, &state, &Matrix::new(1, step_count, vec![1.0; step_count]));
        let difference = alone.hidden.values.iter().zip(whole.hidden.row(agent)).map(|(a, b)| (a - b).abs());
        assert!(difference.fold(0.0, f32::max) < 1e-6, "agent {agent}");
    }
}

#[test]
fn gradients_of_the_forecast_agree_with_differences() {
    let weights = weights();
    let [hidden, encoding, latent] = inputs(3, 2);
    let d_raw = matrix(6, 4 * CONTROL, 33);
    let mut gradients = Gradients::zeros(&weights);
    let loss = |weights: &Tensors, hidden: &Matrix, encoding: &Matrix, latent: &Matrix| {
        weighted(&unroll(weights, (NAME, hidden, encoding, latent), 4, false).raw.values, &d_raw.values)
    };
    let kept = unroll(&weights, (NAME, &hidden, &encoding, &latent), 4, true);
    let by = kept.backward(&weights, &mut gradients, &d_raw);
    check_tensors(
        &weights,
        &mut gradients,
        &["gru.weight_ih", "gru.weight_hh", "gru.bias_ih", "gru.bias_hh", "head.weight", "head.bias"],
        |weights| loss(weights, &hidden, &encoding, &latent),
    );
    let with = |like: &Matrix, values: &[f32]| Matrix::new(like.rows, like.cols, values.to_vec());
    let width = (1e-2, 8);
    check("hidden", &hidden.values, &by.hidden.values, width, |values| {
        loss(&weights, &with(&hidden, values), &encoding, &latent)
    });
    check("encoding", &encoding.values, &by.encoding.values, width, |values| {
        loss(&weights, &hidden, &with(&encoding, values), &latent)
    });
    check("latent", &latent.values, &by.latent.values, width, |values| {
        loss(&weights, &hidden, &encoding, &with(&latent, values))
    });
}

#[test]
fn gradients_of_the_mode_head_agree_with_differences() {
    let weights = weights();
    let [hidden, encoding, _] = inputs(5, 1);
    let d_logits = matrix(5, MODES, 34);
    let mut gradients = Gradients::zeros(&weights);
    let (_, trace) = mode_logits(&weights, NAME, &encoding, &hidden);
    let name = format!("{NAME}.mode");
    perceptron_backward(&weights, &mut gradients, &name, &trace, d_logits.clone(), false);
    check_tensors(
        &weights,
        &mut gradients,
        &["mode.0.weight", "mode.0.bias", "mode.1.weight", "mode.1.bias"],
        |weights| weighted(&mode_logits(weights, NAME, &encoding, &hidden).0.values, &d_logits.values),
    );
}

/// Largest difference, relative to the largest value.
fn apart(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
    found.iter().zip(expected).fold(0.0_f32, |most, (a, b)| most.max((a - b).abs())) / largest
}

/// Burn-in and forecast, forward and backward. Returns the forecast, the gradients by the weights and the
/// gradients by the latent variables.
fn forward_and_backward(weights: &Tensors, agents: &[u32], draw_count: usize) -> (Matrix, Gradients, Matrix) {
    let (state, present) = history(2 * BLOCK, 5);
    let [_, encoding, latent] = inputs(2 * BLOCK, draw_count);
    let d_raw = matrix(latent.rows, 3 * CONTROL, 35);
    let rows: Vec<u32> = agents
        .iter()
        .flat_map(|&agent| (0..draw_count as u32).map(move |draw| agent * draw_count as u32 + draw))
        .collect();
    let mut gradients = Gradients::zeros(weights);
    let burnt = burn_in(weights, NAME, &state.gather(agents), &present.gather(agents));
    let forecast =
        unroll(weights, (NAME, &burnt.hidden, &encoding.gather(agents), &latent.gather(&rows)), 3, true);
    let by = forecast.backward(weights, &mut gradients, &d_raw.gather(&rows));
    burnt.backward(weights, &mut gradients, by.hidden);
    (forecast.raw, gradients, by.latent)
}

#[test]
fn a_batch_of_many_blocks_is_the_sum_of_its_agents() {
    let weights = weights();
    let agents: Vec<u32> = (0..2 * BLOCK as u32 - 7).collect();
    let (raw, gradients, latent) = forward_and_backward(&weights, &agents, 3);
    let mut sum = Gradients::zeros(&weights);
    for &agent in &agents {
        let (alone, gradients, by_latent) = forward_and_backward(&weights, &[agent], 3);
        sum.add(&gradients);
        let first = agent as usize * 3;
        assert_eq!(alone.values, raw.values[first * raw.cols..][..3 * raw.cols], "forecast of {agent}");
        let latent = &latent.values[first * LATENT..][..3 * LATENT];
        assert!(apart(&by_latent.values, latent) < 1e-5, "gradient by the draws of {agent}");
    }
    for ((name, (_, sum)), (_, found)) in sum.0.iter().zip(gradients.0.values()) {
        if !name.contains(".mode.") {
            assert!(apart(found, sum) < 1e-4, "{name}: {}", apart(found, sum));
        }
    }
}

#[test]
fn a_trace_changes_no_bit_of_the_forecast() {
    let weights = weights();
    let [hidden, encoding, latent] = inputs(41, 5);
    let [with, without] =
        [true, false].map(|keep| unroll(&weights, (NAME, &hidden, &encoding, &latent), 12, keep).raw);
    assert_eq!(with, without);
}

#[test]
fn no_agents_or_draws_give_empty_results() {
    let weights = weights();
    let mut gradients = Gradients::zeros(&weights);
    let zeros = gradients.clone();
    for agents_len in [0, 3] {
        let (state, present) = history(agents_len, 5);
        let burnt = burn_in(&weights, NAME, &state, &present);
        let [hidden, encoding, latent] = inputs(agents_len, 0);
        let forecast = unroll(&weights, (NAME, &hidden, &encoding, &latent), 12, true);
        assert_eq!((forecast.raw.rows, forecast.raw.cols), (0, 12 * CONTROL));
        let by = forecast.backward(&weights, &mut gradients, &forecast.raw);
        assert_eq!(by.hidden, Matrix::zeros(agents_len, HIDDEN));
        burnt.backward(&weights, &mut gradients, by.hidden);
    }
    assert_eq!(gradients, zeros);
}

#[test]
fn forecasts_agree_with_the_golden_vectors() {
    for golden in Golden::all() {
        for (agent_type, type_name) in ["vehicle", "cyclist", "pedestrian"].into_iter().enumerate() {
            let agents: Vec<usize> =
                (0..golden.types.len()).filter(|&agent| golden.types[agent] == agent_type).collect();
            let step_count = golden.config.history_len;
            let by_step =
                || agents.iter().flat_map(|&agent| (0..step_count).map(move |step| vec![step, agent]));
            let state = golden.rows("history.state", by_step());
            let state = Matrix::new(agents.len(), step_count * FEATURES, state);
            let present = by_step().map(|at| f32::from(golden.present(at[0], at[1]))).collect();
            let present = Matrix::new(agents.len(), step_count, present);
            let encoding = golden.rows("history.temporal", agents.iter().map(|&agent| vec![agent]));
            let encoding = Matrix::new(agents.len(), ENCODING, encoding);
            let draw_count = golden.tensor("latent.z").0[0];
            let by_draw =
                || agents.iter().flat_map(|&agent| (0..draw_count).map(move |draw| vec![draw, agent]));
            let latent = golden.rows("latent.z", by_draw());
            let latent = Matrix::new(agents.len() * draw_count, LATENT, latent);
            let name = format!("decoder.{type_name}");
            let hidden = burn_in(&golden.weights, &name, &state, &present).hidden;
            let horizon_len = golden.config.horizon_len;
            let raw = unroll(&golden.weights, (&name, &hidden, &encoding, &latent), horizon_len, false).raw;
            if !agents.is_empty() {
                golden.check("decoder.raw", &raw.values, &golden.rows("decoder.raw", by_draw()));
            }
        }
    }
}
