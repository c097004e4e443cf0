//! Numbers of 16 bits as bits.

/// The value of a number in IEEE half precision. It is exact.
pub(crate) fn from_f16(bits: u16) -> f32 {
    /// The unit of the smallest numbers, 2⁻²⁴.
    const UNIT: f32 = 5.960_464_5e-8;
    let (exponent, fraction) = (u32::from(bits >> 10 & 0x1F), u32::from(bits & 0x3FF));
    let magnitude = match exponent {
        0 => fraction as f32 * UNIT,
        0x1F => f32::from_bits(0x7F80_0000 | fraction << 13),
        _ => f32::from_bits((exponent + 112) << 23 | fraction << 13),
    };
    if bits >> 15 == 0 { magnitude } else { -magnitude }
}

/// The upper half of a number, rounded to nearest, ties to even.
pub(crate) fn to_bf16(value: f32) -> u16 {
    let bits = value.to_bits();
    // A NaN stays one even if only its lower bits are set.
    let rounded = if value.is_nan() { bits | 0x40_0000 } else { bits + 0x7FFF + (bits >> 16 & 1) };
    (rounded >> 16) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_half_has_its_value() {
        for bits in 0..=u16::MAX {
            let (found, expected) = (from_f16(bits), half::f16::from_bits(bits).to_f32());
            assert!(
                found.to_bits() == expected.to_bits() || found.is_nan() && expected.is_nan(),
                "{bits:#x}"
            );
        }
    }

    #[test]
    fn upper_halves_are_rounded_to_nearest_even() {
        for upper in (0..=u16::MAX).step_by(3) {
            for lower in [0_u32, 1, 0x7FFF, 0x8000, 0x8001, 0xFFFF] {
                let value = f32::from_bits(u32::from(upper) << 16 | lower);
                assert_eq!(to_bf16(value), half::bf16::from_f32(value).to_bits(), "{value}");
            }
        }
    }
}
