//! Lines of a stage's output.

use std::borrow::Cow;

use serde_json::{Map, Value};

/// Returns the line without its colour escape sequences.
#[must_use]
pub fn plain(line: &str) -> Cow<'_, str> {
    let Some((begin, mut rest)) = line.split_once('\x1b') else { return line.into() };
    let mut text = begin.to_owned();
    loop {
        // A control sequence ends with its first byte from @ to ~; other sequences have one more character.
        let end = match rest.strip_prefix('[') {
            Some(sequence) => sequence.find(|c| matches!(c, '@'..='~')).map_or(rest.len(), |at| at + 2),
            None => rest.chars().next().map_or(0, char::len_utf8),
        };
        let Some((piece, next)) = rest[end..].split_once('\x1b') else {
            return (text + &rest[end..]).into();
        };
        text += piece;
        rest = next;
    }
}

/// The message of a stage's line.
#[must_use]
pub fn message(line: &str) -> String {
    let parsed = parse(line);
    let message = parsed.as_ref().and_then(|line| line.get("message")?.as_str());
    message.unwrap_or(line).to_owned()
}

/// The object of a line of JSON; `None` for other lines.
#[must_use]
pub fn parse(line: &str) -> Option<Map<String, Value>> {
    serde_json::from_str(line).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_lines_have_no_escape_sequences() {
        let colored = "\x1b[2m2026-11-27T00:00:00Z\x1b[0m \x1b[38;5;3m WARN\x1b[0m late\x1b[K";
        assert_eq!(plain(colored), "2026-11-27T00:00:00Z  WARN late");
        for (line, expected) in [("ü", "ü"), ("\x1b", ""), ("a\x1b[", "a"), ("a\x1bMb", "ab"), ("\x1bü", "")]
        {
            assert_eq!(plain(line), expected, "{line:?}");
        }
    }

    #[test]
    fn the_message_of_an_object_is_its_field_and_other_lines_are_the_message() {
        assert_eq!(message(r#"{"level":"WARN","message":"late"}"#), "late");
        for line in ["panicked at 'x'", "{broken", "[1, 2]", ""] {
            assert_eq!(message(line), line);
        }
    }
}
