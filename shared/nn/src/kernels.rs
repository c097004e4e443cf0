//! Hand-written f32 kernels on packed weights, chosen at run time by the processor's instruction sets.
//!
//! A kernel is written once, generic over `Lanes`. `Lanes` provides the operations of an instruction set
//! through a token that exists only if the processor has the set. `dispatch` calls a `Kernel` with the token
//! of the set in use, inside a function that is compiled for the set.
//!
//! Products in [`bf16`] are separate: only one instruction set has them.
//!
//! Three kernels dominate the network: the `product` of gathered rows with packed panels (for linear layers
//! and convolutions), the `gates` of the GRU, and the exponential function.

use std::fmt;
use std::str::FromStr;
use std::sync::atomic::{AtomicU8, Ordering};

use thiserror::Error;

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
pub mod bf16;
pub(crate) mod gates;
mod lanes;
mod math;
#[cfg(target_arch = "aarch64")]
mod neon;
pub mod peak;
mod portable;
pub mod product;

pub use lanes::{Kernel, Lanes};
pub use math::{exp, exp_in_place, sigmoid, sin_cos, tanh};

wire::named! {
    /// An instruction set that the kernels are compiled for.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    #[repr(u8)]
    pub enum Isa {
        /// 16 lanes, fused multiply-add.
        Avx512 = 1 => "AVX-512",
        /// 8 lanes, fused multiply-add.
        Avx2 = 2 => "AVX2",
        /// 4 lanes, fused multiply-add.
        Neon = 3 => "NEON",
        /// Plain Rust, on any processor.
        Portable = 4 => "portable",
    }
}

/// The environment variable that names the instruction set to use.
pub const VARIABLE: &str = "STGDAT_KERNELS";

/// Why an instruction set can't be used.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum IsaError {
    /// The processor lacks it.
    #[error("this processor has no {}, only {}", .0.name(), Isa::available_names())]
    Unavailable(Isa),
    /// No instruction set has this name.
    #[error("there is no instruction set {0:?}: one of avx512, avx2, neon, portable")]
    Unknown(String),
    /// [`VARIABLE`] names a set that can't be used.
    #[error("{VARIABLE}: {0}")]
    Variable(Box<IsaError>),
}

impl Isa {
    /// The name that options and [`VARIABLE`] take.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Avx512 => "avx512",
            Self::Avx2 => "avx2",
            Self::Neon => "neon",
            Self::Portable => "portable",
        }
    }

    /// The names of all sets that this processor has, fastest first.
    #[must_use]
    pub fn available_names() -> String {
        Self::ALL.into_iter().filter(|isa| isa.available()).map(Self::name).collect::<Vec<_>>().join(", ")
    }

    /// Whether this processor has it.
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

impl fmt::Display for Isa {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A set that this processor has, by its [`Isa::key`].
impl FromStr for Isa {
    type Err = IsaError;

    fn from_str(key: &str) -> Result<Self, IsaError> {
        let isa = Self::ALL.into_iter().find(|isa| isa.key() == key);
        let isa = isa.ok_or_else(|| IsaError::Unknown(key.to_owned()))?;
        if isa.available() { Ok(isa) } else { Err(IsaError::Unavailable(isa)) }
    }
}

/// The set in use as a number; 0 before the first kernel has run.
static ACTIVE: AtomicU8 = AtomicU8::new(0);
/// The requested set as a number; 0 if none was requested.
static FORCED: AtomicU8 = AtomicU8::new(0);

fn of_number(number: u8) -> Option<Isa> {
    Isa::ALL.into_iter().find(|&isa| isa as u8 == number)
}

/// The instruction set in use: the one that [`force`] or [`VARIABLE`] selects, or else the processor's
/// fastest.
///
/// # Panics
/// If the value of [`VARIABLE`] can't be used; programs report this earlier through [`follow_environment`].
#[must_use]
pub fn active() -> Isa {
    of_number(ACTIVE.load(Ordering::Relaxed)).unwrap_or_else(|| match follow_environment() {
        Ok(isa) => isa,
        Err(error) => panic!("{error}"),
    })
}

/// The set that [`force`] or [`VARIABLE`] selected; `None` if the fastest is in use by default.
#[must_use]
pub fn forced() -> Option<Isa> {
    of_number(FORCED.load(Ordering::Relaxed))
}

/// Selects the set that [`VARIABLE`] names, or else the fastest; does nothing if a set is already selected.
///
/// # Errors
/// [`IsaError::Variable`] if the variable names no set, or one that the processor lacks.
pub fn follow_environment() -> Result<Isa, IsaError> {
    if let Some(isa) = of_number(ACTIVE.load(Ordering::Relaxed)) {
        return Ok(isa);
    }
    if let Some(key) = std::env::var_os(VARIABLE) {
        let isa = key.to_string_lossy().parse().map_err(|error| IsaError::Variable(Box::new(error)))?;
        force(isa)?;
        return Ok(isa);
    }
    let isa = Isa::ALL.into_iter().find(|isa| isa.available()).unwrap_or(Isa::Portable);
    ACTIVE.store(isa as u8, Ordering::Relaxed);
    Ok(isa)
}

/// Makes all kernels of this process use `isa` from now on.
///
/// # Errors
/// [`IsaError::Unavailable`] if the processor lacks it; nothing changes then.
pub fn force(isa: Isa) -> Result<(), IsaError> {
    if !isa.available() {
        return Err(IsaError::Unavailable(isa));
    }
    FORCED.store(isa as u8, Ordering::Relaxed);
    ACTIVE.store(isa as u8, Ordering::Relaxed);
    Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_set_has_a_key_that_leads_back_to_it() {
        for isa in Isa::ALL {
            let expected = if isa.available() { Ok(isa) } else { Err(IsaError::Unavailable(isa)) };
            assert_eq!(isa.key().parse(), expected);
        }
        assert_eq!("AVX2".parse::<Isa>(), Err(IsaError::Unknown("AVX2".to_owned())));
        assert_eq!(
            "sse".parse::<Isa>().unwrap_err().to_string(),
            "there is no instruction set \"sse\": one of avx512, avx2, neon, portable"
        );
    }

    #[test]
    fn no_processor_has_both_neon_and_avx2() {
        let lacking = if Isa::Neon.available() { Isa::Avx2 } else { Isa::Neon };
        let message = force(lacking).unwrap_err().to_string();
        assert!(message.starts_with(&format!("this processor has no {lacking}, only ")), "{message}");
        assert!(message.ends_with("portable"), "{message}");
    }
}
