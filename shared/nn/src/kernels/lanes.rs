#![expect(unsafe_code, reason = "vector loads and stores")]

/// 1.5 · 2^23: added to a number of less than 2^22 it leaves the nearest whole number, in the lowest bits.
pub(super) const SHIFT: f32 = 12_582_912.0;

/// The operations of one instruction set on vectors of `LEN` floats, as a token: code that holds one may use
/// the set.
///
/// All methods are `#[inline(always)]`, see [`super::Kernel`].
pub trait Lanes: Copy {
    /// A vector.
    type V: Copy;
    /// Its floats; divides 16.
    const LEN: usize;
    /// Vector registers of the set.
    const REGISTERS: usize;
    /// Steps of a chain of multiply-adds in a pass of the product's loop: more than 1 where that was measured to
    /// be faster. On Intel's processors counting and finding the rows share execution ports with multiply-adds.
    const STEPS: usize = 1;

    /// All lanes x.
    fn splat(self, x: f32) -> Self::V;
    /// a + b.
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    /// a − b.
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    /// a · b.
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// a / b.
    fn div(self, a: Self::V, b: Self::V) -> Self::V;
    /// The lesser of each lane.
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    /// The greater of each lane.
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// a · b + c, with one rounding where the set can.
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// The nearest whole number.
    fn round(self, a: Self::V) -> Self::V;
    /// a · 2^n for the n of `shifted` = 1.5 · 2^23 + n, where a and the result are normal numbers.
    fn scale(self, a: Self::V, shifted: Self::V) -> Self::V;

    /// The `LEN` floats from `from` on.
    ///
    /// # Safety
    /// `from` is good for reading `LEN` floats.
    unsafe fn load_from(self, from: *const f32) -> Self::V;
    /// Writes `LEN` floats from `to` on.
    ///
    /// # Safety
    /// `to` is good for writing `LEN` floats.
    unsafe fn store_to(self, to: *mut f32, v: Self::V);

    /// The first `LEN` floats of a slice.
    #[inline(always)]
    fn load(self, from: &[f32]) -> Self::V {
        assert!(from.len() >= Self::LEN);
        // SAFETY: the slice is long enough.
        unsafe { self.load_from(from.as_ptr()) }
    }

    /// Sets the first `LEN` floats of a slice.
    #[inline(always)]
    fn store(self, to: &mut [f32], v: Self::V) {
        assert!(to.len() >= Self::LEN);
        // SAFETY: the slice is long enough.
        unsafe { self.store_to(to.as_mut_ptr(), v) }
    }
}
