//! Colours of this program's output.

use std::borrow::Cow;
use std::ffi::OsString;
use std::io::IsTerminal;
use std::sync::OnceLock;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use ports::Color;

use crate::mistake::SourceError;

/// The choice made on the command line or in the environment.
static CHOICE: OnceLock<Color> = OnceLock::new();

/// The choices as the values of an argument.
pub fn choices() -> impl TypedValueParser<Value = Color> {
    PossibleValuesParser::new(Color::ALL.map(Color::name))
        .map(|name| Color::from_name(&name).unwrap_or_default())
}

/// The choice of this process.
pub fn choice() -> Color {
    *CHOICE.get_or_init(Color::of_environment)
}

/// Takes the choice from unparsed arguments, because parse errors are coloured too.
pub fn choose(arguments: impl Iterator<Item = OsString>) {
    CHOICE.get_or_init(|| of_arguments(arguments).unwrap_or_else(Color::of_environment));
}

/// The value of `--color`.
fn of_arguments(arguments: impl Iterator<Item = OsString>) -> Option<Color> {
    let words: Vec<String> = arguments.map(|word| word.to_string_lossy().into_owned()).collect();
    let named = words.iter().zip(words.iter().skip(1)).filter(|(flag, _)| *flag == "--color");
    let joined = words.iter().filter_map(|word| word.strip_prefix("--color="));
    named.map(|(_, value)| value.as_str()).chain(joined).filter_map(Color::from_name).next_back()
}

/// Formats a mistake in a file for standard error.
pub fn report(error: &SourceError) -> String {
    let output = std::io::stderr();
    error.report(output.is_terminal(), choice().is_on(&output))
}

/// Returns a line of a stage's log with its level in colour.
pub fn with_level(line: &str) -> Cow<'_, str> {
    let paint = |word: &str, code: u8| line.replacen(word, &format!("\x1b[{code}m{word}\x1b[0m"), 1).into();
    // The stage's name and the time come first.
    match line.split_whitespace().take(3).find(|word| ["ERROR", "WARN"].contains(word)) {
        Some(level @ "ERROR") => paint(level, 31),
        Some(level) => paint(level, 33),
        None => line.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_choice_is_found_among_the_arguments() {
        let of = |words: &[&str]| of_arguments(words.iter().map(OsString::from));
        assert_eq!(of(&["stgdat", "run", "--color", "never"]), Some(Color::Never));
        assert_eq!(of(&["stgdat", "--color=always", "run"]), Some(Color::Always));
        assert_eq!(of(&["stgdat", "--color", "blue"]), None);
        assert_eq!(of(&["stgdat", "run", "--color"]), None);
    }

    #[test]
    fn only_the_level_of_a_log_line_is_painted() {
        let painted = with_level("decoder: 2026-11-27T00:00:00Z  WARN 3 WARN");
        assert_eq!(painted, "decoder: 2026-11-27T00:00:00Z  \x1b[33mWARN\x1b[0m 3 WARN");
        assert_eq!(with_level("frame 3 is late"), "frame 3 is late");
    }
}
