//! The context CNN: a ResNet-18 of any width that maps a local patch of the context map to 32 numbers.
//!
//! Activations are \[position, image, channel\]: the images of a batch are adjacent at each position. A
//! register tile of the convolution therefore reads the same position of consecutive images, which have the
//! same live taps. Channels are padded with zeros to multiples of 16. The padding stays zero through
//! convolution and ReLU.

mod conv;

use wire::{CONTEXT_EMBEDDING, PATCH_CHANNELS};

use crate::Stem;
use crate::buffer::Buffer;
use crate::kernels::product::PANEL;
use crate::linear::{Activation, Linear};
use crate::weights::{Weights, WeightsError};
use conv::{Conv, Geometry, max_pool};

/// Images that are processed together: their activations stay in the second-level cache.
const BATCH: usize = 24;
/// Blocks of each of the four stages.
const BLOCKS: usize = 2;

/// Two 3×3 convolutions with a shortcut around them.
struct Block {
    first: Conv,
    second: Conv,
    /// 1×1 projection of the shortcut, if the shape changes.
    projection: Option<Conv>,
}

/// The context CNN, batch norm folded into its convolutions.
pub struct ContextCnn {
    stem: Conv,
    /// Side of the stem's output, if a max-pool follows.
    pool_side: Option<usize>,
    blocks: Vec<Block>,
    fc: Linear,
    patch_side: usize,
    /// Positions × channels of the largest activation.
    largest: usize,
    multiply_adds: usize,
}

/// Scratch memory of [`ContextCnn`].
#[derive(Default)]
pub struct ContextMemory {
    input: Buffer,
    /// Activations: a block's input, its inner map, its shortcut and its output.
    maps: [Buffer; 4],
    pooled: Buffer,
}

impl ContextCnn {
    /// The layers `fe.context.*`.
    ///
    /// # Errors
    /// If a tensor is missing or has another shape.
    pub fn new(weights: &Weights) -> Result<Self, WeightsError> {
        let config = weights.config();
        let (width, patch_side) = (config.width, config.patch_size);
        let (kernel, padding) = match config.stem {
            Stem::Imagenet => (7, 3),
            Stem::Compact => (3, 1),
        };
        let geometry = Geometry { side: patch_side, kernel, stride: 2, padding };
        let stem = Conv::read(weights, ["conv1", "bn1"], [PATCH_CHANNELS; 2], width, geometry)?;
        let mut side = stem.out_side();
        let mut largest = side * side * stem.out_channels();
        let pool_side = (config.stem == Stem::Imagenet).then_some(side);
        if pool_side.is_some() {
            side = side.div_ceil(2);
        }
        let mut blocks = Vec::new();
        let mut channels = width;
        for stage in 0..4 {
            for index in 0..BLOCKS {
                let stride = if stage > 0 && index == 0 { 2 } else { 1 };
                let block = Block::read(weights, [stage, index], [channels, width << stage], side, stride)?;
                (side, channels) = (block.second.out_side(), width << stage);
                largest = largest.max(side * side * block.second.out_channels());
                blocks.push(block);
            }
        }
        let fc = Self::last_layer(weights, channels)?;
        let convolutions = std::iter::once(&stem).chain(blocks.iter().flat_map(Block::convolutions));
        let multiply_adds =
            convolutions.map(Conv::multiply_adds).sum::<usize>() + channels * CONTEXT_EMBEDDING;
        Ok(Self { stem, pool_side, blocks, fc, patch_side, largest, multiply_adds })
    }

    /// The linear layer after the average pool, with channels padded to a multiple of 16.
    fn last_layer(weights: &Weights, channels: usize) -> Result<Linear, WeightsError> {
        let matrix = weights.tensor("fe.context.fc.weight", &[CONTEXT_EMBEDDING, channels])?;
        let bias = weights.tensor("fe.context.fc.bias", &[CONTEXT_EMBEDDING])?;
        Ok(Linear::pack(matrix, Some(bias), [CONTEXT_EMBEDDING, channels], 0..channels))
    }

    /// Multiply-adds of one patch that affect the result; taps on padding are not counted.
    pub const fn multiply_adds(&self) -> usize {
        self.multiply_adds
    }

    /// Numbers in one patch, \[channel, row, column\].
    pub const fn patch_len(&self) -> usize {
        PATCH_CHANNELS * self.patch_side * self.patch_side
    }

    /// Context embeddings CE of consecutive patches, one row per patch.
    ///
    /// # Panics
    /// If the number of patches differs from the number of rows in `out`.
    pub fn embed(&self, patches: &[f32], memory: &mut ContextMemory, out: &mut [[f32; CONTEXT_EMBEDDING]]) {
        assert_eq!(patches.len(), out.len() * self.patch_len(), "a patch for each row");
        let batches = patches.chunks(BATCH * self.patch_len()).zip(out.chunks_mut(BATCH));
        for (patches, out) in batches {
            self.embed_batch(patches, memory, out);
        }
    }

    fn embed_batch(&self, patches: &[f32], memory: &mut ContextMemory, out: &mut [[f32; CONTEXT_EMBEDDING]]) {
        let images = out.len();
        let ContextMemory { input, maps, pooled } = memory;
        input.reserve(images * self.patch_len());
        maps.iter_mut().for_each(|map| map.reserve(images * self.largest));
        interleave(patches, images, input);
        let [x, inner, shortcut, y] = maps;
        self.stem.run(input, images, None, Activation::Relu, x);
        if let Some(side) = self.pool_side {
            max_pool(x, side, images * self.stem.out_channels(), y);
            std::mem::swap(x, y);
        }
        for block in &self.blocks {
            block.first.run(x, images, None, Activation::Relu, inner);
            let around = match &block.projection {
                Some(projection) => {
                    projection.run(x, images, None, Activation::None, shortcut);
                    &*shortcut
                }
                None => &*x,
            };
            block.second.run(inner, images, Some(around), Activation::Relu, y);
            std::mem::swap(x, y);
        }
        let (positions, channels) =
            self.blocks.last().map_or((1, 16), |b| (b.second.out_positions(), b.second.out_channels()));
        average(x, positions, images * channels, pooled);
        self.fc.run(pooled, channels, Activation::None, out.as_flattened_mut());
    }
}

impl Block {
    fn read(
        weights: &Weights,
        [stage, index]: [usize; 2],
        [in_channels, out_channels]: [usize; 2],
        side: usize,
        stride: usize,
    ) -> Result<Self, WeightsError> {
        let name = |layer: &str| format!("layer{}.{index}.{layer}", stage + 1);
        let conv = |[conv, norm]: [&str; 2], channels: usize, geometry| {
            let channels = [channels, channels.next_multiple_of(PANEL)];
            Conv::read(weights, [&name(conv), &name(norm)], channels, out_channels, geometry)
        };
        let first = conv(["conv1", "bn1"], in_channels, Geometry { side, kernel: 3, stride, padding: 1 })?;
        let inner_side = first.out_side();
        let inner = Geometry { side: inner_side, kernel: 3, stride: 1, padding: 1 };
        let second = conv(["conv2", "bn2"], out_channels, inner)?;
        let projection = (stride != 1 || in_channels != out_channels)
            .then(|| {
                let geometry = Geometry { side, kernel: 1, stride, padding: 0 };
                conv(["downsample.0", "downsample.1"], in_channels, geometry)
            })
            .transpose()?;
        Ok(Self { first, second, projection })
    }

    fn convolutions(&self) -> impl Iterator<Item = &Conv> {
        [&self.first, &self.second].into_iter().chain(&self.projection)
    }
}

/// \[image, channel, position\] to \[position, image, channel\].
fn interleave(patches: &[f32], images: usize, out: &mut [f32]) {
    let positions = patches.len() / (images * PATCH_CHANNELS);
    for (plane, values) in patches.chunks_exact(positions).enumerate() {
        for (position, &value) in values.iter().enumerate() {
            out[position * images * PATCH_CHANNELS + plane] = value;
        }
    }
}

/// Mean over the positions of \[position, row\].
fn average(x: &[f32], positions: usize, row_len: usize, out: &mut Buffer) {
    out.reserve(row_len);
    let out = &mut out[..row_len];
    out.copy_from_slice(&x[..row_len]);
    for row in x[..positions * row_len].chunks_exact(row_len).skip(1) {
        out.iter_mut().zip(row).for_each(|(sum, x)| *sum += x);
    }
    let share = 1.0 / positions as f32;
    out.iter_mut().for_each(|sum| *sum *= share);
}
