#![expect(unsafe_code, reason = "NEON intrinsics")]

use std::arch::aarch64::*;

use super::lanes::{Kernel, Lanes};

/// NEON; only [`run`] creates it.
#[derive(Clone, Copy)]
pub(crate) struct Neon(());

/// # Safety
/// The processor has NEON.
#[target_feature(enable = "neon")]
pub(super) unsafe fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Neon(()))
}

macro_rules! operations {
    ($($name:ident($($a:ident),+) = $intrinsic:expr;)+) => {
        $(
            #[inline(always)]
            fn $name(self, $($a: float32x4_t),+) -> float32x4_t {
                // SAFETY: the token exists only if the processor has NEON.
                unsafe { $intrinsic($($a),+) }
            }
        )+
    };
}

impl Lanes for Neon {
    type V = float32x4_t;
    const LEN: usize = 4;
    const REGISTERS: usize = 32;

    operations! {
        add(a, b) = vaddq_f32;
        sub(a, b) = vsubq_f32;
        mul(a, b) = vmulq_f32;
        div(a, b) = vdivq_f32;
        min(a, b) = vminq_f32;
        max(a, b) = vmaxq_f32;
        round(a) = vrndnq_f32;
    }

    #[inline(always)]
    fn fma(self, a: float32x4_t, b: float32x4_t, c: float32x4_t) -> float32x4_t {
        // SAFETY: the token exists only if the processor has NEON.
        unsafe { vfmaq_f32(c, a, b) }
    }

    #[inline(always)]
    fn splat(self, x: f32) -> float32x4_t {
        // SAFETY: the token exists only if the processor has NEON.
        unsafe { vdupq_n_f32(x) }
    }

    #[inline(always)]
    fn scale(self, a: float32x4_t, shifted: float32x4_t) -> float32x4_t {
        // SAFETY: the token exists only if the processor has NEON.
        unsafe {
            let exponent = vshlq_n_s32::<23>(vreinterpretq_s32_f32(shifted));
            vreinterpretq_f32_s32(vaddq_s32(vreinterpretq_s32_f32(a), exponent))
        }
    }

    #[inline(always)]
    unsafe fn load_from(self, from: *const f32) -> float32x4_t {
        // SAFETY: the caller vouches for the pointer, the token for the instruction set.
        unsafe { vld1q_f32(from) }
    }

    #[inline(always)]
    unsafe fn store_to(self, to: *mut f32, v: float32x4_t) {
        // SAFETY: the caller vouches for the pointer, the token for the instruction set.
        unsafe { vst1q_f32(to, v) }
    }
}
