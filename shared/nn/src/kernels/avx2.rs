#![expect(unsafe_code, reason = "AVX2 intrinsics")]

use std::arch::x86_64::*;

use super::lanes::{Kernel, Lanes};

/// AVX2 with FMA; only [`run`] creates it.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

/// # Safety
/// The processor has AVX2 and FMA.
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Avx2(()))
}

macro_rules! operations {
    ($($name:ident($($a:ident),+) = $intrinsic:expr;)+) => {
        $(
            #[inline(always)]
            fn $name(self, $($a: __m256),+) -> __m256 {
                // SAFETY: the token exists only if the processor has AVX2 and FMA.
                unsafe { $intrinsic($($a),+) }
            }
        )+
    };
}

impl Lanes for Avx2 {
    type V = __m256;
    const LEN: usize = 8;
    const REGISTERS: usize = 16;
    const STEPS: usize = 4;

    operations! {
        add(a, b) = _mm256_add_ps;
        sub(a, b) = _mm256_sub_ps;
        mul(a, b) = _mm256_mul_ps;
        div(a, b) = _mm256_div_ps;
        min(a, b) = _mm256_min_ps;
        max(a, b) = _mm256_max_ps;
        fma(a, b, c) = _mm256_fmadd_ps;
        round(a) = _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>;
    }

    #[inline(always)]
    fn splat(self, x: f32) -> __m256 {
        // SAFETY: the token exists only if the processor has AVX2 and FMA.
        unsafe { _mm256_set1_ps(x) }
    }

    #[inline(always)]
    fn scale(self, a: __m256, shifted: __m256) -> __m256 {
        // SAFETY: the token exists only if the processor has AVX2 and FMA.
        unsafe {
            let exponent = _mm256_slli_epi32::<23>(_mm256_castps_si256(shifted));
            _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(a), exponent))
        }
    }

    #[inline(always)]
    unsafe fn load_from(self, from: *const f32) -> __m256 {
        // SAFETY: the caller vouches for the pointer, the token for the instruction set.
        unsafe { _mm256_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn store_to(self, to: *mut f32, v: __m256) {
        // SAFETY: the caller vouches for the pointer, the token for the instruction set.
        unsafe { _mm256_storeu_ps(to, v) }
    }
}
