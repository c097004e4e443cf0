//! Colours that all readers can distinguish, regardless of colour blindness or printer.
//!
//! The named colours come from the palette of Okabe and Ito, which suits all kinds of colour blindness. Ramps
//! are straight lines in Oklab, so equal steps look equal.

use std::fmt;

/// A colour in sRGB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Colour(pub [u8; 3]);

/// Paper.
pub const WHITE: Colour = Colour([255, 255, 255]);
/// Text and outlines.
pub const INK: Colour = Colour([34, 34, 34]);
/// Frames, ticks and secondary text.
pub const GREY: Colour = Colour([110, 110, 110]);
/// Grid lines, and agents without a forecast.
pub const PALE: Colour = Colour([200, 203, 207]);
/// Orange: observed history.
pub const ORANGE: Colour = Colour([230, 159, 0]);
/// Blue: the observed future.
pub const BLUE: Colour = Colour([0, 114, 178]);
/// Vermilion: the single best forecast.
pub const VERMILION: Colour = Colour([213, 94, 0]);
/// Sky blue.
pub const SKY: Colour = Colour([86, 180, 233]);
/// Reddish purple: the most probable mode.
pub const PURPLE: Colour = Colour([160, 70, 130]);
/// Bluish green: the forecast distribution.
pub const GREEN: Colour = Colour([0, 158, 115]);
/// Colours of the curves of one panel, in the order of their use.
pub const CURVES: [Colour; 8] =
    [BLUE, VERMILION, GREEN, Colour([204, 121, 167]), ORANGE, SKY, INK, Colour([150, 140, 20])];

impl fmt::Display for Colour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [r, g, b] = self.0;
        write!(f, "#{r:02x}{g:02x}{b:02x}")
    }
}

/// The colour at `share` of the way from `from` to `to`, perceptually even.
pub fn mixed(from: Colour, to: Colour, share: f64) -> Colour {
    let (a, b) = (oklab(from), oklab(to));
    srgb([0, 1, 2].map(|axis| a[axis] + (b[axis] - a[axis]) * share))
}

/// Lightness and the two opponent axes of a colour.
fn oklab(colour: Colour) -> [f64; 3] {
    let [r, g, b] = colour.0.map(|channel| {
        let value = f64::from(channel) / 255.0;
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    });
    let l = (0.412_221_470_8 * r + 0.536_332_536_3 * g + 0.051_445_992_9 * b).cbrt();
    let m = (0.211_903_498_2 * r + 0.680_699_545_1 * g + 0.107_396_956_6 * b).cbrt();
    let s = (0.088_302_461_9 * r + 0.281_718_837_6 * g + 0.629_978_700_5 * b).cbrt();
    [
        0.210_454_255_3 * l + 0.793_617_785_0 * m - 0.004_072_046_8 * s,
        1.977_998_495_1 * l - 2.428_592_205_0 * m + 0.450_593_709_9 * s,
        0.025_904_037_1 * l + 0.782_771_766_2 * m - 0.808_675_766_0 * s,
    ]
}

fn srgb([lightness, a, b]: [f64; 3]) -> Colour {
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    let linear = [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ];
    Colour(linear.map(|value| {
        let value = if value <= 0.003_130_8 { value * 12.92 } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
        (value.clamp(0.0, 1.0) * 255.0).round() as u8
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_meets_its_ends_and_darkens_all_the_way() {
        let at = |share| mixed(WHITE, BLUE, share);
        assert_eq!((at(0.0), at(1.0)), (WHITE, BLUE));
        let lightness: Vec<f64> = (0..=10).map(|step| oklab(at(f64::from(step) / 10.0))[0]).collect();
        let steps: Vec<f64> = lightness.windows(2).map(|pair| pair[0] - pair[1]).collect();
        let mean = steps.iter().sum::<f64>() / steps.len() as f64;
        assert!(steps.iter().all(|step| (step - mean).abs() < 0.1 * mean), "uneven steps {steps:?}");
    }

    #[test]
    fn colours_are_written_as_svg_wants_them() {
        assert_eq!(ORANGE.to_string(), "#e69f00");
    }
}
