//! Lines of styled text for a terminal.

pub use anstyle::{AnsiColor as Color, Style};
use unicode_width::UnicodeWidthChar;

/// Less important text.
pub const DIM: Style = Color::BrightBlack.on_default();
/// Important text.
pub const BOLD: Style = Style::new().bold();
/// A program's name in a title.
pub const TITLE: Style = Style::new()
    .fg_color(Some(anstyle::Color::Ansi(Color::Black)))
    .bg_color(Some(anstyle::Color::Ansi(Color::Cyan)))
    .bold();

/// A piece of a line in one style.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Span {
    /// The text.
    pub text: String,
    /// Style.
    pub style: Style,
}

impl Span {
    /// A piece of plain text.
    pub fn raw(text: impl Into<String>) -> Self {
        Self::styled(text, Style::new())
    }

    /// A piece of text in a style.
    pub fn styled(text: impl Into<String>, style: Style) -> Self {
        Self { text: text.into(), style }
    }

    /// A piece of text in a colour.
    pub fn colored(text: impl Into<String>, color: Color) -> Self {
        Self::styled(text, color.on_default())
    }
}

/// A line of a table.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Line(pub Vec<Span>);

impl Line {
    /// A line of plain text.
    pub fn raw(text: impl Into<String>) -> Self {
        Self(vec![Span::raw(text)])
    }

    /// A line in a style.
    pub fn styled(text: impl Into<String>, style: Style) -> Self {
        Self(vec![Span::styled(text, style)])
    }

    /// A line in a colour.
    pub fn colored(text: impl Into<String>, color: Color) -> Self {
        Self(vec![Span::colored(text, color)])
    }

    /// The number of cells that the line occupies.
    #[must_use]
    pub fn width(&self) -> usize {
        self.0.iter().flat_map(|span| span.text.chars()).filter_map(UnicodeWidthChar::width).sum()
    }

    /// The first `width` cells of the line. Control characters are left out: a file's name may contain them.
    #[must_use]
    pub fn cut(&self, width: usize) -> Self {
        let mut left = Some(width);
        let mut is_in = |c: &char| {
            let Some(cells) = c.width() else { return false };
            left = left.and_then(|left| left.checked_sub(cells));
            left.is_some()
        };
        let mut cut =
            |span: &Span| Span::styled(span.text.chars().filter(&mut is_in).collect::<String>(), span.style);
        Self(self.0.iter().map(&mut cut).collect())
    }

    /// The first `width` cells of the line as text, with escape sequences for the styles if `is_styled`.
    #[must_use]
    pub fn paint(&self, width: usize, is_styled: bool) -> String {
        let paint =
            |Span { text, style }: Span| if is_styled { format!("{style}{text}{style:#}") } else { text };
        self.cut(width).0.into_iter().map(paint).collect()
    }
}

/// A curve of `height` rows and `width` columns, in steps of an eighth of a row. `newest` starts with the
/// newest value, which is at the right end; a full column is `most`.
#[must_use]
pub fn curve(newest: &[u64], most: u64, width: usize, height: usize) -> Vec<String> {
    const PARTS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let eighths = |value: u64| value.saturating_mul(height as u64 * 8) / most.max(1);
    let row = |from_below: usize| {
        let column = |place: usize| {
            let eighths = newest.get(place).map_or(0, |&value| eighths(value));
            PARTS[eighths.saturating_sub(from_below as u64 * 8).min(8) as usize]
        };
        (0..width).rev().map(column).collect()
    };
    (0..height).rev().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_cut_to_its_cells_and_has_no_control_characters() {
        let line = Line(vec![Span::colored("日本\x1b[2Jx", Color::Red), Span::raw(" end")]);
        assert_eq!(line.width(), 12);
        assert_eq!(line.paint(100, false), "日本[2Jx end");
        assert_eq!(line.paint(3, false), "日");
        assert_eq!(line.paint(9, false), "日本[2Jx ");
        assert_eq!(line.paint(5, true), "\x1b[31m日本[\x1b[0m");
        assert_eq!(line.cut(4), Line(vec![Span::colored("日本", Color::Red), Span::raw("")]));
        assert_eq!(line.paint(0, false), "");
    }

    #[test]
    fn a_curve_has_its_newest_value_at_the_right() {
        assert_eq!(curve(&[8, 4, 1, 0, 99], 8, 6, 1), [" █ ▁▄█"]);
        assert_eq!(curve(&[12, 4], 16, 2, 2), [" ▄", "▄█"]);
        assert_eq!(curve(&[], 0, 2, 1), ["  "]);
        assert_eq!(curve(&[1], 1, 0, 0), Vec::<String>::new());
    }
}
