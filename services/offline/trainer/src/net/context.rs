//! The context CNN: a ResNet-18 of any width, from a local patch of the context map to 32 numbers.
//! \[model §3\]
//!
//! ```text
//! stem:   convolution/2, batch norm, ReLU and, in the imagenet stem, a max-pool/2
//! blocks: two in each of four stages, y = ReLU(norm(conv(ReLU(norm(conv x)))) + shortcut x)
//! head:   mean over the positions, linear layer
//! ```
//!
//! Patches are `[patch, 3, row, column]` (channels and units: \[model §2\]), embeddings `[patch, 32]`.
//!
//! Each stage has twice the channels of the previous one. From the second stage on, the first block has
//! stride 2 and a 1×1 convolution as shortcut. All other shortcuts are the identity.

mod block;
mod convolution;
mod map;
mod norm;
mod stem;
#[cfg(test)]
mod tests;

use nn::kernels::product::Taps;
use nn::{ModelConfig, Stem as StemKind};
use wire::CONTEXT_EMBEDDING;

use super::matrix::{Matrix, by_bias};
use super::tensors::{Gradients, Tensors};
use block::{Block, BlockTrace};
use convolution::{Convolution, Geometry};
use map::{Map, average, average_backward, max_pool, max_pool_backward};
pub(crate) use norm::Normalisation;
use norm::{BackwardPass, Norm, NormTrace, Pass, Then};
use stem::Stem;

const STAGES: usize = 4;
/// Blocks of a stage.
const BLOCKS: usize = 2;
const FC_BIAS: &str = "fe.context.fc.bias";

/// Embeddings of patches.
pub(crate) struct Embedded {
    /// \[patch, 32\].
    pub(crate) embedding: Matrix,
    /// New running values of the batch norms: (tensor name, values). Empty if the running values normalise.
    pub(crate) statistics: Vec<(String, Vec<f32>)>,
    trace: Option<Trace>,
}

/// The values that the backward pass needs.
struct Trace {
    network: Network,
    patches: Vec<f32>,
    stem: NormTrace,
    /// Input of the max-pool, if there is one.
    unpooled: Option<Map>,
    blocks: Vec<BlockTrace>,
    /// The input of each block, and the output of the last.
    maps: Vec<Map>,
    means: Map,
}

/// The layers, with the tables of their taps.
struct Network {
    stem: Stem,
    stem_norm: Norm,
    pool: Option<Taps>,
    blocks: Vec<Block>,
    /// The linear layer, as a convolution of maps with one position.
    fc: Convolution,
}

impl Network {
    fn new(config: &ModelConfig) -> Self {
        let width = config.width;
        let (kernel, padding) = match config.stem {
            StemKind::Imagenet => (7, 3),
            StemKind::Compact => (3, 1),
        };
        let geometry = Geometry { side: config.patch_size, kernel, stride: 2, padding };
        let stem = Stem { name: "fe.context.conv1.weight".to_owned(), geometry, out_channels: width };
        let mut side = geometry.out_side();
        let pooling = Geometry { side, kernel: 3, stride: 2, padding: 1 };
        let pool = (config.stem == StemKind::Imagenet).then(|| pooling.taps());
        if pool.is_some() {
            side = pooling.out_side();
        }
        let mut blocks: Vec<Block> = Vec::new();
        let mut channels = width;
        for stage in 0..STAGES {
            for block in 0..BLOCKS {
                let name = format!("fe.context.layer{}.{block}", stage + 1);
                let stride = if stage > 0 && block == 0 { 2 } else { 1 };
                let block = Block::new(&name, side, stride, [channels, width << stage]);
                (side, channels) = (block.out_side(), width << stage);
                blocks.push(block);
            }
        }
        let point = Geometry { side: 1, kernel: 1, stride: 1, padding: 0 };
        let fc = Convolution::new("fe.context.fc.weight".to_owned(), point, [channels, CONTEXT_EMBEDDING]);
        Self { stem, stem_norm: Norm("fe.context.bn1".to_owned()), pool, blocks, fc }
    }
}

/// Embeds `patches` \[patch, 3, row, column\]. A backward pass needs `keep_trace`.
pub(crate) fn embed(
    weights: &Tensors,
    config: &ModelConfig,
    patches: &[f32],
    normalisation: Normalisation,
    keep_trace: bool,
) -> Embedded {
    let network = Network::new(config);
    let mut pass = Pass { weights, normalisation, statistics: Vec::new() };
    let convolved = network.stem.forward(weights, patches);
    let (mut x, stem) = network.stem_norm.forward(&mut pass, convolved, Then::Relu);
    let mut unpooled = None;
    if let Some(taps) = &network.pool {
        let pooled = max_pool(&x, taps);
        unpooled = Some(std::mem::replace(&mut x, pooled));
    }
    let (mut maps, mut blocks) = (Vec::new(), Vec::new());
    for block in &network.blocks {
        let (y, trace) = block.forward(&mut pass, &x);
        if keep_trace {
            maps.push(x);
            blocks.push(trace);
        }
        x = y;
    }
    let means = average(&x);
    let mut embedding = Matrix::new(x.images, CONTEXT_EMBEDDING, network.fc.forward(weights, &means).values);
    for row in embedding.values.chunks_exact_mut(CONTEXT_EMBEDDING) {
        row.iter_mut().zip(weights.get(FC_BIAS)).for_each(|(value, bias)| *value += bias);
    }
    let statistics = pass.statistics;
    let trace = keep_trace.then(|| {
        maps.push(x);
        Trace { network, patches: patches.to_vec(), stem, unpooled, blocks, maps, means }
    });
    Embedded { embedding, statistics, trace }
}

impl Embedded {
    /// The backward pass: adds to the gradients of the weights.
    pub(crate) fn backward(&self, weights: &Tensors, gradients: &mut Gradients, d_embedding: &Matrix) {
        let trace = self.trace.as_ref().expect("the caller asked for a trace");
        let Trace { network, patches, stem, unpooled, blocks, maps, means } = trace;
        by_bias(d_embedding, gradients.get_mut(FC_BIAS));
        let (images, channels) = (d_embedding.rows, d_embedding.cols);
        let dy = Map { positions: 1, images, channels, values: d_embedding.values.clone() };
        network.fc.by_kernel(gradients, means, &dy);
        let d_means = network.fc.by_input(weights, &dy, None);
        let mut pass = BackwardPass { weights, gradients };
        let positions = maps.last().map_or(1, |map| map.positions);
        let mut dx = average_backward(&d_means, positions);
        for ((block, trace), maps) in network.blocks.iter().zip(blocks).zip(maps.windows(2)).rev() {
            dx = block.backward(&mut pass, trace, [&maps[0], &maps[1]], dx);
        }
        let mut stemmed = &maps[0];
        if let Some((taps, unpooled)) = network.pool.as_ref().zip(unpooled.as_ref()) {
            dx = max_pool_backward([unpooled, stemmed], taps, dx);
            stemmed = unpooled;
        }
        let d_convolved = network.stem_norm.backward(&mut pass, stem, Some(stemmed), &mut dx);
        network.stem.by_kernel(gradients, patches, &d_convolved);
    }
}
