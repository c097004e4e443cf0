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

mod pairs;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod x86;

use thiserror::Error;

use super::{Isa, active};
use crate::Precision;
pub(crate) use pairs::{DotProducts, PairPanels, PairProduct};

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
