//! A sheet of paper, written as SVG.

use std::fmt::Write as _;

use super::colour::{Colour, WHITE};
use super::path::{Path, Spot, append_number};
use super::text::{self, Face};

/// A rectangle on the sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Upper left corner.
    pub corner: Spot,
    /// Width and height.
    pub size: [f64; 2],
}

impl Frame {
    /// Horizontal middle.
    pub fn centre_x(&self) -> f64 {
        self.corner[0] + self.size[0] / 2.0
    }

    /// Right edge.
    pub fn right(&self) -> f64 {
        self.corner[0] + self.size[0]
    }

    /// Lower edge.
    pub fn bottom(&self) -> f64 {
        self.corner[1] + self.size[1]
    }
}

/// The look of a line.
#[derive(Clone, Copy, Debug)]
pub struct Stroke {
    /// The colour.
    pub colour: Colour,
    /// The width, pt.
    pub width: f64,
    /// Lengths of dashes and gaps, pt. The line is solid if this is empty.
    pub dashes: &'static [f64],
    /// From 0 (invisible) to 1.
    pub opacity: f64,
}

impl Stroke {
    /// A solid, opaque line.
    pub const fn solid(colour: Colour, width: f64) -> Self {
        Self { colour, width, dashes: &[], opacity: 1.0 }
    }

    /// The same line, dashed.
    pub const fn dashed(self, dashes: &'static [f64]) -> Self {
        Self { dashes, ..self }
    }

    /// The same line, less opaque.
    pub const fn faint(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }
}

/// The position of a text relative to its spot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    /// The text begins at the spot.
    Left,
    /// The middle of the text is at the spot.
    Middle,
    /// The text ends at the spot.
    Right,
}

/// The look of a text.
#[derive(Clone, Copy, Debug)]
pub struct Type {
    /// Height of the font, pt.
    pub size: f64,
    /// The font.
    pub face: Face,
    /// The colour.
    pub colour: Colour,
    /// The position of the text relative to its spot.
    pub align: Align,
}

/// The sheet.
#[derive(Debug)]
pub struct Canvas {
    size: [f64; 2],
    body: String,
    clip_count: usize,
}

impl Canvas {
    /// An empty sheet.
    pub const fn new(size: [f64; 2]) -> Self {
        Self { size, body: String::new(), clip_count: 0 }
    }

    /// Fills an area with the even-odd rule: points inside an even number of outlines stay empty.
    pub fn fill(&mut self, path: &Path, colour: Colour, opacity: f64) {
        if path.is_empty() {
            return;
        }
        write!(self.body, r#"<path d="{}" fill="{colour}" fill-rule="evenodd""#, path.0).expect(INFALLIBLE);
        self.number_unless("fill-opacity", opacity, 1.0);
        self.body.push_str("/>\n");
    }

    /// Draws a line.
    pub fn stroke(&mut self, path: &Path, stroke: &Stroke) {
        if path.is_empty() {
            return;
        }
        write!(self.body, r#"<path d="{}" fill="none" stroke="{}""#, path.0, stroke.colour)
            .expect(INFALLIBLE);
        self.number_unless("stroke-width", stroke.width, 1.0);
        self.number_unless("stroke-opacity", stroke.opacity, 1.0);
        if stroke.dashes.is_empty() {
            self.body.push_str(r#" stroke-linecap="round""#);
        } else {
            self.body.push_str(r#" stroke-dasharray=""#);
            for dash in stroke.dashes {
                append_number(&mut self.body, *dash);
                self.body.push(' ');
            }
            self.body.push('"');
        }
        self.body.push_str(" stroke-linejoin=\"round\"/>\n");
    }

    /// Fills a rectangle.
    pub fn fill_frame(&mut self, frame: Frame, colour: Colour) {
        self.fill(&rectangle(frame), colour, 1.0);
    }

    /// Draws the edge of a rectangle.
    pub fn stroke_frame(&mut self, frame: Frame, stroke: &Stroke) {
        self.stroke(&rectangle(frame), stroke);
    }

    /// Writes a line of text with its baseline through a spot, and returns the width of the text.
    pub fn text(&mut self, [x, y]: Spot, look: Type, words: &str) -> f64 {
        let width = text::width(look.face, look.size, words);
        let before = match look.align {
            Align::Left => 0.0,
            Align::Middle => width / 2.0,
            Align::Right => width,
        };
        let outline = text::outline(look.face, look.size, words, [x - before, y]);
        if !outline.is_empty() {
            let (label, colour) = (escaped(words), look.colour);
            writeln!(
                self.body,
                r#"<path role="img" aria-label="{label}" d="{}" fill="{colour}"/>"#,
                outline.0
            )
            .expect(INFALLIBLE);
        }
        width
    }

    /// Like [`Canvas::text`], but shrinks the text to `width_max`, to no less than three quarters of its
    /// size. A text that is still too wide is truncated.
    pub fn fitted_text(&mut self, spot: Spot, look: Type, words: &str, width_max: f64) -> f64 {
        let width = |words: &str, size: f64| text::width(look.face, size, words);
        let size = look.size * (width_max / width(words, look.size).max(1e-9)).clamp(0.75, 1.0);
        let look = Type { size, ..look };
        if width(words, size) <= width_max + 1e-6 {
            return self.text(spot, look, words);
        }
        let starts = words.char_indices().map(|(end, _)| format!("{}…", &words[..end]));
        let longest = starts.take_while(|start| width(start, size) <= width_max).last();
        self.text(spot, look, &longest.unwrap_or_default())
    }

    /// Clips everything that `draw` draws to `frame`.
    pub fn clipped(&mut self, frame: Frame, draw: impl FnOnce(&mut Self)) {
        let (id, outline) = (self.clip_count, rectangle(frame).0);
        self.clip_count += 1;
        writeln!(
            self.body,
            r##"<clipPath id="clip{id}"><path d="{outline}"/></clipPath><g clip-path="url(#clip{id})">"##
        )
        .expect(INFALLIBLE);
        draw(self);
        self.body.push_str("</g>\n");
    }

    /// Makes everything that `draw` draws transparent as a whole, so overlaps are not darker.
    pub fn faint(&mut self, opacity: f64, draw: impl FnOnce(&mut Self)) {
        writeln!(self.body, r#"<g opacity="{}">"#, number(opacity)).expect(INFALLIBLE);
        draw(self);
        self.body.push_str("</g>\n");
    }

    /// The sheet as SVG on white paper.
    pub fn finish(self, title: &str) -> String {
        let [width, height] = self.size.map(number);
        let (title, body) = (escaped(title), self.body);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}pt\" height=\"{height}pt\" \
             viewBox=\"0 0 {width} {height}\">\n<title>{title}</title>\n\
             <path d=\"M0 0H{width}V{height}H0Z\" fill=\"{WHITE}\"/>\n{body}</svg>\n"
        )
    }

    fn number_unless(&mut self, name: &str, value: f64, default: f64) {
        if value != default {
            write!(self.body, r#" {name}="{}""#, number(value)).expect(INFALLIBLE);
        }
    }
}

const INFALLIBLE: &str = "writing to a string does not fail";

fn rectangle(frame: Frame) -> Path {
    let ([x, y], right, bottom) = (frame.corner, frame.right(), frame.bottom());
    Path::polygon([[x, y], [right, y], [right, bottom], [x, bottom]])
}

fn number(value: f64) -> String {
    let mut text = String::new();
    append_number(&mut text, value);
    text
}

/// Escapes a text for XML. Characters that XML cannot represent become spaces.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\u{fffe}' | '\u{ffff}' => out.push(' '),
            control if control.is_control() => out.push(' '),
            other => out.push(other),
        }
    }
    out
}
