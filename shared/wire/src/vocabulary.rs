//! The look of forecasts: one table of words, colours, dashes and shapes for every display.
//!
//! Each [`Cause`] has a colour in both themes, a dash and a shape, so that nobody needs the colour. A test keeps
//! the colours apart for people with a red, green or blue deficiency.

use std::borrow::Cow;

use crate::{Cause, Quality};

/// A colour: red, green and blue.
pub type Rgb = [u8; 3];

/// The look of the forecasts of a cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    /// The cause.
    pub cause: Cause,
    /// A few words for legends.
    pub words: &'static str,
    /// A sentence for a first reader. `{agents}` stands for the agents' type in the plural, and `{share}` for the
    /// share of constant velocity in parentheses, or nothing.
    pub explanation: &'static str,
    /// Whether such forecasts are part of normal work.
    pub is_normal: bool,
    /// The colour on a light ground.
    pub light: Rgb,
    /// The colour on a dark ground.
    pub dark: Rgb,
    /// Lengths of dashes and gaps in pixels; empty for a solid line.
    pub dash: &'static [u8],
    /// The shape at the end of a forecast: `disc`, `square`, `ring`, `triangle`, `cross`, `diamond` or `plus`.
    pub shape: &'static str,
}

/// The colours of what has no forecast, or a cause of a newer version: light and dark.
pub const UNKNOWN: [Rgb; 2] = [[0x8a, 0x94, 0xa0], [0x8a, 0x97, 0xa5]];

/// The table, in the order of the causes' numbers.
pub const LOOKS: [Look; Cause::ALL.len()] = [
    Look {
        cause: Cause::None,
        words: "learned",
        explanation: "The network and its experts made this forecast: normal",
        is_normal: true,
        light: [0x0b, 0x6b, 0xcb],
        dark: [0x58, 0xa9, 0xff],
        dash: &[],
        shape: "disc",
    },
    Look {
        cause: Cause::Late,
        words: "late",
        explanation: "The network's controls came after the deadline of this tick",
        is_normal: false,
        light: [0xdb, 0x45, 0x20],
        dark: [0xff, 0x6f, 0x4d],
        dash: &[10, 4],
        shape: "triangle",
    },
    Look {
        cause: Cause::Rejected,
        words: "rejected",
        explanation: "The network's controls were refused: not finite, or impossible",
        is_normal: false,
        light: [0xb0, 0x3a, 0x9a],
        dark: [0xf0, 0x8f, 0xd6],
        dash: &[2, 3],
        shape: "cross",
    },
    Look {
        cause: Cause::Missing,
        words: "missing",
        explanation: "The network's controls do not contain this track",
        is_normal: false,
        light: [0xd0, 0x8f, 0x00],
        dark: [0xf6, 0xbd, 0x3c],
        dash: &[6, 3, 2, 3],
        shape: "diamond",
    },
    Look {
        cause: Cause::Young,
        words: "too young",
        explanation: "The track's history is still too short for the network: normal",
        is_normal: true,
        light: [0x8d, 0x96, 0xa0],
        dark: [0x78, 0x84, 0x91],
        dash: &[3, 4],
        shape: "ring",
    },
    Look {
        cause: Cause::Outdone,
        words: "constant velocity",
        explanation: "Constant velocity was nearer for {agents} of this speed, so it has most of the weight{share}: normal",
        is_normal: true,
        light: [0x0d, 0x80, 0x6b],
        dark: [0x2f, 0xc4, 0xa4],
        dash: &[7, 4],
        shape: "square",
    },
    Look {
        cause: Cause::Shed,
        words: "left out to save time",
        explanation: "This tick had no time for all agents, and left this one out",
        is_normal: false,
        light: [0x4d, 0x3c, 0x12],
        dark: [0xd9, 0xd2, 0x9a],
        dash: &[12, 3, 2, 3],
        shape: "plus",
    },
];

/// The look of a cause by its number; `None` for a cause of a newer version.
#[must_use]
pub fn look(cause: u32) -> Option<&'static Look> {
    LOOKS.get(cause as usize)
}

/// A forecast in a few words, by its quality and the number of its cause: `kinematic: constant velocity`.
#[must_use]
pub fn described(quality: Quality, cause: u32) -> Cow<'static, str> {
    if quality == Quality::Learned || cause == Cause::None as u32 {
        return quality.name().into();
    }
    let words = look(cause).map_or_else(|| Cause::name_of(cause), |look| look.words.into());
    format!("{}: {words}", quality.name()).into()
}

/// A cause in a few words, by its name.
#[must_use]
pub fn words_of(name: &str) -> &str {
    LOOKS.iter().find(|look| look.cause.name() == name).map_or(name, |look| look.words)
}

#[cfg(test)]
mod tests {
    use super::*;

    type Matrix = [[f64; 3]; 3];

    /// Normal sight, then protanopia, deuteranopia and tritanopia on linear RGB, after Machado et al. (2009).
    const SIGHTS: [Matrix; 4] = [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [
            [0.152_286, 1.052_583, -0.204_868],
            [0.114_503, 0.786_281, 0.099_216],
            [-0.003_882, -0.048_116, 1.051_998],
        ],
        [
            [0.367_322, 0.860_646, -0.227_968],
            [0.280_085, 0.672_501, 0.047_413],
            [-0.011_820, 0.042_940, 0.968_881],
        ],
        [
            [1.255_528, -0.076_749, -0.178_779],
            [-0.078_411, 0.930_809, 0.147_602],
            [0.004_733, 0.691_367, 0.303_900],
        ],
    ];

    fn times(matrix: &Matrix, vector: [f64; 3]) -> [f64; 3] {
        matrix.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum())
    }

    /// A colour as CIE L*a*b*, as an eye of one of the [`SIGHTS`] receives it.
    fn lab(color: Rgb, sight: &Matrix) -> [f64; 3] {
        let linear = color.map(|value| {
            let value = f64::from(value) / 255.0;
            if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        });
        let seen = times(sight, linear).map(|value| value.clamp(0.0, 1.0));
        let xyz =
            times(&[[0.4339, 0.3762, 0.1899], [0.2126, 0.7152, 0.0722], [0.0178, 0.1098, 0.8729]], seen);
        let [x, y, z] = xyz.map(|v| if v > 0.008_856 { v.cbrt() } else { 7.787 * v + 16.0 / 116.0 });
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    #[test]
    fn causes_are_told_apart_without_full_colour_sight() {
        for (theme, color) in [("light", (|look| look.light) as fn(&Look) -> Rgb), ("dark", |look| look.dark)]
        {
            for (number, sight) in SIGHTS.iter().enumerate() {
                for (place, a) in LOOKS.iter().enumerate() {
                    for b in &LOOKS[place + 1..] {
                        let [from, to] = [color(a), color(b)].map(|color| lab(color, sight));
                        let apart = from.iter().zip(to).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
                        assert!(
                            apart > 13.0,
                            "{theme}, sight {number}: {:?} and {:?} are {apart:.1} apart",
                            a.cause,
                            b.cause
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn each_cause_has_its_own_dash_shape_and_words() {
        for (number, look) in LOOKS.iter().enumerate() {
            assert_eq!(look.cause as usize, number);
            let same = LOOKS.iter().filter(|other| {
                other.dash == look.dash || other.shape == look.shape || other.words == look.words
            });
            assert_eq!(same.count(), 1, "{:?}", look.cause);
        }
    }
}
