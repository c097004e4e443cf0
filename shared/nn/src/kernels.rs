//! Hand-written f32 kernels on packed weights, chosen at run time by the processor's instruction sets.
//!
//! A kernel is written once, generic over `Lanes`: the operations of an instruction set, as a token that
//! exists only where the processor has that set. `dispatch` hands a `Kernel` the token of the set in use,
//! inside a function that is compiled for it.
//!
//! Three kernels carry the network: the `product` of gathered rows with packed panels (linear layers and
//! convolutions alike), the `gates` of the GRU and the exponential function.

use std::sync::atomic::{AtomicU8, Ordering};

use thiserror::Error;

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
pub(crate) mod gates;
mod lanes;
mod math;
#[cfg(target_arch = "aarch64")]
mod neon;
pub mod peak;
mod portable;
pub mod product;

pub use lanes::Lanes;
pub use math::{exp, exp_in_place, sigmoid, sin_cos, tanh};

/// An instruction set that the kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Isa {
    /// 16 lanes, fused multiply-add.
    Avx512 = 1,
    /// 8 lanes, fused multiply-add.
    Avx2 = 2,
    /// 4 lanes, fused multiply-add.
    Neon = 3,
    /// Plain Rust as the compiler translates it, on any processor.
    Portable = 4,
}

/// The processor lacks an instruction set.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("this processor has no {}", .0.name())]
pub struct Unavailable(pub Isa);

impl Isa {
    /// All instruction sets, the fastest first.
    pub const ALL: [Self; 4] = [Self::Avx512, Self::Avx2, Self::Neon, Self::Portable];

    /// The name used in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Avx512 => "AVX-512",
            Self::Avx2 => "AVX2",
            Self::Neon => "NEON",
            Self::Portable => "portable",
        }
    }

    /// Whether this processor has it.
    #[must_use]
    pub fn available(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => is_x86_feature_detected!("avx512f"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            #[cfg(target_arch = "aarch64")]
            Self::Neon => std::arch::is_aarch64_feature_detected!("neon"),
            Self::Portable => true,
            _ => false,
        }
    }
}

/// The set in use as a number, 0 before the first kernel ran.
static ACTIVE: AtomicU8 = AtomicU8::new(0);

/// The instruction set in use: the fastest that the processor has, unless [`force`] chose another.
#[must_use]
pub fn active() -> Isa {
    let number = ACTIVE.load(Ordering::Relaxed);
    if let Some(isa) = Isa::ALL.into_iter().find(|&isa| isa as u8 == number) {
        return isa;
    }
    let isa = Isa::ALL.into_iter().find(|isa| isa.available()).unwrap_or(Isa::Portable);
    ACTIVE.store(isa as u8, Ordering::Relaxed);
    isa
}

/// Makes all kernels of this process use `isa` from now on.
///
/// # Errors
/// [`Unavailable`] where the processor lacks it; nothing changes then.
pub fn force(isa: Isa) -> Result<(), Unavailable> {
    if !isa.available() {
        return Err(Unavailable(isa));
    }
    ACTIVE.store(isa as u8, Ordering::Relaxed);
    Ok(())
}

/// A computation that is compiled once for each instruction set. `run` must be `#[inline(always)]`, so that
/// its body ends up in a function with the set's target features.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// Computes, on `lanes`.
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// Runs a kernel on the instruction set in use.
#[expect(unsafe_code, reason = "calls functions that are compiled for an instruction set")]
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    match active() {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `active` names only sets that the processor has.
        Isa::Avx512 => unsafe { avx512::run(kernel) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: as above.
        Isa::Avx2 => unsafe { avx2::run(kernel) },
        #[cfg(target_arch = "aarch64")]
        // SAFETY: as above.
        Isa::Neon => unsafe { neon::run(kernel) },
        _ => portable::run(kernel),
    }
}
