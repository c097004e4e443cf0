//! The weights α of the edges, from squared distances and lengths.

use nn::kernels::{Kernel, Lanes, dispatch, exp_in_place};

use super::{AttentionShape, EDGE, Edges, NODE, sum};
use crate::net::matrix::Matrix;
use crate::net::tensors::{Gradients, Tensors};

/// d_ij and l_ij of all edges, `[edges, 2]`.
pub(super) fn squares(node: &Matrix, edge: &Matrix, edges: &Edges) -> Matrix {
    let mut squares = Matrix::zeros(edges.len(), 2);
    dispatch(Squares { node, edge, edges, squares: &mut squares });
    squares
}

struct Squares<'a> {
    node: &'a Matrix,
    edge: &'a Matrix,
    edges: &'a Edges,
    squares: &'a mut Matrix,
}

impl Kernel for Squares<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let node = self.node.values.as_chunks::<NODE>().0;
        let ends = self.edges.receiver.iter().zip(&self.edges.sender);
        let edge = self.edge.values.as_chunks::<EDGE>().0;
        let squares = self.squares.values.as_chunks_mut::<2>().0;
        for (((receiver, sender), edge), squares) in ends.zip(edge).zip(squares) {
            let (receiver, sender) = (&node[*receiver as usize], &node[*sender as usize]);
            let mut apart = [0.0; NODE];
            for i in 0..NODE {
                let difference = receiver[i] - sender[i];
                apart[i] = difference * difference;
            }
            let mut length = [0.0; EDGE];
            for i in 0..EDGE {
                length[i] = edge[i] * edge[i];
            }
            *squares = [sum(&apart), sum(&length)];
        }
    }
}

/// λ and μ of every head, over the dimensions of node and edge where `distance_scale` says so.
pub(super) struct Coefficients {
    pub(super) lambda: Vec<f32>,
    pub(super) mu: Vec<f32>,
    /// What d and l are multiplied by.
    scale: [f32; 2],
}

/// ln(1 + e^x) without overflow.
fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

impl Coefficients {
    pub(super) fn read(weights: &Tensors, shape: AttentionShape, name: &str) -> Self {
        let scale = if shape.distance_scale { [NODE, EDGE].map(|len| 1.0 / len as f32) } else { [1.0; 2] };
        let read = |raw: &str, scale: f32| {
            weights.get(&format!("{name}.{raw}")).iter().map(|raw| softplus(*raw) * scale).collect()
        };
        Self { lambda: read("lambda_raw", scale[0]), mu: read("mu_raw", scale[1]), scale }
    }

    /// α of all edges, `[edges, heads]`.
    pub(super) fn weigh(&self, squares: &Matrix, edges: &Edges) -> Matrix {
        let heads = self.lambda.len();
        let mut alpha = Matrix::zeros(edges.len(), heads);
        for (scores, [apart, length]) in
            alpha.values.chunks_exact_mut(heads).zip(squares.values.as_chunks::<2>().0)
        {
            for (score, (lambda, mu)) in scores.iter_mut().zip(self.lambda.iter().zip(&self.mu)) {
                *score = -(lambda * apart + mu * length);
            }
        }
        softmax(&mut alpha, edges);
        alpha
    }

    /// Adds to the gradients of `lambda_raw` and `mu_raw`, from those by λ and μ as scaled.
    pub(super) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        name: &str,
        by_coefficients: &[Vec<f32>; 2],
    ) {
        for ((raw, scale), by_coefficient) in
            ["lambda_raw", "mu_raw"].into_iter().zip(self.scale).zip(by_coefficients)
        {
            let name = format!("{name}.{raw}");
            let gradients = gradients.get_mut(&name).iter_mut().zip(weights.get(&name));
            for ((gradient, raw), by_coefficient) in gradients.zip(by_coefficient) {
                *gradient += by_coefficient * scale / (1.0 + (-raw).exp());
            }
        }
    }
}

/// Softmax over the edges of every row, head by head.
fn softmax(scores: &mut Matrix, edges: &Edges) {
    let heads = scores.cols;
    let mut by_head = vec![0.0; heads];
    for ends in edges.first.windows(2) {
        let received = &mut scores.values[ends[0] as usize * heads..ends[1] as usize * heads];
        by_head.fill(f32::NEG_INFINITY);
        for scores in received.chunks_exact(heads) {
            by_head.iter_mut().zip(scores).for_each(|(most, score)| *most = most.max(*score));
        }
        for scores in received.chunks_exact_mut(heads) {
            scores.iter_mut().zip(&by_head).for_each(|(score, most)| *score -= most);
        }
    }
    exp_in_place(&mut scores.values);
    for ends in edges.first.windows(2) {
        let received = &mut scores.values[ends[0] as usize * heads..ends[1] as usize * heads];
        by_head.fill(0.0);
        for scores in received.chunks_exact(heads) {
            by_head.iter_mut().zip(scores).for_each(|(sum, score)| *sum += score);
        }
        for scores in received.chunks_exact_mut(heads) {
            scores.iter_mut().zip(&by_head).for_each(|(score, sum)| *score /= sum);
        }
    }
}
