//! Products in bf16: both factors rounded to the upper half of an f32, sums in f32.
//!
//! ```text
//! out[q, o] = ( Σ_p  x[q, 2p] · W[o, 2p] + x[q, 2p + 1] · W[o, 2p + 1]  + bias[o] + residual[q, o] )⁺
//! ```
//!
//! The processor's dot product (`vdpbf16ps`) takes a pair of inputs per step and therefore does twice the
//! work of an f32 multiply-add. It has its own rounding and treats numbers below 2⁻¹²⁶ as 0. No other
//! instruction set here does that, so a second implementation could not give the same bits, and there is
//! none. A processor without the instruction refuses the precision ([`Precision::check`]).
//!
//! W is rounded once and packed as `[⌈out / 16⌉][⌈in / 2⌉][16]` pairs. Inputs are rounded when a block of
//! rows is loaded. Both round to nearest, ties to even. Each output is one chain of dot products in the order
//! of the pairs. Its bits therefore depend neither on the tile's shape nor on the other rows of a batch.

#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

use thiserror::Error;

use super::product::PANEL;
use super::{Isa, active};
use crate::Precision;
use crate::buffer::Buffer;
use crate::halves::to_bf16;

/// Maximum number of inputs of a layer.
pub(crate) const IN_MAX: usize = 128;

/// The content of a proof: empty, or a type that can't exist if no processor has the dot products.
#[cfg(target_arch = "x86_64")]
type Proof = ();
#[cfg(not(target_arch = "x86_64"))]
type Proof = std::convert::Infallible;

/// Proof that the processor has bf16 dot products.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DotProducts(Proof);

/// Why a precision can't be used.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum PrecisionError {
    /// The processor lacks the required instructions.
    #[error("precision bf16 needs AVX-512 BF16, which this processor lacks: leave the precision at f32")]
    Unavailable,
    /// The kernels in use belong to another instruction set.
    #[error(
        "precision bf16 needs the AVX-512 kernels, not {0}: leave the precision at f32, or use --kernels avx512"
    )]
    OtherKernels(Isa),
}

/// Whether this processor has bf16 dot products.
#[must_use]
pub fn available() -> bool {
    #[cfg(target_arch = "x86_64")]
    return Isa::Avx512.available() && is_x86_feature_detected!("avx512bf16");
    #[cfg(not(target_arch = "x86_64"))]
    return false;
}

impl Precision {
    /// Refuses a precision that this process can't compute in.
    ///
    /// # Errors
    /// [`PrecisionError`] names the missing feature and the remedy.
    pub fn check(self) -> Result<(), PrecisionError> {
        self.dot_products().map(|_| ())
    }

    /// The proof that layers need for this precision; `None` for f32.
    pub(crate) fn dot_products(self) -> Result<Option<DotProducts>, PrecisionError> {
        match self {
            Self::F32 => Ok(None),
            Self::Bf16 if !available() => Err(PrecisionError::Unavailable),
            Self::Bf16 if active() != Isa::Avx512 => Err(PrecisionError::OtherKernels(active())),
            #[cfg(target_arch = "x86_64")]
            Self::Bf16 => Ok(Some(DotProducts(()))),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Bf16 => Err(PrecisionError::Unavailable),
        }
    }
}

/// A bf16 matrix in the kernel's reading order, with an f32 bias.
#[cfg_attr(not(target_arch = "x86_64"), expect(dead_code, reason = "there are no dot products to read them"))]
pub(crate) struct PairPanels {
    proof: DotProducts,
    /// Pairs, each in the bits of one f32: the even input in the lower half.
    values: Buffer,
    bias: Buffer,
    in_len: usize,
    panel_count: usize,
}

/// A product's input and output; see the module.
#[cfg_attr(not(target_arch = "x86_64"), expect(dead_code, reason = "as above"))]
pub(crate) struct PairProduct<'a> {
    /// Rows at a distance of `stride` floats.
    pub(crate) input: &'a [f32],
    pub(crate) stride: usize,
    /// The matrix, with the bias.
    pub(crate) panels: &'a PairPanels,
    /// Added before the ReLU; in the layout of `out`.
    pub(crate) residual: Option<&'a [f32]>,
    /// Whether negative results become 0.
    pub(crate) relu: bool,
    /// \[row, `panels.out_stride()`\].
    pub(crate) out: &'a mut [f32],
}

impl PairPanels {
    /// Rounds and packs the matrix whose entry (out, in) is `weight(out, in)`. Outputs are padded with zeros
    /// to whole panels.
    pub(crate) fn pack(
        proof: DotProducts,
        [out_len, in_len]: [usize; 2],
        weight: impl Fn(usize, usize) -> f32,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        assert!((1..=IN_MAX).contains(&in_len) && out_len > 0, "a {in_len} × {out_len} matrix");
        let panel_count = out_len.div_ceil(PANEL);
        let pair_count = in_len.div_ceil(2);
        let mut values = Buffer::zeroed(panel_count * pair_count * PANEL);
        let mut padded_bias = Buffer::zeroed(panel_count * PANEL);
        for out in 0..out_len {
            padded_bias[out] = bias(out);
            let bits = |i: usize| if i < in_len { to_bf16(weight(out, i)) } else { 0 };
            for pair in 0..pair_count {
                let [low, high] = [2 * pair, 2 * pair + 1].map(|i| u32::from(bits(i)));
                let place = (out / PANEL * pair_count + pair) * PANEL + out % PANEL;
                values[place] = f32::from_bits(high << 16 | low);
            }
        }
        Self { proof, values, bias: padded_bias, in_len, panel_count }
    }

    /// Length of an output row: a multiple of 16.
    pub(crate) const fn out_stride(&self) -> usize {
        self.panel_count * PANEL
    }

    #[cfg(target_arch = "x86_64")]
    const fn pair_count(&self) -> usize {
        self.in_len.div_ceil(2)
    }
}

impl PairProduct<'_> {
    /// Computes all rows of `out`.
    pub(crate) fn run(self) {
        let out_stride = self.panels.out_stride();
        let row_count = self.out.len() / out_stride;
        assert_eq!(self.out.len(), row_count * out_stride, "whole rows of output");
        assert!(self.residual.is_none_or(|r| r.len() == self.out.len()), "residual like output");
        if row_count == 0 {
            return;
        }
        let last = (row_count - 1).checked_mul(self.stride);
        let end = last.and_then(|last| last.checked_add(self.panels.in_len));
        assert!(end.is_some_and(|end| end <= self.input.len()), "rows of input");
        let DotProducts(proof) = self.panels.proof;
        #[cfg(target_arch = "x86_64")]
        {
            let () = proof;
            x86::run(self, row_count);
        }
        #[cfg(not(target_arch = "x86_64"))]
        match proof {}
    }
}
