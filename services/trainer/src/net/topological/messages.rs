//! Messages along the edges: their weighted sums, and the way back of both sums and weights.

use nn::kernels::{Kernel, Lanes, dispatch};

use super::scores::Coefficients;
use super::{AttentionShape, Block, EDGE, NODE, sum};
use crate::net::matrix::Matrix;

/// The number of heads for which the kernels are compiled apart.
const USUAL_HEADS: usize = 4;

/// The messages of a block of edges.
pub(super) struct Messages<'a> {
    pub(super) shape: AttentionShape,
    pub(super) block: Block<'a>,
    /// W v `[rows, 64]`.
    pub(super) values: &'a Matrix,
    /// U e `[block, 64]`.
    pub(super) own: &'a [f32],
    /// `[block, heads]`.
    pub(super) alpha: &'a [f32],
}

impl Messages<'_> {
    /// Adds the messages, weighted, to `node` `[rows, 64]`.
    pub(super) fn sum(self, node: &mut Matrix) {
        dispatch(Sum { messages: self, node: node.values.as_chunks_mut().0 });
    }
}

struct Sum<'a> {
    messages: Messages<'a>,
    node: &'a mut [[f32; NODE]],
}

impl Kernel for Sum<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        match self.messages.shape.heads {
            USUAL_HEADS => self.run_with(USUAL_HEADS),
            heads => self.run_with(heads),
        }
    }
}

impl Sum<'_> {
    #[inline(always)]
    fn run_with(self, heads: usize) {
        let Messages { shape, block, values, own, alpha } = self.messages;
        let (values, section) = (values.values.as_chunks::<NODE>().0, NODE / heads);
        let edges = own.as_chunks::<NODE>().0.iter().zip(alpha.chunks_exact(heads));
        for ((receiver, sender), (own, alpha)) in block.ends().zip(edges) {
            let (value, node) = (&values[sender], &mut self.node[receiver]);
            for head in 0..heads {
                for i in head * section..(head + 1) * section {
                    let x = value[i] + own[i];
                    node[i] += alpha[head] * if x > 0.0 { x } else { shape.leaky_slope * x };
                }
            }
        }
    }
}

/// The way back of messages and weights, block by block, and the gradients that it sums up.
///
/// ```text
/// ∂α_ij = ∂v̄_i · m_ij            ∂m_ij = α_ij ∂v̄_i
/// ∂s_ij = α_ij (∂α_ij − ∂v̄_i · v̄_i)       since Σ_j α_ij ∂α_ij = ∂v̄_i · Σ_j α_ij m_ij
/// ```
pub(super) struct MessagesBackward<'a> {
    shape: AttentionShape,
    coefficients: &'a Coefficients,
    /// v `[rows, 64]`.
    node: &'a [[f32; NODE]],
    /// ∂v̄ `[rows, 64]`.
    d_attended: &'a [[f32; NODE]],
    /// ∂v̄_i · v̄_i `[rows, heads]`.
    totals: Vec<f32>,
    /// By v, what comes through the distances, `[rows, 64]`.
    pub(super) by_node: Matrix,
    /// By W v, `[rows, 64]`.
    pub(super) by_values: Matrix,
    /// By λ and μ.
    pub(super) by_coefficients: [Vec<f32>; 2],
}

impl<'a> MessagesBackward<'a> {
    pub(super) fn new(
        shape: AttentionShape,
        coefficients: &'a Coefficients,
        node: &'a Matrix,
        attended: &Matrix,
        d_attended: &'a Matrix,
    ) -> Self {
        let section = NODE / shape.heads;
        let sections = attended.values.chunks_exact(section).zip(d_attended.values.chunks_exact(section));
        let totals = sections.map(|(value, gradient)| value.iter().zip(gradient).map(|(v, g)| v * g).sum());
        Self {
            shape,
            coefficients,
            node: node.values.as_chunks().0,
            d_attended: d_attended.values.as_chunks().0,
            totals: totals.collect(),
            by_node: Matrix::zeros(node.rows, NODE),
            by_values: Matrix::zeros(node.rows, NODE),
            by_coefficients: [vec![0.0; shape.heads], vec![0.0; shape.heads]],
        }
    }

    /// Takes a block of edges back: `values` and `edge` are W v and e, `alpha` and `squares` the block's; `own` is U e
    /// of the block and becomes its gradient; `by_edge` gets what comes through the lengths.
    pub(super) fn run(
        &mut self,
        block: Block<'_>,
        (values, edge): (&Matrix, &Matrix),
        (alpha, squares): (&[f32], &[f32]),
        own: &mut [f32],
        by_edge: &mut Matrix,
    ) {
        let kernel = Back {
            block,
            values: values.values.as_chunks().0,
            edge: block.of(edge).as_chunks().0,
            alpha,
            squares: squares.as_chunks().0,
            own: own.as_chunks_mut().0,
            by_edge: block.of_mut(by_edge).as_chunks_mut().0,
            sums: self,
        };
        dispatch(kernel);
    }
}

struct Back<'a, 's> {
    block: Block<'a>,
    values: &'a [[f32; NODE]],
    edge: &'a [[f32; EDGE]],
    alpha: &'a [f32],
    squares: &'a [[f32; 2]],
    own: &'a mut [[f32; NODE]],
    by_edge: &'a mut [[f32; EDGE]],
    sums: &'a mut MessagesBackward<'s>,
}

impl Kernel for Back<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        match self.sums.shape.heads {
            USUAL_HEADS => self.run_with(USUAL_HEADS),
            heads => self.run_with(heads),
        }
    }
}

impl Back<'_, '_> {
    #[inline(always)]
    fn run_with(self, heads: usize) {
        let Self { block, values, edge, alpha, squares, own, by_edge, sums } = self;
        let (section, slope) = (NODE / heads, sums.shape.leaky_slope);
        let by_values = sums.by_values.values.as_chunks_mut::<NODE>().0;
        let by_node = sums.by_node.values.as_chunks_mut::<NODE>().0;
        let [by_lambda, by_mu] = &mut sums.by_coefficients;
        let (by_lambda, by_mu) = (&mut by_lambda[..heads], &mut by_mu[..heads]);
        let (lambda, mu) = (&sums.coefficients.lambda[..heads], &sums.coefficients.mu[..heads]);
        let blocks = edge.iter().zip(alpha.chunks_exact(heads)).zip(squares).zip(own).zip(by_edge);
        for ((receiver, sender), ((((edge, alpha), [apart, length]), own), by_edge)) in
            block.ends().zip(blocks)
        {
            let (value, by_value) = (&values[sender], &mut by_values[sender]);
            let d_attended = &sums.d_attended[receiver];
            let mut products = [0.0; NODE];
            for head in 0..heads {
                for i in head * section..(head + 1) * section {
                    let x = value[i] + own[i];
                    let f = if x > 0.0 { 1.0 } else { slope };
                    products[i] = d_attended[i] * x * f;
                    own[i] = d_attended[i] * alpha[head] * f;
                    by_value[i] += own[i];
                }
            }
            let totals = &sums.totals[receiver * heads..][..heads];
            // Twice the gradients by d_ij and l_ij.
            let (mut by_apart, mut by_length) = (0.0, 0.0);
            for head in 0..heads {
                let by_alpha = sum(&products[head * section..(head + 1) * section]);
                let by_score = alpha[head] * (by_alpha - totals[head]);
                by_lambda[head] -= by_score * apart;
                by_mu[head] -= by_score * length;
                by_apart -= 2.0 * by_score * lambda[head];
                by_length -= 2.0 * by_score * mu[head];
            }
            let mut pull = [0.0; NODE];
            for i in 0..NODE {
                pull[i] = by_apart * (sums.node[receiver][i] - sums.node[sender][i]);
            }
            by_node[receiver].iter_mut().zip(&pull).for_each(|(sum, pull)| *sum += pull);
            by_node[sender].iter_mut().zip(&pull).for_each(|(sum, pull)| *sum -= pull);
            by_edge.iter_mut().zip(edge).for_each(|(sum, edge)| *sum += by_length * edge);
        }
    }
}
