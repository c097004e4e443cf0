//! The hypotenuse has the same bits on every machine.

use kinematics::hypot;

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
