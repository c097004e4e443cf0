#![expect(unsafe_code, reason = "the trait's loads and stores take pointers")]

use super::lanes::{Kernel, Lanes};

/// Plain Rust on four floats, which compilers translate to the target's base instruction set.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

pub(super) fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Portable)
}

macro_rules! operations {
    ($($name:ident($($a:ident),+) = $value:expr;)+) => {
        $(
            #[inline(always)]
            fn $name(self, $($a: [f32; 4]),+) -> [f32; 4] {
                let mut out = [0.0; 4];
                for (i, out) in out.iter_mut().enumerate() {
                    $(let $a = $a[i];)+
                    *out = $value;
                }
                out
            }
        )+
    };
}

impl Lanes for Portable {
    type V = [f32; 4];
    const LEN: usize = 4;
    const REGISTERS: usize = 16;

    operations! {
        add(a, b) = a + b;
        sub(a, b) = a - b;
        mul(a, b) = a * b;
        div(a, b) = a / b;
        min(a, b) = if a < b { a } else { b };
        max(a, b) = if a > b { a } else { b };
        // Two roundings: without the instruction, `mul_add` is a slow library call.
        fma(a, b, c) = a * b + c;
        round(a) = a.round_ties_even();
        scale(a, shifted) = f32::from_bits(a.to_bits().wrapping_add(shifted.to_bits() << 23));
    }

    #[inline(always)]
    fn splat(self, x: f32) -> [f32; 4] {
        [x; 4]
    }

    #[inline(always)]
    unsafe fn load_from(self, from: *const f32) -> [f32; 4] {
        // SAFETY: the caller vouches for the pointer; an array of f32 has the alignment of f32.
        unsafe { *from.cast::<[f32; 4]>() }
    }

    #[inline(always)]
    unsafe fn store_to(self, to: *mut f32, v: [f32; 4]) {
        // SAFETY: as above.
        unsafe { *to.cast::<[f32; 4]>() = v }
    }
}
