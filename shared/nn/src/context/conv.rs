use crate::buffer::Buffer;
use crate::kernels::product::{Gather, Panels, Product, Taps};
use crate::linear::Activation;
use crate::weights::{Weights, WeightsError};

/// ε, which PyTorch adds to the variance.
const BATCH_NORM_EPSILON: f64 = 1e-5;

/// The square map and kernel of a convolution.
#[derive(Clone, Copy)]
pub(super) struct Geometry {
    pub(super) side: usize,
    pub(super) kernel: usize,
    pub(super) stride: usize,
    pub(super) padding: usize,
}

/// A convolution with the following batch norm folded in.
pub(super) struct Conv {
    panels: Panels,
    taps: Taps,
    zeros: Buffer,
    out_side: usize,
    multiply_adds: usize,
}

impl Conv {
    /// The convolution `fe.context.{conv}` \[out, in, row, column\] and the batch norm `fe.context.{norm}`.
    ///
    /// Input pixels are `in_stride` floats apart; their first `in_channels` floats are used.
    ///
    /// ```text
    /// y = γ (W ∗ x − mean) / √(var + ε) + bias  =  (s W) ∗ x + (bias − s mean),   s = γ / √(var + ε)
    /// ```
    pub(super) fn read(
        weights: &Weights,
        [conv, norm]: [&str; 2],
        [in_channels, in_stride]: [usize; 2],
        out_channels: usize,
        Geometry { side, kernel, stride, padding }: Geometry,
    ) -> Result<Self, WeightsError> {
        let shape = [out_channels, in_channels, kernel, kernel];
        let filter = weights.tensor(&format!("fe.context.{conv}.weight"), &shape)?;
        let of = |part: &str| weights.tensor(&format!("fe.context.{norm}.{part}"), &[out_channels]);
        let (gamma, bias, mean, var) = (of("weight")?, of("bias")?, of("running_mean")?, of("running_var")?);
        let scale = |out: usize| f64::from(gamma[out]) / (f64::from(var[out]) + BATCH_NORM_EPSILON).sqrt();
        let tap_count = kernel * kernel;
        let weight = |out: usize, tap: usize, c: usize| {
            if c >= in_channels {
                return 0.0;
            }
            (scale(out) * f64::from(filter[(out * in_channels + c) * tap_count + tap])) as f32
        };
        let shift = |out: usize| (f64::from(bias[out]) - scale(out) * f64::from(mean[out])) as f32;
        let taps = Taps::new(side, kernel, stride, padding);
        Ok(Self {
            panels: Panels::pack([out_channels, tap_count, in_stride], weight, shift),
            zeros: Buffer::zeroed(in_stride),
            out_side: (side + 2 * padding - kernel) / stride + 1,
            multiply_adds: taps.live_count() * in_channels * out_channels,
            taps,
        })
    }

    pub(super) const fn out_side(&self) -> usize {
        self.out_side
    }

    pub(super) const fn out_positions(&self) -> usize {
        self.out_side * self.out_side
    }

    /// Number of output channels, padded.
    pub(super) const fn out_channels(&self) -> usize {
        self.panels.out_stride()
    }

    /// Multiply-adds of one image, without those on padding.
    pub(super) const fn multiply_adds(&self) -> usize {
        self.multiply_adds
    }

    /// Convolves `image_count` images, \[position, image, channel\], into the front of `out`.
    pub(super) fn run(
        &self,
        input: &[f32],
        image_count: usize,
        residual: Option<&[f32]>,
        activation: Activation,
        out: &mut [f32],
    ) {
        let len = self.out_positions() * image_count * self.out_channels();
        Product {
            input,
            gather: Gather::Taps { taps: &self.taps, image_count, zeros: &self.zeros },
            panels: &self.panels,
            residual: residual.map(|residual| &residual[..len]),
            relu: activation == Activation::Relu,
            out: &mut out[..len],
        }
        .run();
    }
}

/// Max-pool 3×3/2 with padding 1 over \[position, row\]. The input is nonnegative, so padding counts as 0.
pub(super) fn max_pool(x: &[f32], side: usize, row_len: usize, out: &mut [f32]) {
    let out_side = side.div_ceil(2);
    for (position, out) in out.chunks_exact_mut(row_len).take(out_side * out_side).enumerate() {
        out.fill(0.0);
        let (row, column) = (2 * (position / out_side), 2 * (position % out_side));
        for r in row.saturating_sub(1)..(row + 2).min(side) {
            for c in column.saturating_sub(1)..(column + 2).min(side) {
                let seen = &x[(r * side + c) * row_len..][..row_len];
                out.iter_mut().zip(seen).for_each(|(most, &x)| *most = most.max(x));
            }
        }
    }
}
