//! The edges of a graph, in blocks, and the shape of the layer.

use nn::{Attention, ModelConfig};

use crate::net::matrix::{Matrix, View, ViewMut};

/// Node attributes.
pub(in crate::net) const NODE: usize = 64;

/// Edge attributes.
pub(super) const EDGE: usize = 16;

/// Edges of a block.
pub(in crate::net) const BLOCK: usize = 256;

/// The edges of a graph.
#[derive(Clone, Debug, Default)]
pub(crate) struct Edges {
    /// Receiving row per edge, ascending.
    pub(crate) receiver: Vec<u32>,
    /// Sending row per edge.
    pub(crate) sender: Vec<u32>,
    /// First edge of every row, and the number of edges.
    pub(crate) first: Vec<u32>,
}

impl Edges {
    pub(crate) fn len(&self) -> usize {
        self.receiver.len()
    }

    /// Receiving and sending row of each edge.
    #[inline(always)]
    pub(in crate::net) fn ends(&self) -> impl Iterator<Item = (usize, usize)> {
        ends(&self.receiver, &self.sender)
    }

    pub(in crate::net) fn blocks(&self) -> impl Iterator<Item = Block<'_>> {
        let ends = self.receiver.chunks(BLOCK).zip(self.sender.chunks(BLOCK));
        ends.enumerate().map(|(number, (receiver, sender))| Block { start: number * BLOCK, receiver, sender })
    }
}

#[inline(always)]
fn ends(receiver: &[u32], sender: &[u32]) -> impl Iterator<Item = (usize, usize)> {
    receiver.iter().zip(sender).map(|(receiver, sender)| (*receiver as usize, *sender as usize))
}

/// Consecutive edges.
#[derive(Clone, Copy)]
pub(in crate::net) struct Block<'a> {
    pub(super) start: usize,
    pub(super) receiver: &'a [u32],
    pub(super) sender: &'a [u32],
}

impl Block<'_> {
    pub(in crate::net) const fn len(&self) -> usize {
        self.receiver.len()
    }

    /// Receiving and sending row of each edge.
    #[inline(always)]
    pub(in crate::net) fn ends(&self) -> impl Iterator<Item = (usize, usize)> {
        ends(self.receiver, self.sender)
    }

    /// The block's rows of a matrix with one row per edge.
    pub(in crate::net) fn of<'m>(&self, matrix: &'m Matrix) -> &'m [f32] {
        &matrix.values[self.start * matrix.cols..][..self.len() * matrix.cols]
    }

    pub(in crate::net) fn of_mut<'m>(&self, matrix: &'m mut Matrix) -> &'m mut [f32] {
        &mut matrix.values[self.start * matrix.cols..][..self.len() * matrix.cols]
    }

    pub(in crate::net) fn view<'m>(&self, matrix: &'m Matrix) -> View<'m> {
        View::new(self.of(matrix), self.len(), matrix.cols)
    }

    pub(in crate::net) fn view_mut<'m>(&self, matrix: &'m mut Matrix) -> ViewMut<'m> {
        let cols = matrix.cols;
        ViewMut::new(self.of_mut(matrix), self.len(), cols)
    }
}

/// The part of the model's configuration that the layer uses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AttentionShape {
    pub(crate) attention: Attention,
    /// Number of heads; divides 64.
    pub(crate) heads: usize,
    pub(crate) leaky_slope: f32,
    /// Whether messages include U e.
    pub(crate) edge_in_message: bool,
    /// Whether d and l are divided by their dimensions.
    pub(crate) distance_scale: bool,
}

impl AttentionShape {
    pub(crate) const fn of(config: &ModelConfig) -> Self {
        Self {
            attention: config.attention,
            heads: config.topological_heads,
            leaky_slope: config.leaky_slope,
            edge_in_message: config.edge_in_message,
            distance_scale: config.distance_scale,
        }
    }
}
