//! Prints the command line as a Markdown page, `docs/cli.md`.
//!
//! The page comes from the definitions in clap and the schemas of the stages' options. Lines are wrapped
//! here, so the terminal's width and the environment do not change the page.

mod files;

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::{Arg, Args, Command, CommandFactory as _};
use run::Exit;
use run::options::OptionSchema;

use configuration::stages;
use console::failure::Failure;
use console::show::show;

/// Maximum length of a line; single words and usages may be longer.
const WIDTH: usize = 110;

/// The verbs by purpose. A unit test finds verbs without a group.
const GROUPS: [(&str, &[&str]); 5] = [
    ("Run", &["run", "predict", "track", "check", "graph", "stage", "wire"]),
    ("Observe", &["top", "health", "view", "ros2", "bridge", "report", "trace", "tick"]),
    ("Record", &["record", "export", "mark", "replay", "diff"]),
    ("Diagnose", &["inspect", "verify", "bench", "doctor", "clean", "completions"]),
    ("Laboratory", &["train", "evaluate", "card", "plot", "map", "fault", "manual"]),
];

/// The beginning of the page.
const HEAD: &str = "\
# Command line

<!-- Written by `stgdat manual > docs/cli.md`. Change the help texts of the verbs, not this page. -->

`stgdat` without a verb is `stgdat run`. The verbs of the group Laboratory belong to a second program, `stgdat-lab`.
`stgdat evaluate` runs `stgdat-lab evaluate` if that program is in the same folder or in PATH.
`stgdat ros2` and `stgdat bridge` run `stgdat-ros2` and `stgdat-bridge` in the same way.

Every verb takes `-h` for a summary and `--help` for all of this page about it;
`stgdat --version` prints the version, the SHA-256 of the embedded weights and the CPU kernels in use.

| exit code | meaning |
|---|---|
| 0 | done |
| 1 | `diff` and `replay` have found differences |
| 2 | wrong usage of the command line |
| 65 | a recording, map or weights file can't be used, or an output file can't be written |
| 69 | a resource is missing: shared memory, space, a port |
| 70 | a stage died, or a check came out wrong |
| 78 | pipeline.toml or the run's record can't be used, or this processor lacks the precision asked for |
| 129, 130, 131, 143 | ended by SIGHUP (the terminal is gone), Ctrl-C, SIGQUIT, SIGTERM |
";

/// Arguments of `stgdat manual`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Write man pages and completions for shells into this folder instead
    #[arg(long, value_name = "DIR")]
    package: Option<PathBuf>,
}

/// Prints the page, or writes the files of the packages.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    match &arguments.package {
        Some(folder) => files::write(folder).map(|()| Exit::Done),
        None => show(&page()),
    }
}

/// The command line of `stgdat`, in which the verbs of its other programs have those programs' definitions.
pub fn command() -> Command {
    let with_verb =
        |program: Command, verb: &Command| program.mut_subcommand(verb.get_name(), |_| verb.clone());
    verbs_of_others().iter().fold(launch::command(), with_verb)
}

/// The verbs that other programs than `stgdat` execute.
fn verbs_of_others() -> Vec<Command> {
    let programs = [
        ros2::command::Arguments::command().name("ros2"),
        bridge::command::Arguments::command().name("bridge"),
    ];
    crate::Cli::command().get_subcommands().cloned().chain(programs).collect()
}

/// The whole page.
pub fn page() -> String {
    let mut program = command().disable_help_flag(true).disable_help_subcommand(true);
    program.build();
    let program_arguments: Vec<Arg> =
        program.get_arguments().filter(|arg| arg.is_global_set()).cloned().collect();
    let mut verbs: BTreeMap<String, &mut Command> =
        program.get_subcommands_mut().map(|verb| (verb.get_name().to_owned(), verb)).collect();
    let mut text = HEAD.to_owned();
    for (group, names) in GROUPS {
        let links: Vec<String> = names.iter().map(|name| format!("[{name}](#stgdat-{name})")).collect();
        text += &format!("\n{}", wrapped(&links.join(", "), &format!("- {group}: "), "  "));
    }
    text += "\n- [Options of the stages](#options-of-the-stages)\n\nEvery verb takes:\n\n";
    text += &program_arguments.into_iter().map(|arg| item(&arg)).collect::<String>();
    for (group, names) in GROUPS {
        text += &format!("\n## {group}\n");
        for name in names {
            if let Some(verb) = verbs.get_mut(*name) {
                text += &section(verb, "###");
            }
        }
    }
    text + &stage_options()
}

/// A verb: its purpose, usage and arguments, and its subcommands.
fn section(verb: &mut Command, heading: &str) -> String {
    let name = verb.get_bin_name().unwrap_or(verb.get_name()).to_owned();
    let about = verb.get_about().map(ToString::to_string).unwrap_or_default();
    let usage = verb.render_usage().to_string();
    let usage = usage.trim_start_matches("Usage: ");
    let mut text = format!("\n{heading} {name}\n\n{}\n\n```text\n{usage}\n```\n", wrapped(&about, "", ""));
    let shown = |arg: &&Arg| !arg.is_hide_set() && !arg.is_global_set() && arg.get_id() != "help";
    let (positionals, options): (Vec<&Arg>, Vec<&Arg>) =
        verb.get_arguments().filter(shown).partition(|arg| arg.is_positional());
    for (title, args) in [("Arguments", positionals), ("Options", options)] {
        if !args.is_empty() {
            text += &format!("\n{title}:\n\n");
            text += &args.into_iter().map(item).collect::<String>();
        }
    }
    for below in verb.get_subcommands_mut().filter(|below| !below.is_hide_set()) {
        text += &section(below, &format!("{heading}#"));
    }
    text
}

/// An argument as a list item.
fn item(arg: &Arg) -> String {
    let takes_values = arg.get_action().takes_values();
    let mut notes = Vec::new();
    let values: Vec<_> =
        arg.get_possible_values().into_iter().filter(|value| takes_values && !value.is_hide_set()).collect();
    let are_described = values.iter().any(|value| value.get_help().is_some());
    if !are_described && !values.is_empty() {
        let names: Vec<String> = values.iter().map(|value| format!("`{}`", value.get_name())).collect();
        notes.push(format!("one of {}", names.join(", ")));
    }
    let defaults = arg.get_default_values();
    if takes_values && !defaults.is_empty() && !arg.is_hide_default_value_set() {
        let defaults: Vec<_> = defaults.iter().map(|value| value.to_string_lossy()).collect();
        notes.push(format!("default `{}`", defaults.join(",")));
    }
    if let Some(variable) = arg.get_env() {
        notes.push(format!("environment `{}`", variable.to_string_lossy()));
    }
    let help = arg.get_long_help().or(arg.get_help()).map(ToString::to_string).unwrap_or_default();
    let mut paragraphs = help.split("\n\n");
    let mut first = paragraphs.next().unwrap_or_default().trim_end().to_owned();
    if !notes.is_empty() {
        first += &format!(" ({})", notes.join("; "));
    }
    let mut text = wrapped(&first, &format!("- `{arg}`: "), "  ") + "\n";
    for paragraph in paragraphs {
        text += &format!("\n{}\n", wrapped(paragraph, "  ", "  "));
    }
    for value in values.iter().filter(|_| are_described) {
        let help = value.get_help().map(ToString::to_string).unwrap_or_default();
        text += &format!("{}\n", wrapped(&help, &format!("  - `{}`: ", value.get_name()), "    "));
    }
    text
}

fn stage_options() -> String {
    let intro = "Set by `options = { … }` of the stage in pipeline.toml, or on the command line of `run`, `predict`, `track` \
                 and `bench` by `--set STAGE.OPTION=VALUE`. `stgdat stage --help` prints them too.";
    let mut text = format!("\n## Options of the stages\n\n{}\n", wrapped(intro, "", ""));
    for stage in stages::declared() {
        let (schema, name) = (stage.schema(), stage.id().name());
        if schema.iter().next().is_some() {
            text += &format!("\n### {name}\n\n");
        }
        for OptionSchema { name: option, about, expected, default, .. } in schema.iter() {
            let default =
                default.as_ref().map_or_else(String::new, |default| format!("; default `{default}`"));
            let about = about.trim_end_matches('.');
            let start = format!("- `{name}.{option}`: ");
            text += &format!("{}\n", wrapped(&format!("{about} ({expected}{default})"), &start, "  "));
        }
    }
    text
}

/// Wraps words to lines of at most [`WIDTH`]. The first line begins with `start`, the others with `indent`.
/// Code in backticks is not broken.
fn wrapped(text: &str, start: &str, indent: &str) -> String {
    let (mut lines, mut line) = (Vec::new(), start.to_owned());
    let mut is_empty = true;
    for word in words(text) {
        if !is_empty && line.chars().count() + 1 + word.chars().count() > WIDTH {
            lines.push(std::mem::replace(&mut line, indent.to_owned()));
            is_empty = true;
        }
        if !is_empty {
            line.push(' ');
        }
        line += &word;
        is_empty = false;
    }
    lines.push(line);
    lines.join("\n")
}

/// The words of a text. Code in backticks is one word; outside of code, `<` is escaped.
fn words(text: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut in_code = false;
    for word in text.split_whitespace() {
        match words.last_mut().filter(|_| in_code) {
            Some(last) => *last += &format!(" {word}"),
            None => words.push(word.to_owned()),
        }
        in_code ^= word.matches('`').count() % 2 == 1;
    }
    let escaped = |word: String| if word.contains('`') { word } else { word.replace('<', "&lt;") };
    words.into_iter().map(escaped).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn every_verb_is_in_one_group() {
        let mut grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| *names).copied().collect();
        grouped.sort_unstable();
        let program = command();
        // Hidden verbs that only the launcher calls are not on the page.
        let is_known = |verb: &&Command| !verb.is_hide_set() || grouped.contains(&verb.get_name());
        let mut verbs: Vec<&str> =
            program.get_subcommands().filter(is_known).map(Command::get_name).collect();
        verbs.sort_unstable();
        assert_eq!(grouped, verbs);
    }

    #[test]
    fn the_page_in_docs_is_what_the_verb_prints() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/cli.md");
        let written = std::fs::read_to_string(&path).unwrap_or_default();
        let is_current = written == page();
        assert!(is_current, "docs/cli.md is out of date: cargo run --release -- manual > docs/cli.md");
    }

    #[test]
    fn lines_of_the_page_fit_its_width() {
        let long: Vec<String> =
            page().lines().filter(|line| line.chars().count() > 120).map(Into::into).collect();
        assert!(long.is_empty(), "{long:#?}");
    }

    #[test]
    fn wrapping_keeps_code_whole_and_escapes_tags() {
        assert_eq!(words("set `a b` to <c>"), ["set", "`a b`", "to", "&lt;c>"]);
        let text = wrapped(&"word ".repeat(40), "- ", "  ");
        assert!(text.lines().all(|line| line.len() <= WIDTH), "{text}");
        assert_eq!(text.split_whitespace().count(), 41);
    }
}
