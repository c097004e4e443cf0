//! Lines and columns of text files, with their positions for errors.

use std::ops::RangeInclusive;

use wire::{POSITION_MAX_M, SPEED_MAX_MPS, WorldOrigin};

use crate::{FrameRate, Input, ReadError};

/// Maximum length of a text that an error quotes.
const SHOWN_MAX: usize = 60;
/// Largest frame number: a century of recording fits at 2.5 frames a second.
const FRAME_MAX: i64 = 10_000_000_000;
/// Latest time of a frame, the same as that of a stamp in our own format.
pub(crate) const STAMP_MAX_NS: i64 = 4_000_000_000_000_000_000;
/// Largest integer below which every integer is an f64.
const INTEGER_MAX: f64 = 9_007_199_254_740_992.0;

/// The separator of the columns of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Separator {
    /// One comma. Spaces around a value are ignored.
    Comma,
    /// One semicolon. Spaces around a value are ignored.
    Semicolon,
    /// One tab. Spaces around a value are ignored.
    Tab,
    /// Any sequence of spaces and tabs.
    Space,
}

impl Separator {
    /// The single character between two values; `None` if there may be several.
    const fn mark(self) -> Option<char> {
        match self {
            Self::Comma => Some(','),
            Self::Semicolon => Some(';'),
            Self::Tab => Some('\t'),
            Self::Space => None,
        }
    }
}

/// A line of a file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line<'a> {
    pub path: &'a str,
    /// Line number, from 1.
    pub number: usize,
    pub text: &'a str,
    /// The world frame's origin in the file's own frame.
    pub origin: WorldOrigin,
}

/// A value in a row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Field<'a> {
    line: Line<'a>,
    pub(crate) name: &'static str,
    /// Position in bytes, from 1.
    column: usize,
    pub text: &'a str,
}

/// The lines of a file that are not blank.
pub(crate) fn lines(input: &Input) -> impl Iterator<Item = Result<Line<'_>, ReadError>> {
    let content = input.bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&input.bytes);
    content.split(|&byte| byte == b'\n').enumerate().filter_map(|(index, bytes)| {
        let number = index + 1;
        match str::from_utf8(bytes) {
            Ok(text) if text.trim().is_empty() => None,
            Ok(text) => {
                // Tabs at the end are empty columns.
                let text = text.trim_end_matches(|c: char| c.is_whitespace() && c != '\t');
                Some(Ok(Line { path: &input.path, number, text, origin: input.origin }))
            }
            Err(error) => {
                let byte = error.valid_up_to() + 1;
                let problem = format!("not text: byte {byte} of the line is not UTF-8");
                Some(Err(ReadError::Line { path: input.path.clone(), line: number, problem }))
            }
        }
    })
}

/// The lines below the first, which must name exactly these columns.
pub(crate) fn lines_below<'a>(
    input: &'a Input,
    names: &[&str],
) -> impl Iterator<Item = Result<Line<'a>, ReadError>> {
    lines(input).enumerate().filter_map(move |(index, line)| match line {
        Ok(line) if index == 0 && line.is_header_of(names) => None,
        Ok(line) if index == 0 => {
            let expected = format!("expected \"{}\"", names.join(","));
            Some(Err(line.field("header", 1, line.text).error(expected)))
        }
        line => Some(line),
    })
}

/// The indices of some columns in a file whose header contains them among others.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Columns<const N: usize> {
    names: &'static [&'static str; N],
    places: [usize; N],
    len: usize,
}

impl<const N: usize> Columns<N> {
    /// Finds these columns in a comma-separated header.
    pub fn of_header(line: &Line<'_>, names: &'static [&'static str; N]) -> Result<Self, ReadError> {
        let mut places = [0; N];
        for (place, name) in places.iter_mut().zip(names) {
            let found = line.pieces(Separator::Comma).position(|(_, column)| column == *name);
            *place = found
                .ok_or_else(|| line.field("header", 1, line.text).error(format!("needs a column {name}")))?;
        }
        Ok(Self { names, places, len: line.pieces(Separator::Comma).count() })
    }

    /// The values of a row in the order of the names.
    pub fn fields<'a>(&self, line: &Line<'a>) -> Result<[Field<'a>; N], ReadError> {
        let mut fields = self.names.map(|name| line.field(name, 1, ""));
        let mut found = 0;
        for (column, text) in line.pieces(Separator::Comma) {
            for (field, _) in fields.iter_mut().zip(&self.places).filter(|(_, place)| **place == found) {
                *field = line.field(field.name, column, text);
            }
            found += 1;
        }
        if found == self.len { Ok(fields) } else { Err(line.columns_error(found, self.len)) }
    }
}

impl<'a> Line<'a> {
    /// Whether the line names exactly these columns, with commas between them.
    pub fn is_header_of(&self, names: &[&str]) -> bool {
        self.text.trim() == names.join(",")
    }

    /// The values of a row with the given columns.
    pub fn split<const N: usize>(
        &self,
        separator: Separator,
        names: &[&'static str; N],
    ) -> Result<[Field<'a>; N], ReadError> {
        let mut fields = [Field { line: *self, name: "", column: 1, text: "" }; N];
        let mut found = 0;
        for (column, text) in self.pieces(separator) {
            if let (Some(field), Some(name)) = (fields.get_mut(found), names.get(found)) {
                *field = Field { line: *self, name, column, text };
            }
            found += 1;
        }
        if found == N { Ok(fields) } else { Err(self.columns_error(found, N)) }
    }

    /// Each value with its position in bytes from 1.
    pub fn pieces(&self, separator: Separator) -> impl Iterator<Item = (usize, &'a str)> {
        let text = self.text;
        let place = move |piece: &str| piece.as_ptr().addr() - text.as_ptr().addr() + 1;
        let mut by_mark = separator.mark().map(|mark| text.split(mark));
        let mut by_space = (separator == Separator::Space).then(|| text.split_whitespace());
        std::iter::from_fn(move || match &mut by_mark {
            Some(pieces) => pieces.next().map(str::trim),
            None => by_space.as_mut()?.next(),
        })
        .map(move |piece| (place(piece), piece))
    }

    /// A value of this line under this column name.
    pub fn field(&self, name: &'static str, column: usize, text: &'a str) -> Field<'a> {
        Field { line: *self, name, column, text }
    }

    /// The error of a row with the wrong number of columns.
    pub fn columns_error(&self, found: usize, expected: usize) -> ReadError {
        ReadError::Columns {
            path: self.path.to_owned(),
            line: self.number,
            found,
            expected,
            text: shown(self.text),
        }
    }
}

impl<'a> Field<'a> {
    /// An error about this value.
    pub fn error(&self, problem: impl Into<String>) -> ReadError {
        ReadError::Value {
            path: self.line.path.to_owned(),
            line: self.line.number,
            column: self.column,
            field: self.name,
            value: shown(self.text),
            problem: problem.into(),
        }
    }

    /// A finite number.
    pub fn number(&self) -> Result<f64, ReadError> {
        let value: f64 = self.text.parse().map_err(|_| self.error("not a number"))?;
        if value.is_finite() { Ok(value) } else { Err(self.error("not finite")) }
    }

    /// A finite number within limits.
    pub fn number_in(&self, range: RangeInclusive<f64>) -> Result<f64, ReadError> {
        let value = self.number()?;
        if range.contains(&value) {
            return Ok(value);
        }
        Err(self.error(format!("expected {} to {}", range.start(), range.end())))
    }

    /// A coordinate in metres, in a frame that is not the world frame.
    pub fn position_m(&self) -> Result<f32, ReadError> {
        let value = self.number()?;
        if value.abs() <= f64::from(POSITION_MAX_M) {
            return Ok(value as f32);
        }
        Err(self.error(format!("beyond ±{POSITION_MAX_M} m")))
    }

    /// A speed or a component of one.
    pub fn speed_mps(&self) -> Result<f32, ReadError> {
        let most = f64::from(SPEED_MAX_MPS);
        self.number_in(-most..=most).map(|value| value as f32)
    }

    /// A speed computed from this value and others.
    pub fn speed_of(&self, speed_mps: f32) -> Result<f32, ReadError> {
        if speed_mps.abs() <= SPEED_MAX_MPS {
            return Ok(speed_mps);
        }
        Err(self.error(format!("a speed of {speed_mps} m/s, at most {SPEED_MAX_MPS} expected")))
    }

    /// An extent of an agent.
    pub fn extent_m(&self) -> Result<f32, ReadError> {
        self.number_in(0.0..=100.0).map(|value| value as f32)
    }

    /// An angle, wrapped to (−π, π].
    pub fn angle_rad(&self) -> Result<f32, ReadError> {
        self.number().map(|value| wrapped(value) as f32)
    }

    /// An integer, which may be written as `780.0` or `7.8e+02`.
    pub fn integer(&self) -> Result<i64, ReadError> {
        if let Ok(value) = self.text.parse() {
            return Ok(value);
        }
        let value = self.number()?;
        if value.fract() == 0.0 && value.abs() < INTEGER_MAX {
            return Ok(value as i64);
        }
        Err(self.error("not a whole number"))
    }

    /// A frame number.
    pub fn frame(&self) -> Result<i64, ReadError> {
        let frame = self.integer()?;
        if (0..=FRAME_MAX).contains(&frame) {
            return Ok(frame);
        }
        Err(self.error(format!("expected 0 to {FRAME_MAX}")))
    }

    /// The time of a frame that is numbered at this rate.
    pub fn stamp_ns(&self, rate: FrameRate) -> Result<i64, ReadError> {
        let stamp_ns = rate.stamp_ns(self.frame()?).filter(|stamp_ns| *stamp_ns <= STAMP_MAX_NS);
        stamp_ns.ok_or_else(|| self.error(format!("beyond {} s at {rate} Hz", STAMP_MAX_NS / 1_000_000_000)))
    }

    /// An identity below `limit`.
    pub fn id_below(&self, limit: u64) -> Result<u64, ReadError> {
        let id = match self.text.parse() {
            Ok(id) => Some(id),
            Err(_) => u64::try_from(self.integer()?).ok(),
        };
        id.filter(|id| *id < limit)
            .ok_or_else(|| self.error(format!("expected an id from 0 to {}", limit - 1)))
    }
}

/// A position in the world frame. The file's origin is subtracted in `f64`.
pub(crate) fn position_m(fields: [Field<'_>; 2]) -> Result<[f32; 2], ReadError> {
    let own_m = [fields[0].number()?, fields[1].number()?];
    let origin = fields[0].line.origin;
    origin.world_m(own_m).ok_or_else(|| {
        let is_near =
            |axis: &usize| (own_m[*axis] - origin.position_m()[*axis]).abs() <= f64::from(POSITION_MAX_M);
        let far = usize::from(is_near(&0));
        let remedy = WorldOrigin::near(own_m).map_or_else(String::new, |near| {
            format!(": if all positions are like this one, give an origin near them, --origin {near}")
        });
        fields[far].error(format!("beyond ±{POSITION_MAX_M} m of the origin{remedy}"))
    })
}

pub(crate) fn wrapped(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let turned = (angle_rad + PI).rem_euclid(TAU) - PI;
    if turned <= -PI { PI } else { turned }
}

/// At most [`SHOWN_MAX`] characters of a text, control characters escaped.
fn shown(text: &str) -> String {
    let mut short: String = text.chars().take(SHOWN_MAX).flat_map(char::escape_debug).collect();
    if text.chars().nth(SHOWN_MAX).is_some() {
        short.push('…');
    }
    short
}
