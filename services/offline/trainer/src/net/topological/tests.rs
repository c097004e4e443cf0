use nn::Attention;

use super::*;
use crate::net::tensors::TensorRole;
use crate::tests::check::{check, values, weighted};
use crate::tests::golden::Golden;

const ROWS: usize = 5;
const SLOPE: f32 = 0.1;
const ROUND: usize = 0;

const EQUAL: AttentionShape = AttentionShape {
    attention: Attention::Equal,
    heads: 4,
    leaky_slope: SLOPE,
    edge_in_message: true,
    distance_scale: true,
};

/// Rows with three, one, zero, four and two incoming edges.
fn edges() -> Edges {
    Edges {
        receiver: vec![0, 0, 0, 1, 3, 3, 3, 3, 4, 4],
        sender: vec![0, 1, 3, 1, 0, 1, 3, 4, 4, 0],
        first: vec![0, 3, 4, 4, 8, 10],
    }
}

fn shapes() -> impl Iterator<Item = AttentionShape> {
    let dual = [(4, true, true), (4, false, false), (2, true, false), (16, false, true)].into_iter().map(
        |(heads, edge_in_message, distance_scale)| AttentionShape {
            attention: Attention::Dual,
            heads,
            leaky_slope: SLOPE,
            edge_in_message,
            distance_scale,
        },
    );
    dual.chain([EQUAL])
}

fn weights(shape: AttentionShape) -> Tensors {
    let mut weights = Tensors::default();
    let mut seed = 0;
    let mut insert = |name: &str, shape: &[usize], scale: f32| {
        seed += 1;
        let values = values(shape.iter().product(), scale, seed);
        weights.insert(&format!("gdat.topological.{ROUND}.{name}"), shape, values, TensorRole::Learned);
    };
    insert("w_n.weight", &[NODE, NODE], 0.3);
    if shape.attention == Attention::Dual {
        insert("lambda_raw", &[shape.heads], 1.0);
        insert("mu_raw", &[shape.heads], 1.0);
    }
    if shape.edge_in_message {
        insert("u_e.weight", &[NODE, EDGE], 0.5);
    }
    insert("edge.0.weight", &[128, 2 * NODE + EDGE], 0.1);
    insert("edge.0.bias", &[128], 0.5);
    insert("edge.1.weight", &[EDGE, 128], 0.2);
    insert("edge.1.bias", &[EDGE], 0.2);
    // Keeps hidden units away from their kinks.
    let bias = weights.0.get_mut(&format!("gdat.topological.{ROUND}.edge.0.bias")).unwrap();
    bias.values.iter_mut().for_each(|bias| *bias += 0.5_f32.copysign(*bias));
    weights
}

/// Node and edge attributes that are close enough for all weights to matter.
fn attributes(edges: &Edges) -> (Matrix, Matrix) {
    let node = Matrix::new(ROWS, NODE, values(ROWS * NODE, 0.2, 20));
    (node, Matrix::new(edges.len(), EDGE, values(edges.len() * EDGE, 0.4, 21)))
}

#[test]
fn gradients_agree_with_differences() {
    let edges = edges();
    let (node, edge) = attributes(&edges);
    for (shape, last) in shapes().flat_map(|shape| [(shape, false), (shape, true)]) {
        let weights = weights(shape);
        let d_node = Matrix::new(ROWS, NODE, values(ROWS * NODE, 1.0, 22));
        let d_edge = Matrix::new(edges.len(), EDGE, values(edges.len() * EDGE, 1.0, 23));
        let loss = |weights: &Tensors, node: &Matrix, edge: &Matrix| {
            let round = round(weights, shape, ROUND, node.clone(), edge.clone(), &edges, last);
            assert_eq!(round.edge.is_none(), last);
            let by_edge = round.edge.map_or(0.0, |edge| weighted(&edge.values, &d_edge.values));
            weighted(&round.node.values, &d_node.values) + by_edge
        };
        let mut gradients = Gradients::zeros(&weights);
        let round = round(&weights, shape, ROUND, node.clone(), edge.clone(), &edges, last);
        let d_edge = (!last).then(|| d_edge.clone());
        let (by_node, by_edge) = round.backward(&weights, &mut gradients, &edges, d_node.clone(), d_edge);
        let at = |name: &str| format!("{shape:?}, last: {last}: {name}");
        check(&at("node"), &node.values, &by_node.values, (5e-4, 40), |moved| {
            loss(&weights, &Matrix::new(ROWS, NODE, moved.to_vec()), &edge)
        });
        check(&at("edge"), &edge.values, &by_edge.values, (5e-4, 40), |moved| {
            loss(&weights, &node, &Matrix::new(edges.len(), EDGE, moved.to_vec()))
        });
        for (name, (_, gradient)) in &gradients.0 {
            if last && name.contains(".edge.") {
                assert!(
                    gradient.iter().all(|gradient| *gradient == 0.0),
                    "{name} has no part in the last round"
                );
                continue;
            }
            // λ and μ have a smooth and small effect.
            let step = if name.ends_with("_raw") { 0.05 } else { 5e-4 };
            check(&at(name), weights.get(name), gradient, (step, 20), |moved| {
                let mut weights = weights.clone();
                weights.0.get_mut(name).unwrap().values = moved.to_vec();
                loss(&weights, &node, &edge)
            });
        }
    }
}

#[test]
fn attention_sums_to_one_or_is_zero_without_edges() {
    let edges = edges();
    let (node, edge) = attributes(&edges);
    for shape in shapes() {
        let round = round(&weights(shape), shape, ROUND, node.clone(), edge.clone(), &edges, false);
        for ends in edges.first.windows(2).filter(|ends| ends[0] < ends[1]) {
            for head in 0..shape.heads {
                let sum: f32 = (ends[0]..ends[1]).map(|edge| round.alpha.row(edge as usize)[head]).sum();
                assert!((sum - 1.0).abs() < 1e-6, "head {head}: {sum}");
            }
        }
        assert_eq!(round.node.row(2), [0.0; NODE]);
    }
}

#[test]
fn equal_attention_is_a_mean() {
    let edges = edges();
    let (node, edge) = attributes(&edges);
    let round = round(&weights(EQUAL), EQUAL, ROUND, node, edge, &edges, true);
    for ends in edges.first.windows(2) {
        let share = 1.0 / (ends[1] - ends[0]) as f32;
        for edge in ends[0]..ends[1] {
            assert_eq!(round.alpha.row(edge as usize), [share; 4]);
        }
    }
}

/// More edges than one block. Every row receives from all rows, so equal attributes are their own mean.
#[test]
fn blocks_of_edges_agree_with_one_block() {
    let rows = 20_u32;
    let edges = Edges {
        receiver: (0..rows * rows).map(|edge| edge / rows).collect(),
        sender: (0..rows * rows).map(|edge| edge % rows).collect(),
        first: (0..=rows).map(|row| row * rows).collect(),
    };
    assert!(edges.len() > BLOCK && !edges.len().is_multiple_of(BLOCK));
    let shape = shapes().next().unwrap();
    let weights = weights(shape);
    let node = Matrix::new(rows as usize, NODE, values(NODE, 0.5, 30).repeat(rows as usize));
    let edge = Matrix::new(edges.len(), EDGE, values(EDGE, 0.5, 31).repeat(edges.len()));
    let round = round(&weights, shape, ROUND, node, edge, &edges, false);
    let updated = round.edge.as_ref().unwrap();
    let same = |values: &[f32], first: &[f32]| values.iter().zip(first).all(|(a, b)| (a - b).abs() < 1e-5);
    assert!(round.node.values.chunks(NODE).all(|row| same(row, round.node.row(0))));
    assert!(updated.values.chunks(EDGE).all(|row| same(row, updated.row(0))));
    let mut gradients = Gradients::zeros(&weights);
    let d_node = Matrix::new(rows as usize, NODE, values(NODE, 1.0, 32).repeat(rows as usize));
    let d_edge = Matrix::new(edges.len(), EDGE, values(EDGE, 1.0, 33).repeat(edges.len()));
    let (by_node, by_edge) = round.backward(&weights, &mut gradients, &edges, d_node, Some(d_edge));
    assert!(
        by_node
            .values
            .chunks(NODE)
            .all(|row| row.iter().zip(by_node.row(0)).all(|(a, b)| (a - b).abs() < 1e-3))
    );
    assert!(by_edge.values.chunks(EDGE).all(|row| same(row, by_edge.row(0))));
}

#[test]
fn rounds_agree_with_the_reference() {
    for golden in Golden::all() {
        for part in ["history", "future"] {
            let graph = golden.graph(part);
            let by_row = |name: &str| golden.rows(&format!("{part}.{name}"), graph.rows.iter().cloned());
            let by_edge = |name: &str| golden.rows(&format!("{part}.{name}"), graph.joined.iter().cloned());
            let mut node = Matrix::new(graph.rows.len(), NODE, by_row("node"));
            let mut edge = Matrix::new(graph.joined.len(), EDGE, by_edge("edge"));
            let config = &golden.config;
            let shape = AttentionShape::of(config);
            for number in 0..config.rounds {
                let last = number + 1 == config.rounds;
                let round = round(&golden.weights, shape, number, node, edge, &graph.edges, last);
                let name = |tensor: &str| format!("topo{number}.{tensor}");
                golden.check(&name("node"), &round.node.values, &by_row(&name("node")));
                // The reference is by [step, head, receiver, sender].
                let by_head = |joined: &Vec<usize>| {
                    let [step, receiver, sender] = [joined[0], joined[1], joined[2]];
                    (0..shape.heads).map(move |head| vec![step, head, receiver, sender])
                };
                let alpha = graph.joined.iter().flat_map(by_head);
                let alpha = golden.rows(&format!("{part}.{}", name("alpha")), alpha);
                golden.check(&name("alpha"), &round.alpha.values, &alpha);
                node = round.node;
                edge = round.edge.unwrap_or_default();
                if !last {
                    golden.check(&name("edge"), &edge.values, &by_edge(&name("edge")));
                }
            }
        }
    }
}
