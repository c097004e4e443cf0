//! Common set-up and exit of `stgdat` and `stgdat-lab`.

use std::ffi::OsString;
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::process::ExitCode;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use nn::kernels::{self, Isa};
use run::Exit;
pub use supervisor::this_program;

use crate::failure::Failure;
use crate::{color, log, streams};

/// Arguments that every verb takes.
#[derive(Debug, Args)]
pub struct GlobalArguments {
    /// Instruction set of the kernels; by default the fastest that this processor supports
    #[arg(long, value_name = "SET", global = true, env = kernels::VARIABLE, value_parser = instruction_set())]
    kernels: Option<Isa>,
    /// Colours of the output: `auto` means on a terminal, unless the variable NO_COLOR is set
    #[arg(long, value_name = "WHEN", global = true, env = ports::COLOR_VARIABLE, value_parser = color::choices())]
    color: Option<ports::Color>,
    /// Format of the log on standard error; RUST_LOG selects its events
    #[arg(long, value_name = "FORMAT", global = true, env = ports::LOG_VARIABLE, value_parser = log::formats())]
    log: Option<ports::LogFormat>,
}

impl GlobalArguments {
    /// Starts the log and selects the kernels named on the command line.
    ///
    /// # Errors
    /// [`Failure::Usage`] if this processor lacks them.
    pub fn apply(&self) -> Result<(), Failure> {
        log::begin(self.log);
        let forced = self.kernels.map_or(Ok(()), kernels::force);
        forced.map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// Parses an instruction set by its key. Sets that this processor lacks are not offered.
fn instruction_set() -> impl TypedValueParser<Value = Isa> {
    PossibleValuesParser::new(Isa::ALL.map(Isa::key)).try_map(|key| key.parse::<Isa>())
}

/// Chooses colours by the command line and the environment.
pub fn begin() {
    color::choose(std::env::args_os());
}

/// Prints the help or the error of the argument parser and ends the process.
pub fn exit(error: &clap::Error) -> ! {
    // A closed pipe is no reason for another exit code.
    let _ = match error.use_stderr() {
        true => print(&mut std::io::stderr(), &error.to_string()),
        false => print(&mut std::io::stdout(), &error.to_string()),
    };
    std::process::exit(error.exit_code())
}

fn print(output: &mut (impl Write + IsTerminal), text: &str) -> std::io::Result<()> {
    let is_painted = color::choice().is_on(output);
    let text = &*ports::escaped(text, false);
    write!(output, "{}", if is_painted { painted(text) } else { text.to_owned() })
}

/// The text of the argument parser with its headings and flags in the parser's usual styles. Its own colours
/// would bring six more crates.
fn painted(text: &str) -> String {
    let paint = |line: &str, code: &str, from: usize, len: usize| {
        let (before, rest) = line.split_at(from);
        let (word, after) = rest.split_at(len);
        format!("{before}\x1b[{code}m{word}\x1b[0m{after}")
    };
    let line = |line: &str| match line.split_once(':') {
        Some((word @ "error", _)) => paint(line, "1;31", 0, word.len() + 1),
        Some((word @ ("Usage" | "Commands" | "Arguments" | "Options"), _)) => {
            paint(line, "1;4", 0, word.len() + 1)
        }
        _ => {
            let flag = line.trim_start();
            let len = flag.find("  ").unwrap_or(flag.trim_end().len());
            if flag.starts_with('-') {
                paint(line, "1", line.len() - flag.len(), len)
            } else {
                line.to_owned()
            }
        }
    };
    text.split_inclusive('\n').map(line).collect()
}

/// The flags of [`GlobalArguments`].
const GLOBAL: [&str; 3] = ["--kernels", "--color", "--log"];

/// Moves the global options before a verb behind it. Before a verb, the parser takes them for options of `run`.
pub fn verb_first(mut arguments: Vec<OsString>, is_verb: fn(&str) -> bool) -> Vec<OsString> {
    let mut verb = 1;
    while let Some(word) = arguments.get(verb).and_then(|word| word.to_str()) {
        verb += match word {
            _ if GLOBAL.contains(&word) => 2,
            _ if word.split_once('=').is_some_and(|(flag, _)| GLOBAL.contains(&flag)) => 1,
            _ if is_verb(word) => {
                arguments[1..=verb].rotate_right(1);
                break;
            }
            _ => break,
        }
    }
    arguments
}

/// Prints the failure of a verb, if any, and returns the exit code.
#[must_use]
pub fn end(outcome: Result<Exit, Failure>) -> ExitCode {
    let outcome = outcome.and_then(|exit| match streams::failed() {
        Some(error) if exit == Exit::Done => Err(Failure::output(Path::new("-"), error)),
        _ => Ok(exit),
    });
    let exit = outcome.unwrap_or_else(|failure| {
        failure.print();
        failure.exit()
    });
    streams::finish();
    exit.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headings_and_flags_of_the_help_are_painted() {
        let text = "error: no\n\nUsage: stgdat [FILE]\n\nOptions:\n  -v, --version  Print it: now\n      --color <WHEN>\n";
        let expected = "\x1b[1;31merror:\x1b[0m no\n\n\x1b[1;4mUsage:\x1b[0m stgdat [FILE]\n\n\
                        \x1b[1;4mOptions:\x1b[0m\n  \x1b[1m-v, --version\x1b[0m  Print it: now\n      \
                        \x1b[1m--color <WHEN>\x1b[0m\n";
        assert_eq!(painted(text), expected);
        assert_eq!(painted("A tracker: fast\n"), "A tracker: fast\n");
    }

    #[test]
    fn global_options_may_stand_before_the_verb() {
        let ordered = |words: &str| {
            let arguments = words.split(' ').map(OsString::from).collect();
            let ordered = verb_first(arguments, |word| word == "inspect");
            ordered.join(" ".as_ref()).into_string().unwrap()
        };
        for (words, expected) in [
            ("stgdat --color always inspect a.csv", "stgdat inspect --color always a.csv"),
            (
                "stgdat --color=never --kernels avx2 inspect a.csv",
                "stgdat inspect --color=never --kernels avx2 a.csv",
            ),
            ("stgdat inspect --color always a.csv", "stgdat inspect --color always a.csv"),
            ("stgdat --log=json inspect a.csv", "stgdat inspect --log=json a.csv"),
            ("stgdat --log json inspect a.csv", "stgdat inspect --log json a.csv"),
            ("stgdat --color always a.csv", "stgdat --color always a.csv"),
            ("stgdat --ticks 5 inspect", "stgdat --ticks 5 inspect"),
            ("stgdat --color", "stgdat --color"),
        ] {
            assert_eq!(ordered(words), expected);
        }
    }
}
