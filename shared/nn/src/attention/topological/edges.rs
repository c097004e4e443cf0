//! The loops over edges between the matrix products, compiled for each instruction set.
//!
//! They are plain Rust that vectorises. Compiling for an instruction set does not change the rounding, so the
//! results of all sets, including the portable one, are identical to the bit.

use wire::{EDGE_ATTRIBUTES, Edge, NODE_ATTRIBUTES};

use crate::attention::graph::{Graph, leaky};
use crate::kernels::{Kernel, Lanes};

/// Hidden units of the edge update.
pub(super) const UPDATE_HIDDEN: usize = 128;

/// Number of partial sums of a squared distance.
const PARTS: usize = 16;
/// Number of edges that are scored together.
const TOGETHER: usize = 8;

type Row = [f32; NODE_ATTRIBUTES];

/// −(λ_h ‖v_i − v_j‖² + μ_h ‖e_ij‖²) of all edges, \[edge, head\].
pub(super) struct Score<'a> {
    pub(super) graph: &'a Graph<'a>,
    pub(super) nodes: &'a [f32],
    pub(super) attributes: &'a [[f32; EDGE_ATTRIBUTES]],
    pub(super) factors: &'a [[f32; 2]],
    pub(super) scores: &'a mut [f32],
}

/// v̄_i = Σ_j α_ij v_j over edges, added to `out`; the values are activated.
pub(super) struct Sum<'a> {
    pub(super) graph: &'a Graph<'a>,
    pub(super) edges: &'a [Edge],
    /// \[edge, head\].
    pub(super) alpha: &'a [f32],
    pub(super) heads: usize,
    pub(super) values: &'a [f32],
    pub(super) out: &'a mut [f32],
}

/// v̄_i = Σ_j α_ij f_act(v_j + m_ij) over edges, added to `out`.
pub(super) struct SumWithEdges<'a> {
    pub(super) graph: &'a Graph<'a>,
    pub(super) edges: &'a [Edge],
    /// \[edge, head\].
    pub(super) alpha: &'a [f32],
    pub(super) heads: usize,
    pub(super) values: &'a [f32],
    pub(super) slope: f32,
    /// m, \[edge, 64\].
    pub(super) messages: &'a [f32],
    pub(super) out: &'a mut [f32],
}

/// For each edge, the sum of its receiver's and its sender's part, \[edge, 128\].
pub(super) struct Gather<'a> {
    pub(super) graph: &'a Graph<'a>,
    pub(super) edges: &'a [Edge],
    pub(super) receivers: &'a [f32],
    pub(super) senders: &'a [f32],
    pub(super) sums: &'a mut [f32],
}

impl Kernel for Score<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let heads = self.factors.len();
        let blocks = self.graph.edges.chunks(TOGETHER).zip(self.attributes.chunks(TOGETHER));
        for ((edges, attributes), scores) in blocks.zip(self.scores.chunks_mut(TOGETHER * heads)) {
            let mut parts = [[[0.0; PARTS]; 2]; TOGETHER];
            for ((edge, attribute), [apart, length]) in edges.iter().zip(attributes).zip(&mut parts) {
                let [receiver, sender] = self.graph.ends(edge);
                squared_distance(row(self.nodes, receiver), row(self.nodes, sender), apart);
                squared_distance(attribute, &[0.0; EDGE_ATTRIBUTES], length);
            }
            let sums = sums(&parts);
            for (scores, [apart, length]) in scores.chunks_exact_mut(heads).zip(sums) {
                for (score, [lambda, mu]) in scores.iter_mut().zip(self.factors) {
                    *score = -(lambda * apart + mu * length);
                }
            }
        }
    }
}

impl Kernel for Sum<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        match self.heads {
            1 => self.sum::<1>(),
            2 => self.sum::<2>(),
            4 => self.sum::<4>(),
            8 => self.sum::<8>(),
            _ => self.sum_of_any(),
        }
    }
}

impl Sum<'_> {
    #[inline(always)]
    fn sum<const HEADS: usize>(self) {
        let alpha = self.alpha.as_chunks::<HEADS>().0;
        let mut first = 0;
        for edges in self.edges.chunk_by(|a, b| (a.step, a.receiver) == (b.step, b.receiver)) {
            let [receiver, _] = self.graph.ends(&edges[0]);
            let mut sums = *row(self.out, receiver);
            for (edge, alpha) in edges.iter().zip(&alpha[first..]) {
                let [_, sender] = self.graph.ends(edge);
                accumulate(alpha, row(self.values, sender), &mut sums);
            }
            *row_mut(self.out, receiver) = sums;
            first += edges.len();
        }
    }

    #[inline(always)]
    fn sum_of_any(self) {
        for (edge, alpha) in self.edges.iter().zip(self.alpha.chunks_exact(self.heads)) {
            let [receiver, sender] = self.graph.ends(edge);
            accumulate_any(alpha, row(self.values, sender), row_mut(self.out, receiver));
        }
    }
}

impl Kernel for SumWithEdges<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        match self.heads {
            1 => self.sum::<1>(),
            2 => self.sum::<2>(),
            4 => self.sum::<4>(),
            8 => self.sum::<8>(),
            _ => self.sum_of_any(),
        }
    }
}

impl SumWithEdges<'_> {
    #[inline(always)]
    fn sum<const HEADS: usize>(self) {
        let (messages, alpha) = (self.messages.as_chunks().0, self.alpha.as_chunks::<HEADS>().0);
        let mut first = 0;
        for edges in self.edges.chunk_by(|a, b| (a.step, a.receiver) == (b.step, b.receiver)) {
            let [receiver, _] = self.graph.ends(&edges[0]);
            let mut sums = *row(self.out, receiver);
            for ((edge, message), alpha) in edges.iter().zip(&messages[first..]).zip(&alpha[first..]) {
                let [_, sender] = self.graph.ends(edge);
                let activated = activated(self.slope, message, row(self.values, sender));
                accumulate(alpha, &activated, &mut sums);
            }
            *row_mut(self.out, receiver) = sums;
            first += edges.len();
        }
    }

    #[inline(always)]
    fn sum_of_any(self) {
        let edges = self.edges.iter().zip(self.messages.as_chunks().0);
        for ((edge, message), alpha) in edges.zip(self.alpha.chunks_exact(self.heads)) {
            let [receiver, sender] = self.graph.ends(edge);
            let activated = activated(self.slope, message, row(self.values, sender));
            accumulate_any(alpha, &activated, row_mut(self.out, receiver));
        }
    }
}

impl Kernel for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let receivers = self.receivers.as_chunks::<UPDATE_HIDDEN>().0;
        let senders = self.senders.as_chunks::<UPDATE_HIDDEN>().0;
        let sums = self.sums.as_chunks_mut::<UPDATE_HIDDEN>().0;
        for (edge, sums) in self.edges.iter().zip(sums) {
            let [receiver, sender] = self.graph.ends(edge);
            let parts = receivers[receiver].iter().zip(&senders[sender]);
            for (sum, (receiver, sender)) in sums.iter_mut().zip(parts) {
                *sum = receiver + sender;
            }
        }
    }
}

#[inline(always)]
fn row(nodes: &[f32], index: usize) -> &Row {
    &nodes.as_chunks().0[index]
}

#[inline(always)]
fn row_mut(nodes: &mut [f32], index: usize) -> &mut Row {
    &mut nodes.as_chunks_mut().0[index]
}

/// ‖a − b‖² in [`PARTS`] partial sums, so that it vectorises.
#[inline(always)]
fn squared_distance<const N: usize>(a: &[f32; N], b: &[f32; N], parts: &mut [f32; PARTS]) {
    for (a, b) in a.as_chunks::<PARTS>().0.iter().zip(b.as_chunks::<PARTS>().0) {
        for i in 0..PARTS {
            let d = a[i] - b[i];
            parts[i] += d * d;
        }
    }
}

/// The sum of each row of parts, in order: independent chains of additions that run in parallel.
#[inline(always)]
fn sums(parts: &[[[f32; PARTS]; 2]; TOGETHER]) -> [[f32; 2]; TOGETHER] {
    let mut sums = [[0.0; 2]; TOGETHER];
    for part in 0..PARTS {
        for (sums, parts) in sums.iter_mut().zip(parts) {
            sums[0] += parts[0][part];
            sums[1] += parts[1][part];
        }
    }
    sums
}

/// f_act(message + value).
#[inline(always)]
fn activated(slope: f32, message: &Row, value: &Row) -> Row {
    let mut activated = [0.0; NODE_ATTRIBUTES];
    for (i, activated) in activated.iter_mut().enumerate() {
        *activated = leaky(slope, message[i] + value[i]);
    }
    activated
}

/// Adds α_h · message to the section of each head h.
#[inline(always)]
fn accumulate<const HEADS: usize>(alpha: &[f32; HEADS], message: &Row, out: &mut Row) {
    for i in 0..NODE_ATTRIBUTES {
        out[i] += alpha[i * HEADS / NODE_ATTRIBUTES] * message[i];
    }
}

/// The same for any number of heads.
#[inline(always)]
fn accumulate_any(alpha: &[f32], message: &Row, out: &mut Row) {
    let section = NODE_ATTRIBUTES / alpha.len();
    let sections = message.chunks_exact(section).zip(out.chunks_exact_mut(section));
    for (alpha, (message, out)) in alpha.iter().zip(sections) {
        out.iter_mut().zip(message).for_each(|(sum, x)| *sum += alpha * x);
    }
}
