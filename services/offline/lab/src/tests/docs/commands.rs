//! Command lines in the code blocks of a page.

use clap::error::ErrorKind;

use super::Page;
use crate::verbs::manual;

/// Languages of blocks in which each line is a command.
const SHELLS: [&str; 3] = ["sh", "bash", "shell"];
/// Languages of blocks in which commands follow a prompt.
const SESSIONS: [&str; 2] = ["console", "text"];

/// The command lines of this program as words, `stgdat` first, with their line numbers.
pub fn of_page(page: &Page) -> Vec<(usize, Vec<String>)> {
    let mut commands = Vec::new();
    // A command whose last line ends in a backslash.
    let mut open: Option<(usize, String)> = None;
    for (number, language, line) in page.lines() {
        let language = language.unwrap_or_default();
        let line = line.trim();
        let (start, text) = match open.take() {
            Some((start, before)) => (start, before + " " + line),
            None => match line.strip_prefix("$ ") {
                Some(command) if SHELLS.contains(&&*language) || SESSIONS.contains(&&*language) => {
                    (number, command.to_owned())
                }
                None if SHELLS.contains(&&*language) => (number, line.to_owned()),
                _ => continue,
            },
        };
        match text.strip_suffix('\\') {
            Some(text) => open = Some((start, text.to_owned())),
            None => commands.extend(simple_commands(&text).into_iter().map(|words| (start, words))),
        }
    }
    let ours = commands.into_iter().filter_map(|(number, words)| Some((number, of_program(words)?)));
    ours.collect()
}

/// Splits a line at `|`, `&&`, `||`, `;` and `&` and returns the commands as words, without comments and
/// redirections.
fn simple_commands(line: &str) -> Vec<Vec<String>> {
    let mut commands = vec![Vec::new()];
    let (mut word, mut is_word) = (String::new(), false);
    let mut skips_next = false;
    let mut end_word =
        |word: &mut String, is_word: &mut bool, commands: &mut Vec<Vec<String>>, redirects: bool| {
            if std::mem::take(is_word) {
                let word = std::mem::take(word);
                // The number of a redirected stream and the target file are not arguments.
                let is_stream = redirects && word.chars().all(|c| c.is_ascii_digit());
                if !std::mem::take(&mut skips_next) && !is_stream {
                    commands.last_mut().expect("there is one from the start").push(word);
                }
            }
            skips_next |= redirects;
        };
    let mut chars = line.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '#' if !is_word => break,
            '\'' | '"' => {
                is_word = true;
                word.extend(chars.by_ref().take_while(|&inner| inner != c));
            }
            '\\' => {
                is_word = true;
                word.extend(chars.next());
            }
            // A placeholder: `<FILE>`.
            '<' if !is_word && chars.peek().is_some_and(|c| c.is_ascii_uppercase()) => {
                is_word = true;
                word.extend(chars.by_ref().take_while(|&inner| inner != '>'));
            }
            '<' | '>' => {
                while chars.next_if(|&c| matches!(c, '<' | '>' | '&')).is_some() {}
                end_word(&mut word, &mut is_word, &mut commands, true);
            }
            '|' | ';' | '&' => {
                end_word(&mut word, &mut is_word, &mut commands, false);
                commands.push(Vec::new());
            }
            c if c.is_whitespace() => end_word(&mut word, &mut is_word, &mut commands, false),
            c => {
                is_word = true;
                word.push(c);
            }
        }
    }
    end_word(&mut word, &mut is_word, &mut commands, false);
    commands
}

/// The words from `stgdat` on, if this is the program: `stgdat …`, `target/release/stgdat …`, `cargo run … --
/// …`.
fn of_program(words: Vec<String>) -> Option<Vec<String>> {
    let is_variable = |word: &String| {
        let name = word.split_once('=').map(|(name, _)| name);
        name.is_some_and(|name| !name.is_empty() && name.chars().all(|c| c.is_ascii_uppercase() || c == '_'))
    };
    let mut words = words.into_iter().skip_while(is_variable);
    let program = words.next()?;
    let is_program = |name: &str| program == name || program.ends_with(&format!("/{name}"));
    if is_program("stgdat") || is_program("stgdat-lab") {
        return Some(std::iter::once("stgdat".to_owned()).chain(words).collect());
    }
    if program != "cargo" || words.next()? != "run" {
        return None;
    }
    let of_cargo: Vec<String> = words.by_ref().take_while(|word| word != "--").collect();
    let is_other = |word: &String| matches!(word.as_str(), "-p" | "--package" | "--example" | "--bin");
    let is_ours = !of_cargo.iter().any(is_other)
        || of_cargo.iter().any(|word| word == "stgdat" || word == "stgdat-lab");
    is_ours.then(|| std::iter::once("stgdat".to_owned()).chain(words).collect())
}

/// Parses a command line as the program would.
pub fn parse(words: &[String]) -> Result<(), String> {
    match manual::command().try_get_matches_from(words) {
        Ok(_) => Ok(()),
        Err(error) if matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => Ok(()),
        Err(error) => Err(error.to_string()),
    }
}

#[test]
fn command_lines_are_split_as_a_shell_splits_them() {
    let text =
        "A=1 stgdat predict 'a b' --map <FILE> 2> log > out.jsonl && ls | target/release/stgdat check # why";
    let commands: Vec<_> = simple_commands(text).into_iter().filter_map(of_program).collect();
    assert_eq!(commands, [vec!["stgdat", "predict", "a b", "--map", "FILE"], vec!["stgdat", "check"]]);
    assert!(commands.iter().all(|words| parse(words).is_ok()));
    let cargo = simple_commands("cargo run --release -- run --agents 8; cargo run --example consumer -- 3");
    let commands: Vec<_> = cargo.into_iter().filter_map(of_program).collect();
    assert_eq!(commands, [["stgdat", "run", "--agents", "8"]]);
}

#[test]
fn a_wrong_option_is_refused() {
    let words = ["stgdat", "run", "--no-such-option"].map(ToOwned::to_owned);
    assert!(parse(&words).is_err());
}

#[test]
fn commands_go_on_after_a_backslash() {
    let text = "```sh\nstgdat run \\\n  --agents 8\n```\n```text\n$ stgdat check\nok\n```\nstgdat no\n";
    let page = Page { name: String::new(), path: std::path::PathBuf::new(), text: text.to_owned() };
    let commands: Vec<_> =
        of_page(&page).into_iter().map(|(number, words)| (number, words.join(" "))).collect();
    assert_eq!(commands, [(2, "stgdat run --agents 8".to_owned()), (6, "stgdat check".to_owned())]);
}
