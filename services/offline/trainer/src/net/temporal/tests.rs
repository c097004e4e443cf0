use super::*;
use crate::net::tensors::TensorRole;
use crate::tests::check::{check, values, weighted};
use crate::tests::golden::Golden;

const SLOPE: f32 = 0.1;
/// Three agents: one with a gap, one that is never present, one with a single step.
const STEPS: [u32; 12] = [0, 1, ABSENT, 2, ABSENT, ABSENT, ABSENT, ABSENT, ABSENT, ABSENT, 3, ABSENT];
const STEPS_LEN: usize = 4;
const ROWS: usize = 4;

const USUAL: Reading =
    Reading { leaky_slope: SLOPE, attention: Attention::Dual, temporal: Temporal::ValueMatrix };

/// All readings, with the number of heads of their scores.
const READINGS: [(Reading, usize); 5] = [
    (USUAL, 4),
    (USUAL, 2),
    (Reading { temporal: Temporal::Literal, ..USUAL }, NODE),
    (Reading { attention: Attention::Equal, ..USUAL }, 4),
    (Reading { attention: Attention::Equal, temporal: Temporal::Literal, ..USUAL }, NODE),
];

fn weights(reading: Reading, heads: usize) -> Tensors {
    let mut weights = Tensors::default();
    if reading.attention == Attention::Dual || reading.temporal == Temporal::Literal {
        weights.insert(SCORE, &[heads, NODE], values(heads * NODE, 0.5, 1), TensorRole::Learned);
    }
    if reading.temporal == Temporal::ValueMatrix {
        weights.insert(VALUE, &[NODE, NODE], values(NODE * NODE, 0.3, 2), TensorRole::Learned);
    }
    weights
}

fn node() -> Matrix {
    Matrix::new(ROWS, NODE, values(ROWS * NODE, 1.0, 3))
}

#[test]
fn gradients_agree_with_differences_in_every_reading() {
    for (reading, heads) in READINGS {
        let (weights, node) = (weights(reading, heads), node());
        let d_encoding = Matrix::new(3, NODE, values(3 * NODE, 1.0, 4));
        let loss = |weights: &Tensors, node: &Matrix| {
            weighted(&temporal(weights, reading, node, &STEPS, STEPS_LEN).encoding.values, &d_encoding.values)
        };
        let mut gradients = Gradients::zeros(&weights);
        let summary = temporal(&weights, reading, &node, &STEPS, STEPS_LEN);
        let by_node = summary.backward(&weights, &mut gradients, &node, &STEPS, &d_encoding);
        check(&format!("{reading:?}: node"), &node.values, &by_node.values, (1e-3, 40), |moved| {
            loss(&weights, &Matrix::new(ROWS, NODE, moved.to_vec()))
        });
        for (name, (_, gradient)) in &gradients.0 {
            check(&format!("{reading:?}: {name}"), weights.get(name), gradient, (1e-3, 40), |moved| {
                let mut weights = weights.clone();
                weights.0.get_mut(name).unwrap().values = moved.to_vec();
                loss(&weights, &node)
            });
        }
    }
}

#[test]
fn the_present_steps_of_an_agent_sum_to_one() {
    let summary = temporal(&weights(USUAL, 4), USUAL, &node(), &STEPS, STEPS_LEN);
    let [mut first, mut third] = [[0.0; 4]; 2];
    for step in 0..3 {
        first.iter_mut().zip(summary.beta.row(step)).for_each(|(sum, beta)| *sum += beta);
    }
    third.copy_from_slice(summary.beta.row(3));
    assert_eq!(summary.beta.rows, ROWS);
    assert!([first, third].as_flattened().iter().all(|sum| (sum - 1.0).abs() < 1e-6), "{first:?}, {third:?}");
    assert_eq!(summary.encoding.row(1), [0.0; NODE]);
}

#[test]
fn equal_attention_is_a_mean() {
    let reading = Reading { attention: Attention::Equal, ..USUAL };
    let summary = temporal(&weights(reading, 4), reading, &node(), &STEPS, STEPS_LEN);
    assert_eq!(summary.beta.values, [1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0, 1.0]);
}

#[test]
fn an_absent_agent_gives_no_gradient() {
    let (weights, node) = (weights(USUAL, 4), node());
    let mut gradients = Gradients::zeros(&weights);
    let mut d_encoding = Matrix::zeros(3, NODE);
    d_encoding.row_mut(1).fill(1.0);
    let summary = temporal(&weights, USUAL, &node, &STEPS, STEPS_LEN);
    let by_node = summary.backward(&weights, &mut gradients, &node, &STEPS, &d_encoding);
    assert_eq!(by_node, Matrix::zeros(ROWS, NODE));
    assert_eq!(gradients, Gradients::zeros(&weights));
}

#[test]
fn summaries_agree_with_the_reference() {
    for golden in Golden::all() {
        for part in ["history", "future"] {
            let graph = golden.graph(part);
            let last = format!("{part}.topo{}.node", golden.config.rounds - 1);
            let node = golden.rows(&last, graph.rows.iter().cloned());
            let node = Matrix::new(graph.rows.len(), NODE, node);
            let reading = Reading::of(&golden.config);
            let summary = temporal(&golden.weights, reading, &node, &graph.steps, graph.step_count);
            let beta = golden.rows(&format!("{part}.beta"), graph.rows.iter().cloned());
            golden.check(&format!("{part}.beta"), &summary.beta.values, &beta);
            let name = format!("{part}.temporal");
            golden.check(&name, &summary.encoding.values, &golden.tensor(&name).1);
        }
    }
}
