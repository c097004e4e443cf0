//! Elementary functions with the same bits on every machine. The platform's library differs in the last bits
//! between instruction sets, but forecasts must not depend on the machine.
//!
//! This crate omits functions that are already bit-identical in glibc on x86-64 with FMA and on 64-bit Arm.
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

#[cfg(test)]
mod tests {
    use super::hypot;

    /// Numbers between −1 and 1, the same in every run.
    fn numbers(len: usize) -> impl Iterator<Item = f64> {
        let mut state = 7_u64;
        std::iter::repeat_with(move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        })
        .take(len)
    }

    #[test]
    fn whole_sides_are_exact() {
        for [x, y, expected] in [[3.0, 4.0, 5.0], [-5.0, 12.0, 13.0], [0.0, -2.0, 2.0], [0.0, 0.0, 0.0]] {
            assert_eq!((hypot(x, y), hypot(y, x)), (expected, expected));
        }
        for scale in [2.0_f64.powi(-1040), 2.0_f64.powi(-500), 2.0_f64.powi(500), 2.0_f64.powi(1000)] {
            assert_eq!(hypot(3.0 * scale, 4.0 * scale), 5.0 * scale);
        }
    }

    #[test]
    fn it_is_the_platforms_own_to_a_unit_in_the_last_place() {
        let sides: Vec<f64> = numbers(20_000).collect();
        for (i, pair) in sides.windows(2).enumerate() {
            let scale = [1.0, 1e3, 1e-6, 1e9, 1e200, 1e-200][i % 6];
            let (x, y) = (pair[0] * scale, pair[1]);
            let (found, expected) = (hypot(x, y), x.hypot(y));
            assert!(found.to_bits().abs_diff(expected.to_bits()) <= 1, "{x} {y}: {found}, not {expected}");
        }
    }

    #[test]
    fn its_bits_are_the_same_everywhere() {
        let sides: Vec<f64> = numbers(10_001).map(|side| 90.0 * side).collect();
        let bits = sides.windows(2).map(|pair| hypot(pair[0], pair[1]).to_bits());
        let hash =
            bits.fold(0xCBF2_9CE4_8422_2325_u64, |hash, bits| (hash ^ bits).wrapping_mul(0x0100_0000_01B3));
        assert_eq!(hash, 0x9D87_4246_A335_7613, "{hash:#x}");
    }

    #[test]
    fn what_is_not_finite_stays_so() {
        assert_eq!(
            (hypot(f64::INFINITY, f64::NAN), hypot(1.0, f64::NEG_INFINITY)),
            (f64::INFINITY, f64::INFINITY)
        );
        assert!(hypot(f64::NAN, 1.0).is_nan() && hypot(0.0, f64::NAN).is_nan());
    }
}
