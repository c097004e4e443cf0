//! Elementary functions with the same bits on every machine. The platform's library differs in the last bits
//! between instruction sets, but forecasts must not depend on the machine.
//!
//! This module omits functions that are already bit-identical in glibc on x86-64 with FMA and on 64-bit Arm.
//! These are square roots and, in double precision, sine, cosine, exponential and logarithm. `docs/arm.md`
//! describes the test.

/// Outside these bounds, a square could leave the range of normal numbers.
const SQUARE_RANGE: [f64; 2] = [1e-138, 1e153];
/// A power of two, so that scaling by it is exact.
const SCALE: f64 = 4.149_515_568_880_993e180;
/// 2^-54. Below this ratio, the smaller side is less than half a unit in the last place of the larger one.
const RATIO_MIN: f64 = 5.551_115_123_125_783e-17;

/// √(x² + y²), within one unit in the last place. Each product and sum is rounded separately, so an
/// instruction set with fused operations gives the same bits.
///
/// The error of the plain square root is estimated from the sides and subtracted. This is the variant without
/// fused operations of Borges, An improved algorithm for hypot(a, b), 2019.
#[must_use]
pub fn hypot(x: f64, y: f64) -> f64 {
    let (x, y) = (x.abs(), y.abs());
    if x.is_infinite() || y.is_infinite() {
        return f64::INFINITY;
    }
    let (long, short) = if x < y { (y, x) } else { (x, y) };
    if short <= long * RATIO_MIN || long.is_nan() || short.is_nan() {
        return long + short;
    }
    if long > SQUARE_RANGE[1] {
        return corrected(long / SCALE, short / SCALE) * SCALE;
    }
    if short < SQUARE_RANGE[0] {
        return corrected(long * SCALE, short * SCALE) / SCALE;
    }
    corrected(long, short)
}

/// The hypotenuse of sides whose squares are normal numbers.
fn corrected(long: f64, short: f64) -> f64 {
    let root = (long * long + short * short).sqrt();
    // root² − long² − short², grouped so that nearly equal terms cancel first.
    let excess = if root <= 2.0 * short {
        let rest = root - short;
        long * (2.0 * rest - long) + (rest - 2.0 * (long - short)) * rest
    } else {
        let rest = root - long;
        2.0 * rest * (long - 2.0 * short) + ((4.0 * rest - short) * short + rest * rest)
    };
    root - excess / (2.0 * root)
}
