//! The first convolution, which reads patches in their layout \[image, channel, row, column\].
//!
//! Its three input channels would leave most of a vector empty. The receptive field of each output position
//! is therefore copied to rows \[image, (channel, row, column)\], in the order of the kernel. The rows are
//! then multiplied as in a linear layer.

use nn::kernels::product::{Gather, PANEL, Panels, Product};
use wire::PATCH_CHANNELS;

use super::convolution::{Geometry, add_outer};
use super::map::Map;
use crate::net::tensors::{Gradients, Tensors};

/// The convolution with the kernel `name` \[out, 3, row, column\].
pub(super) struct Stem {
    pub(super) name: String,
    pub(super) geometry: Geometry,
    pub(super) out_channels: usize,
}

impl Stem {
    pub(super) fn forward(&self, weights: &Tensors, patches: &[f32]) -> Map {
        let kernel = weights.get(&self.name);
        let in_len = self.in_len();
        let panels =
            Panels::pack([self.out_channels, 1, in_len], |out, _, i| kernel[out * in_len + i], |_| 0.0);
        let images = patches.len() / self.patch_len();
        assert!(patches.len().is_multiple_of(self.patch_len()), "whole patches");
        let mut y = Map::zeros(self.positions(), images, self.out_channels);
        let mut field = self.empty_field(images);
        let gather = Gather::Rows { stride: self.stride() };
        for position in 0..y.positions {
            self.copy_field(patches, position, &mut field);
            let out = y.position_mut(position);
            Product { input: &field, gather, panels: &panels, residual: None, relu: false, out }.run();
        }
        y
    }

    /// Adds the gradient by the kernel.
    pub(super) fn by_kernel(&self, gradients: &mut Gradients, patches: &[f32], dy: &Map) {
        let lens = [self.stride(), dy.channels];
        let mut sums = vec![0.0; lens[0] * lens[1]];
        let mut field = self.empty_field(dy.images);
        for position in 0..dy.positions {
            self.copy_field(patches, position, &mut field);
            add_outer([&field, dy.position(position)], lens, &mut sums);
        }
        let kernel = gradients.get_mut(&self.name).chunks_exact_mut(self.in_len());
        for (out, kernel) in kernel.enumerate() {
            for (weight, sums) in kernel.iter_mut().zip(sums.chunks_exact(lens[1])) {
                *weight += sums[out];
            }
        }
    }

    /// Copies the receptive field of output `position` of each image to rows of `field`; padding stays zero.
    fn copy_field(&self, patches: &[f32], position: usize, field: &mut [f32]) {
        let Geometry { side, kernel, stride, padding } = self.geometry;
        let out_side = self.geometry.out_side();
        field.fill(0.0);
        // Kernel cells inside the patch, and the first patch cell that they read.
        let inside = |out: usize| {
            let first = padding.saturating_sub(out * stride);
            let end = kernel.min(side + padding - out * stride);
            (first..end, out * stride + first - padding)
        };
        let (rows, top) = inside(position / out_side);
        let (columns, left) = inside(position % out_side);
        let images = patches.chunks_exact(self.patch_len()).zip(field.chunks_exact_mut(self.stride()));
        for (patch, field) in images {
            for (channel, plane) in patch.chunks_exact(side * side).enumerate() {
                for (number, row) in rows.clone().enumerate() {
                    let cells = &plane[(top + number) * side + left..][..columns.len()];
                    let place = (channel * kernel + row) * kernel;
                    field[place..][columns.clone()].copy_from_slice(cells);
                }
            }
        }
    }

    fn empty_field(&self, images: usize) -> Vec<f32> {
        vec![0.0; images * self.stride()]
    }

    const fn positions(&self) -> usize {
        self.geometry.out_side() * self.geometry.out_side()
    }

    const fn patch_len(&self) -> usize {
        PATCH_CHANNELS * self.geometry.side * self.geometry.side
    }

    /// Number of cells in the receptive field.
    const fn in_len(&self) -> usize {
        PATCH_CHANNELS * self.geometry.kernel * self.geometry.kernel
    }

    /// The same, rounded up to whole panels.
    const fn stride(&self) -> usize {
        self.in_len().next_multiple_of(PANEL)
    }
}
