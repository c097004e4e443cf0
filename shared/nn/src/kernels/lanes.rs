#![expect(unsafe_code, reason = "vector loads and stores")]

/// 1.5 · 2^23: if it is added to a number below 2^22, the lowest bits contain the nearest integer.
pub(super) const SHIFT: f32 = 12_582_912.0;

/// The operations of one instruction set on vectors of `LEN` floats. The type is a token: code that holds one
/// may use the set.
///
/// All methods are `#[inline(always)]`; see [`Kernel`].
pub trait Lanes: Copy {
    /// A vector.
    type V: Copy;
    /// Number of floats; divides 16.
    const LEN: usize;
    /// Number of vector registers of the set.
    const REGISTERS: usize;
    /// Multiply-adds of a chain per pass of the product's loop: more than 1 if measurements showed it to be
    /// faster. On Intel processors counting and row addressing share execution ports with multiply-adds.
    const STEPS: usize = 1;

    /// A vector with x in all lanes.
    fn splat(self, x: f32) -> Self::V;
    /// a + b.
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    /// a − b.
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    /// a · b.
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// a / b.
    fn div(self, a: Self::V, b: Self::V) -> Self::V;
    /// The minimum of each lane.
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    /// The maximum of each lane.
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// a · b + c, with one rounding if the set supports it.
    fn fma(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// The nearest integer.
    fn round(self, a: Self::V) -> Self::V;
    /// a · 2^n for `shifted` = 1.5 · 2^23 + n, if a and the result are normal numbers.
    fn scale(self, a: Self::V, shifted: Self::V) -> Self::V;

    /// The `LEN` floats at `from`.
    ///
    /// # Safety
    /// `from` is valid for reading `LEN` floats.
    unsafe fn load_from(self, from: *const f32) -> Self::V;
    /// Writes `LEN` floats to `to`.
    ///
    /// # Safety
    /// `to` is valid for writing `LEN` floats.
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

/// A computation that is compiled once per instruction set. `run` must be `#[inline(always)]`, so that its
/// body is compiled in a function with the set's target features.
pub trait Kernel {
    /// The result.
    type Output;
    /// Runs the computation on `lanes`.
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}
