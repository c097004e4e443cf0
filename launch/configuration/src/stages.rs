//! The built-in stages: each crate's declaration and the function that runs the stage.

use std::fmt::Write as _;

use clap::builder::PossibleValuesParser;
use ports::StageError;
use run::options::OptionSchema;
use run::{Declared, Run};
use wire::StageId;

/// Width of the help's lines without the margin.
const LINE: usize = 94;

/// A stage of this program.
pub struct BuiltIn {
    /// Declaration.
    pub declared: &'static dyn Declared,
    /// Runs the stage until the process is asked to end.
    pub body: fn(&Run) -> Result<(), StageError>,
}

/// All stages, in the order in which a tick passes them.
pub const STAGES: [BuiltIn; 8] = [
    BuiltIn { declared: &source::STAGE, body: source::stage::run },
    BuiltIn { declared: &tracker::STAGE, body: tracker::run },
    BuiltIn { declared: &localiser::STAGE, body: localiser::run },
    BuiltIn { declared: &extractor::STAGE, body: extractor::run },
    BuiltIn { declared: &encoder::STAGE, body: encoder::run },
    BuiltIn { declared: &decoder::STAGE, body: decoder::run },
    BuiltIn { declared: &sampler::STAGE, body: sampler::run },
    BuiltIn { declared: &recorder::STAGE, body: recorder::stage::run },
];

/// The stages on a tick's way, which also run in one process.
pub const IN_PROCESS: [StageId; 7] = [
    StageId::Source,
    StageId::Tracker,
    StageId::Localiser,
    StageId::Extractor,
    StageId::Encoder,
    StageId::Decoder,
    StageId::Sampler,
];

/// Returns the stage with this number.
pub fn built_in(id: StageId) -> Option<BuiltIn> {
    STAGES.into_iter().find(|stage| stage.declared.id() == id)
}

/// The declarations of all stages.
pub fn declared() -> [&'static dyn Declared; 8] {
    STAGES.map(|stage| stage.declared)
}

/// Every option of every stage as text.
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
    // The kind is left out if the expectation contains it.
    let is_implied = expected.ends_with(kind) || matches!(*kind, "truth value" | "name");
    let kind = if is_implied { String::new() } else { format!(" ({kind})") };
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

/// The names of the built-in stages.
pub fn names() -> PossibleValuesParser {
    PossibleValuesParser::new(StageId::ALL.map(StageId::name))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_stage_exists_once() {
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
    fn every_stage_accepts_empty_options() {
        for stage in declared() {
            assert_eq!(stage.check(&toml::Table::new()), Ok(()), "{}", stage.id().name());
        }
    }

    #[test]
    fn every_option_has_documentation_and_a_valid_default() {
        for stage in declared() {
            for option in stage.schema().iter() {
                let name = format!("{}.{}", stage.id().name(), option.name);
                assert!(option.about.ends_with('.'), "{name} has no documentation: {:?}", option.about);
                assert!(!option.expected.is_empty(), "{name} does not state its values");
                let Some(default) = &option.default else { continue };
                let table = format!("{} = {default}", option.name).parse().expect("a default is TOML");
                assert_eq!(stage.check(&table), Ok(()), "{name}");
            }
        }
    }

    #[test]
    fn the_help_lists_all_options() {
        insta::assert_snapshot!(options_help());
    }
}
