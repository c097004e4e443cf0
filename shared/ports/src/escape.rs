//! Text from outside, such as names of files, topics and tags, on a terminal.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io::{self, Write};

/// Returns text in which a terminal finds no command: control characters other than line feeds and tabs, and
/// characters that change the direction of text, become `\u001b` and the like. In JSON these are the same
/// characters. Sequences that set a colour stay if `keeps_colors`.
#[must_use]
pub fn escaped(text: &str, keeps_colors: bool) -> Cow<'_, str> {
    if !text.contains(is_command) {
        return text.into();
    }
    let mut escaped = String::with_capacity(text.len() + 16);
    let mut rest = text;
    while let Some(at) = rest.find(is_command) {
        let (before, from) = rest.split_at(at);
        escaped += before;
        let color_len = if keeps_colors { color_len(from) } else { 0 };
        let len = from.chars().next().map_or(0, char::len_utf8);
        match color_len {
            0 => from.chars().take(1).for_each(|c| {
                let _ = write!(escaped, "\\u{:04x}", u32::from(c));
            }),
            len => escaped += &from[..len],
        }
        rest = &from[color_len.max(len)..];
    }
    (escaped + rest).into()
}

fn is_command(c: char) -> bool {
    let turns = matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    (c.is_control() && !matches!(c, '\n' | '\t')) || turns
}

/// Number of bytes of a sequence that sets a colour at the start of the text; 0 if there is none.
fn color_len(text: &str) -> usize {
    let Some(rest) = text.strip_prefix("\x1b[") else { return 0 };
    let end = rest.find(|c: char| !c.is_ascii_digit() && c != ';' && c != ':');
    end.filter(|&end| rest[end..].starts_with('m')).map_or(0, |end| end + 3)
}

/// Standard error without commands to the terminal. Each piece that is written is a whole text.
#[derive(Debug)]
pub(crate) struct EscapedError;

impl Write for EscapedError {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        io::stderr().write_all(escaped(&String::from_utf8_lossy(bytes), true).as_bytes())?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_escaped_and_text_stays() {
        let hostile = "a\x1b]0;title\x07\x1b[2J\r\u{9b}31m\u{202e}b\n";
        assert_eq!(escaped(hostile, false), "a\\u001b]0;title\\u0007\\u001b[2J\\u000d\\u009b31m\\u202eb\n");
        assert!(matches!(escaped("日本 ü\n", false), Cow::Borrowed(_)));
    }

    #[test]
    fn only_whole_colours_stay() {
        let text = "\x1b[1;31merror\x1b[0m \x1b[2J \x1b[3";
        assert_eq!(escaped(text, true), "\x1b[1;31merror\x1b[0m \\u001b[2J \\u001b[3");
        assert_eq!(escaped("\x1b[31mx", false), "\\u001b[31mx");
    }

    #[test]
    fn escaped_json_has_the_same_value() {
        let json = serde_json::to_string("a\u{7f}\u{9b}\u{202e}").expect("it is text");
        let read: String = serde_json::from_str(&escaped(&json, false)).expect("it is JSON");
        assert_eq!(read, "a\u{7f}\u{9b}\u{202e}");
    }
}
