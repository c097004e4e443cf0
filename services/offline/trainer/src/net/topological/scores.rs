//! The attention weights α of the edges: the softmax of scores that are linear in squared distances and
//! lengths.

use nn::Attention;
use nn::kernels::exp_in_place;

use super::shape::{AttentionShape, EDGE, Edges, NODE};
use crate::kernel::kernel;
use crate::net::matrix::{Into, Matrix, by_input, by_matrix, forward};
use crate::net::tensors::{Gradients, Tensors};

/// The tensors whose softplus are λ and μ.
const RAW: [&str; 2] = ["lambda_raw", "mu_raw"];

/// The linear map of the scores.
pub(super) struct Coefficients {
    /// −λ and −μ `[heads, 2]`. With `distance_scale` they are divided by the dimensions of node and edge.
    matrix: Matrix,
    attention: Attention,
    scale: [f32; 2],
}

/// The learned columns of the linear map, and their tensors.
fn learned(attention: Attention) -> impl Iterator<Item = (usize, &'static str)> {
    RAW.into_iter().enumerate().filter(move |_| attention == Attention::Dual)
}

/// ln(1 + e^x) without overflow.
fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

impl Coefficients {
    pub(super) fn read(weights: &Tensors, shape: AttentionShape, name: &str) -> Self {
        let scale = if shape.distance_scale { [NODE, EDGE].map(|len| 1.0 / len as f32) } else { [1.0; 2] };
        let mut matrix = Matrix::zeros(shape.heads, 2);
        for (column, raw) in learned(shape.attention) {
            for (head, raw) in weights.get(&format!("{name}.{raw}")).iter().enumerate() {
                matrix.row_mut(head)[column] = -softplus(*raw) * scale[column];
            }
        }
        Self { matrix, attention: shape.attention, scale }
    }

    /// α of all edges, `[edges, heads]`.
    pub(super) fn weigh(&self, squares: &Matrix, edges: &Edges) -> Matrix {
        let mut alpha = Matrix::zeros(edges.len(), self.matrix.rows);
        forward(squares.view(), self.matrix.view(), alpha.view_mut(), Into::Replace);
        softmax(&mut alpha, &edges.first);
        alpha
    }

    /// Gradient by the squares, given the gradient by the scores. Adds to the gradients of the coefficients.
    pub(super) fn backward(
        &self,
        weights: &Tensors,
        gradients: &mut Gradients,
        name: &str,
        squares: &Matrix,
        by_scores: &Matrix,
    ) -> Matrix {
        let mut by_coefficients = Matrix::zeros(self.matrix.rows, 2);
        by_matrix(by_scores.view(), squares.view(), by_coefficients.view_mut());
        for (column, raw) in learned(self.attention) {
            let name = format!("{name}.{raw}");
            for (head, gradient) in gradients.get_mut(&name).iter_mut().enumerate() {
                let sigmoid = 1.0 / (1.0 + (-weights.get(&name)[head]).exp());
                *gradient -= by_coefficients.row(head)[column] * self.scale[column] * sigmoid;
            }
        }
        let mut by_squares = Matrix::zeros(squares.rows, 2);
        by_input(by_scores.view(), self.matrix.view(), by_squares.view_mut(), Into::Replace);
        by_squares
    }
}

/// Softmax over groups of rows, column by column. Each entry of `first` begins a group, except the last,
/// which is the end.
pub(in crate::net) fn softmax(scores: &mut Matrix, first: &[u32]) {
    let columns = scores.cols;
    let groups = || first.windows(2).map(|ends| ends[0] as usize * columns..ends[1] as usize * columns);
    let mut by_column = vec![0.0; columns];
    for group in groups() {
        let group = &mut scores.values[group];
        by_column.fill(f32::NEG_INFINITY);
        for scores in group.chunks_exact(columns) {
            by_column.iter_mut().zip(scores).for_each(|(most, score)| *most = most.max(*score));
        }
        for scores in group.chunks_exact_mut(columns) {
            scores.iter_mut().zip(&by_column).for_each(|(score, most)| *score -= most);
        }
    }
    exp_in_place(&mut scores.values);
    for group in groups() {
        let group = &mut scores.values[group];
        by_column.fill(0.0);
        for scores in group.chunks_exact(columns) {
            by_column.iter_mut().zip(scores).for_each(|(sum, score)| *sum += score);
        }
        for scores in group.chunks_exact_mut(columns) {
            scores.iter_mut().zip(&by_column).for_each(|(score, sum)| *score /= sum);
        }
    }
}

/// d_ij and l_ij of all edges, `[edges, 2]`.
pub(super) fn squares(node: &Matrix, edge: &Matrix, edges: &Edges) -> Matrix {
    let mut squares = Matrix::zeros(edges.len(), 2);
    square(node, edge, edges, &mut squares);
    squares
}

kernel! {
    fn square<'a>(node: &'a Matrix, edge: &'a Matrix, edges: &'a Edges, squares: &'a mut Matrix) {
        let node = node.values.as_chunks::<NODE>().0;
        let edge = edge.values.as_chunks::<EDGE>().0;
        let squares = squares.values.as_chunks_mut().0;
        for ((receiver, sender), (edge, squares)) in edges.ends().zip(edge.iter().zip(squares)) {
            let mut length = [0.0; EDGE];
            for i in 0..EDGE {
                length[i] = edge[i] * edge[i];
            }
            *squares = [squared_distance(&node[receiver], &node[sender]), sum(&length)];
        }
    }
}

/// ‖a − b‖².
#[inline(always)]
fn squared_distance(a: &[f32; NODE], b: &[f32; NODE]) -> f32 {
    let mut sums = [0.0_f32; EDGE];
    for (a, b) in a.as_chunks::<EDGE>().0.iter().zip(b.as_chunks::<EDGE>().0) {
        for i in 0..EDGE {
            let difference = a[i] - b[i];
            sums[i] += difference * difference;
        }
    }
    sum(&sums)
}

/// The sum, computed in halves so that it vectorises.
#[inline(always)]
fn sum(values: &[f32; 16]) -> f32 {
    let mut sums: [f32; 8] = std::array::from_fn(|i| values[i] + values[i + 8]);
    for half in [4, 2, 1] {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
    }
    sums[0]
}

kernel! {
    /// Adds to the gradients by `node` and `edge`, given the gradient by the squares.
    pub(super) fn squares_backward<'a>(
        node: &'a Matrix,
        edge: &'a Matrix,
        edges: &'a Edges,
        by_squares: &'a Matrix,
        by_node: &'a mut Matrix,
        by_edge: &'a mut Matrix,
    ) {
        let (node, edge) = (node.values.as_chunks().0, edge.values.as_chunks::<EDGE>().0);
        let by_node = by_node.values.as_chunks_mut().0;
        let by_edge = by_edge.values.as_chunks_mut().0;
        let by_edges = by_squares.values.as_chunks().0.iter().zip(edge.iter().zip(by_edge));
        for ((receiver, sender), ([by_distance, by_length], (edge, by_edge))) in edges.ends().zip(by_edges) {
            let pull = scaled_difference(2.0 * by_distance, &node[receiver], &node[sender]);
            add_scaled(&mut by_node[receiver], 1.0, &pull);
            add_scaled(&mut by_node[sender], -1.0, &pull);
            add_scaled(by_edge, 2.0 * by_length, edge);
        }
    }
}

/// `scale` (a − b).
#[inline(always)]
fn scaled_difference(scale: f32, a: &[f32; NODE], b: &[f32; NODE]) -> [f32; NODE] {
    let mut difference = [0.0; NODE];
    for i in 0..NODE {
        difference[i] = scale * (a[i] - b[i]);
    }
    difference
}

#[inline(always)]
fn add_scaled<const LEN: usize>(sum: &mut [f32; LEN], scale: f32, values: &[f32; LEN]) {
    for i in 0..LEN {
        sum[i] += scale * values[i];
    }
}
