//! The stages that this program holds: each crate's declaration and the function that is the stage.

use std::fmt::Write as _;

use ports::StageError;
use run::options::OptionSchema;
use run::{Declared, Run};
use wire::StageId;

/// Width of the help's lines, less their margin.
const LINE: usize = 94;

/// A stage that is inside this program.
pub struct BuiltIn {
    /// What it declares.
    pub declared: &'static dyn Declared,
    /// Is the stage until the process is asked to end.
    pub body: fn(&Run) -> Result<(), StageError>,
}

/// All of them, in the order in which a tick passes them.
pub const STAGES: [BuiltIn; 8] = [
    BuiltIn { declared: &source::STAGE, body: source::stage::run },
    BuiltIn { declared: &tracker::STAGE, body: tracker::stage::run },
    BuiltIn { declared: &localiser::STAGE, body: localiser::stage::run },
    BuiltIn { declared: &extractor::STAGE, body: extractor::stage::run },
    BuiltIn { declared: &encoder::STAGE, body: encoder::stage::run },
    BuiltIn { declared: &decoder::STAGE, body: decoder::stage::run },
    BuiltIn { declared: &sampler::STAGE, body: sampler::stage::run },
    BuiltIn { declared: &recorder::STAGE, body: recorder::stage::run },
];

/// The stage with that number.
pub fn built_in(id: StageId) -> Option<BuiltIn> {
    STAGES.into_iter().find(|stage| stage.declared.id() == id)
}

/// What all of them declare.
pub fn declared() -> [&'static dyn Declared; 8] {
    STAGES.map(|stage| stage.declared)
}

/// Every option of every stage, for people to read.
pub fn options_help() -> String {
    let mut text =
        "Options, set by `options = { … }` in pipeline.toml or by --set STAGE.OPTION=VALUE:\n".to_owned();
    for stage in declared() {
        let schema = stage.schema();
        for option in schema.iter() {
            // Writing to a string does not fail.
            let _ = write!(text, "\n{}", option_help(stage.id(), option));
        }
    }
    text
}

fn option_help(stage: StageId, option: &OptionSchema) -> String {
    let OptionSchema { name, about, kind, expected, default, .. } = option;
    let default = default.as_ref().map_or_else(String::new, |default| format!(" [default: {default}]"));
    // Where what is expected tells the kind, once is enough.
    let says_all = expected.ends_with(kind) || matches!(*kind, "truth value" | "name");
    let kind = if says_all { String::new() } else { format!(" ({kind})") };
    let mut text = format!("  {}.{name}{kind}: {expected}{default}\n", stage.name());
    let mut line = String::new();
    for word in about.split_whitespace() {
        if line.len() + word.len() > LINE {
            text += &format!("     {line}\n");
            line.clear();
        }
        line = format!("{line} {word}");
    }
    text + &format!("     {line}\n")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_stage_is_there_once() {
        assert_eq!(declared().map(|stage| stage.id()), StageId::ALL);
    }

    #[test]
    fn every_topic_has_one_writer_and_a_reader() {
        let written: Vec<&str> = declared().iter().flat_map(|stage| stage.writes()).copied().collect();
        let read: BTreeSet<&str> = declared().iter().flat_map(|stage| stage.reads()).copied().collect();
        assert_eq!(written.len(), read.len(), "{written:?} {read:?}");
        assert_eq!(BTreeSet::from_iter(written), read);
    }

    #[test]
    fn every_stage_starts_without_options() {
        for stage in declared() {
            assert_eq!(stage.check(&toml::Table::new()), Ok(()), "{}", stage.id().name());
        }
    }

    #[test]
    fn every_option_says_what_it_is_and_its_default_is_accepted() {
        for stage in declared() {
            for option in stage.schema().iter() {
                let name = format!("{}.{}", stage.id().name(), option.name);
                assert!(option.about.ends_with('.'), "{name} has no documentation: {:?}", option.about);
                assert!(!option.expected.is_empty(), "{name} does not tell what it takes");
                let Some(default) = &option.default else { continue };
                let table = format!("{} = {default}", option.name).parse().expect("a default is TOML");
                assert_eq!(stage.check(&table), Ok(()), "{name}");
            }
        }
    }

    #[test]
    fn all_options_are_told() {
        insta::assert_snapshot!(options_help());
    }
}
