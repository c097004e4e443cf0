use std::ops::Range;

use crate::buffer::Buffer;
use crate::kernels::bf16::{DotProducts, PairPanels, PairProduct};
use crate::kernels::product::{Gather, Panels, Product};
use crate::weights::{Weights, WeightsError};

/// Rows that an MLP processes together; their activations stay in the first-level caches.
const BLOCK: usize = 48;

/// y = x Wᵀ + b on packed weights.
pub(crate) struct Linear {
    matrix: Matrix,
}

/// A layer's packed weights in the selected precision.
enum Matrix {
    F32(Panels),
    Bf16(PairPanels),
}

/// The function after a product.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Activation {
    None,
    Relu,
}

impl Linear {
    /// The layer `{name}.weight` \[out, in\] with `{name}.bias`.
    pub(crate) fn read(
        weights: &Weights,
        name: &str,
        out_len: usize,
        in_len: usize,
    ) -> Result<Self, WeightsError> {
        let matrix = weights.tensor(&format!("{name}.weight"), &[out_len, in_len])?;
        let bias = weights.tensor(&format!("{name}.bias"), &[out_len])?;
        Ok(Self::pack(matrix, Some(bias), [out_len, in_len], 0..in_len))
    }

    /// The layer `{name}.weight` \[out, in\] without bias.
    pub(crate) fn read_unbiased(
        weights: &Weights,
        name: &str,
        out_len: usize,
        in_len: usize,
    ) -> Result<Self, WeightsError> {
        let matrix = weights.tensor(&format!("{name}.weight"), &[out_len, in_len])?;
        Ok(Self::pack(matrix, None, [out_len, in_len], 0..in_len))
    }

    /// The columns `columns` of a matrix \[out, in\]: the part of a layer that reads one section of a
    /// concatenation.
    pub(crate) fn pack(
        matrix: &[f32],
        bias: Option<&[f32]>,
        [out_len, in_len]: [usize; 2],
        columns: Range<usize>,
    ) -> Self {
        let weight = |out: usize, _, c: usize| matrix[out * in_len + columns.start + c];
        let bias = |out: usize| bias.map_or(0.0, |bias| bias[out]);
        Self { matrix: Matrix::F32(Panels::pack([out_len, 1, columns.len()], weight, bias)) }
    }

    /// A matrix \[out, in\] with its bias; in bf16 if `dot_products` is given.
    pub(crate) fn pack_as(
        dot_products: Option<DotProducts>,
        matrix: &[f32],
        bias: &[f32],
        shape: [usize; 2],
    ) -> Self {
        let in_len = shape[1];
        let Some(dot_products) = dot_products else {
            return Self::pack(matrix, Some(bias), shape, 0..in_len);
        };
        let weight = |out: usize, c: usize| matrix[out * in_len + c];
        Self { matrix: Matrix::Bf16(PairPanels::pack(dot_products, shape, weight, |out| bias[out])) }
    }

    /// Length of an output row: the layer's outputs, padded with zeros to a multiple of 16.
    pub(crate) const fn out_stride(&self) -> usize {
        match &self.matrix {
            Matrix::F32(panels) => panels.out_stride(),
            Matrix::Bf16(panels) => panels.out_stride(),
        }
    }

    /// Computes the rows of `out`, \[row, `out_stride`\], from rows of `input` at a distance of `stride`.
    pub(crate) fn run(&self, input: &[f32], stride: usize, activation: Activation, out: &mut [f32]) {
        self.product(input, stride, None, activation, out);
    }

    /// The same with `residual`, \[row, `out_stride`\], added before the activation.
    pub(crate) fn run_onto(
        &self,
        input: &[f32],
        stride: usize,
        residual: &[f32],
        activation: Activation,
        out: &mut [f32],
    ) {
        self.product(input, stride, Some(residual), activation, out);
    }

    fn product(
        &self,
        input: &[f32],
        stride: usize,
        residual: Option<&[f32]>,
        activation: Activation,
        out: &mut [f32],
    ) {
        let relu = activation == Activation::Relu;
        match &self.matrix {
            Matrix::F32(panels) => {
                Product { input, gather: Gather::Rows { stride }, panels, residual, relu, out }.run();
            }
            Matrix::Bf16(panels) => PairProduct { input, stride, panels, residual, relu, out }.run(),
        }
    }
}

/// Linear layers with ReLU between them.
pub(crate) struct Mlp {
    layers: Vec<Linear>,
    in_len: usize,
    widest: usize,
}

/// Scratch memory of the MLPs.
#[derive(Default)]
pub struct MlpMemory {
    a: Buffer,
    b: Buffer,
}

impl Mlp {
    /// The layers `{name}.0` … with the given lengths, the input's first.
    pub(crate) fn read(weights: &Weights, name: &str, lengths: &[usize]) -> Result<Self, WeightsError> {
        let layers = lengths
            .windows(2)
            .enumerate()
            .map(|(i, pair)| Linear::read(weights, &format!("{name}.{i}"), pair[1], pair[0]))
            .collect::<Result<Vec<_>, _>>()?;
        let widest = layers.iter().map(Linear::out_stride).max().unwrap_or(0);
        Ok(Self { layers, in_len: lengths[0], widest })
    }

    /// Length of an output row.
    pub(crate) fn out_stride(&self) -> usize {
        self.layers.last().map_or(self.in_len, Linear::out_stride)
    }

    /// Computes the rows of `out`, \[row, `out_stride`\], from the rows of `input`, \[row, in\].
    pub(crate) fn run(&self, input: &[f32], memory: &mut MlpMemory, out: &mut [f32]) {
        memory.a.reserve(BLOCK * self.widest);
        memory.b.reserve(BLOCK * self.widest);
        let Some((last, hidden)) = self.layers.split_last() else { return };
        let blocks = input.chunks(BLOCK * self.in_len).zip(out.chunks_mut(BLOCK * self.out_stride()));
        for (input, out) in blocks {
            let row_count = input.len() / self.in_len;
            let (mut from, mut to) = (&mut memory.a, &mut memory.b);
            let mut stride = self.in_len;
            for (i, layer) in hidden.iter().enumerate() {
                let source = if i == 0 { input } else { &from[..] };
                layer.run(source, stride, Activation::Relu, &mut to[..row_count * layer.out_stride()]);
                stride = layer.out_stride();
                std::mem::swap(&mut from, &mut to);
            }
            let source = if hidden.is_empty() { input } else { &from[..] };
            last.run(source, stride, Activation::None, out);
        }
    }
}
