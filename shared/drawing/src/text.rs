//! Text as outlines of an embedded font.

use std::sync::LazyLock;

use ttf_parser::gpos::{PairAdjustment, PositioningSubtable};
use ttf_parser::{Face as Font, GlyphId, OutlineBuilder};

use super::path::{Path, Spot};

/// A weight of the font.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Face {
    /// For everything except titles.
    Regular,
    /// For titles.
    Medium,
}

static REGULAR: LazyLock<Font<'static>> = LazyLock::new(|| font(include_bytes!("font/Roboto-Regular.ttf")));
static MEDIUM: LazyLock<Font<'static>> = LazyLock::new(|| font(include_bytes!("font/Roboto-Medium.ttf")));

fn font(bytes: &'static [u8]) -> Font<'static> {
    Font::parse(bytes, 0).expect("the embedded font is one")
}

impl Face {
    fn font(self) -> &'static Font<'static> {
        match self {
            Self::Regular => &REGULAR,
            Self::Medium => &MEDIUM,
        }
    }
}

/// Width of a line of text, in the unit of `size`.
pub fn width(face: Face, size: f64, words: &str) -> f64 {
    glyphs(face.font(), size, words).last().map_or(0.0, |(_, end)| end)
}

/// Outline of a line of text that starts at a spot.
pub fn outline(face: Face, size: f64, words: &str, [x, y]: Spot) -> Path {
    let font = face.font();
    let scale = size / f64::from(font.units_per_em());
    let mut path = Path::default();
    let mut start = x;
    for (glyph, end) in glyphs(font, size, words) {
        font.outline_glyph(glyph, &mut Pen { path: &mut path, start: [start, y], scale });
        start = x + end;
    }
    path
}

/// Glyphs of a text, each with the position of its end along the baseline. Characters that the font lacks
/// appear as the font's box.
fn glyphs(font: &'static Font<'static>, size: f64, words: &str) -> impl Iterator<Item = (GlyphId, f64)> {
    let scale = size / f64::from(font.units_per_em());
    let ids: Vec<GlyphId> =
        words.chars().map(|character| font.glyph_index(character).unwrap_or(GlyphId(0))).collect();
    let next: Vec<Option<GlyphId>> = ids.iter().skip(1).copied().map(Some).chain([None]).collect();
    ids.into_iter().zip(next).scan(0.0, move |end, (glyph, next)| {
        let advance = f64::from(font.glyph_hor_advance(glyph).unwrap_or(0));
        *end += (advance + next.map_or(0.0, |next| kerning(font, glyph, next))) * scale;
        Some((glyph, *end))
    })
}

/// The distance by which the second glyph moves towards the first, in font units. Kerning is the only
/// positioning in the embedded font, so every lookup counts.
fn kerning(font: &Font<'_>, first: GlyphId, second: GlyphId) -> f64 {
    let Some(table) = font.tables().gpos else { return 0.0 };
    let pairs = table.lookups.into_iter().flat_map(|lookup| lookup.subtables.into_iter());
    pairs
        .filter_map(|subtable| match subtable {
            PositioningSubtable::Pair(PairAdjustment::Format1 { coverage, sets }) => {
                sets.get(coverage.get(first)?)?.get(second)
            }
            PositioningSubtable::Pair(PairAdjustment::Format2 { coverage, classes, matrix }) => {
                coverage.get(first)?;
                matrix.get((classes.0.get(first), classes.1.get(second)))
            }
            _ => None,
        })
        .map(|(value, _)| f64::from(value.x_advance))
        .next()
        .unwrap_or(0.0)
}

/// Draws a glyph in font units, y upwards, onto the path.
struct Pen<'a> {
    path: &'a mut Path,
    start: Spot,
    scale: f64,
}

impl Pen<'_> {
    fn spot(&self, x: f32, y: f32) -> Spot {
        [self.start[0] + f64::from(x) * self.scale, self.start[1] - f64::from(y) * self.scale]
    }
}

impl OutlineBuilder for Pen<'_> {
    fn move_to(&mut self, x: f32, y: f32) {
        self.path.move_to(self.spot(x, y));
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.path.line_to(self.spot(x, y));
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.path.quad_to(self.spot(x1, y1), self.spot(x, y));
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.path.cubic_to([self.spot(x1, y1), self.spot(x2, y2)], self.spot(x, y));
    }

    fn close(&mut self) {
        self.path.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_add_up_but_for_kerning() {
        let of = |words| width(Face::Regular, 10.0, words);
        assert_eq!(of(""), 0.0);
        assert!((of("mm") - 2.0 * of("m")).abs() < 1e-9);
        assert!(of("AV") < of("A") + of("V"), "a kerned pair is narrower than its glyphs");
        assert!(of("W") > of("i"));
    }

    #[test]
    fn every_character_that_labels_use_is_in_the_font() {
        for face in [Face::Regular, Face::Medium] {
            for character in "abcxyzABCXYZ0123456789 .,:;()[]%°²·×–−…Δσμ≤/".chars() {
                assert!(face.font().glyph_index(character).is_some(), "{character:?} is missing");
            }
        }
    }
}
