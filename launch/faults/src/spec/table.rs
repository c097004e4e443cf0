//! The specification as written. Values that can be wrong have their span in the text.
//!
//! The key `kind` of a fault selects the fields of its other keys. An internally tagged enum of serde would lose
//! the spans. So `kind` is taken from the table first, and the rest is read as the variant of this name.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;

use console::mistake::Mistake;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue, ValueDeserializer};

use crate::effect::{Effect, Part};

/// A resource of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resource {
    /// Open descriptors.
    Descriptors,
    /// Maximum size of written files, as on a full disk. It applies to shared memory too.
    FileSize,
    /// Address space.
    Memory,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub shows: String,
    pub run: RunTable,
    #[serde(default)]
    pub expect: Expect,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RunTable {
    pub ticks: Spanned<u64>,
    pub agents: Option<u64>,
    pub recording: Option<PathBuf>,
    #[serde(default = "one")]
    pub seed: u64,
    pub pipeline: Option<Spanned<PathBuf>>,
    pub forecasts: Option<PathBuf>,
    pub protect: Option<Vec<String>>,
    #[serde(default)]
    pub stages: BTreeMap<Spanned<String>, toml::Table>,
    #[serde(default)]
    pub arguments: Vec<String>,
}

const fn one() -> u64 {
    1
}

/// A fault of a process as written.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) enum Process {
    Kill(Kill),
    Random {
        ticks: Spanned<[u64; 2]>,
        count: Spanned<u64>,
        stages: Option<Spanned<Vec<String>>>,
        for_ms: Option<u64>,
    },
    Stop {
        stage: Spanned<String>,
        at: Spanned<At>,
        for_ms: u64,
    },
    Limit {
        stage: Spanned<String>,
        at: Spanned<At>,
        resource: Resource,
        value: u64,
    },
    CrashLoop {
        stage: Spanned<String>,
        at: Spanned<At>,
        exit_code: Option<u8>,
    },
    Command {
        stage: Spanned<String>,
        command: Spanned<Vec<String>>,
    },
    Replace {
        stage: Spanned<String>,
        at: Spanned<At>,
        command: Option<Spanned<Vec<String>>>,
        point: Option<Spanned<String>>,
    },
    Cpu {
        at: Spanned<At>,
        for_ms: u64,
        threads: Option<usize>,
    },
    Consumer {
        topic: Spanned<String>,
        hold_ms: Option<u64>,
        within_ms: Option<Spanned<[u64; 2]>>,
    },
}

/// A SIGKILL as written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Kill {
    pub stage: Spanned<String>,
    pub at: Option<Spanned<At>>,
    pub after_start_ms: Option<u64>,
    pub within_ms: Option<Spanned<[u64; 2]>>,
    pub point: Option<Spanned<String>>,
}

/// The keys that every fault of a topic has in addition to those of its [`Effect`].
#[derive(Debug, Deserialize)]
pub(super) struct TopicTable {
    pub topic: Spanned<String>,
    pub ticks: Spanned<[u64; 2]>,
    pub probability: Option<Spanned<f64>>,
    pub seed: Option<u64>,
}

/// A fault as written.
#[derive(Debug)]
pub(super) enum FaultTable {
    Process(Process),
    Topic(TopicTable, Effect),
}

impl FaultTable {
    /// Reads a fault by its `kind`.
    pub fn read(fault: Spanned<DeValue<'_>>) -> Result<Spanned<Self>, Mistake> {
        let span = fault.span();
        let missing = || Mistake::new(span.clone(), "a fault needs `kind`", "in this fault");
        let DeValue::Table(mut table) = fault.into_inner() else { return Err(missing()) };
        let kind = table.remove("kind").ok_or_else(missing)?;
        let kind_span = kind.span();
        let DeValue::String(kind) = kind.into_inner() else {
            return Err(Mistake::new(kind_span, "`kind` is not a text", "expected the kind of a fault"));
        };
        let is_effect = Effect::NAMES.contains(&&*kind);
        let common = ["topic", "ticks", "probability", "seed"].into_iter().filter(|_| is_effect);
        let common: DeTable<'_> = common.filter_map(|key| table.remove_entry(key)).collect();
        let part = table.get("in").map(Spanned::span);
        let own = Spanned::new(span.clone(), DeValue::Table(table));
        let tagged = DeTable::from_iter([(Spanned::new(kind_span, kind), own)]);
        let fault = if is_effect {
            let effect = deserialize(&span, tagged)?;
            if let Effect::BitFlip { part: Part::Stamp, .. } | Effect::Frozen { part: Part::Header } = effect
            {
                let other = if matches!(effect, Effect::Frozen { .. }) { "stamp" } else { "header" };
                let label = format!("expected {other} or payload");
                return Err(Mistake::new(
                    part.unwrap_or(span),
                    format!("`in` of a \"{}\"", effect.name()),
                    label,
                ));
            }
            Self::Topic(deserialize(&span, common)?, effect)
        } else {
            let listed = format!("the kinds of faults of a topic are {}", Effect::NAMES.join(", "));
            Self::Process(deserialize(&span, tagged).map_err(|mistake| mistake.help(listed))?)
        };
        Ok(Spanned::new(span, fault))
    }
}

fn deserialize<T: DeserializeOwned>(span: &Range<usize>, table: DeTable<'_>) -> Result<T, Mistake> {
    let value = Spanned::new(span.clone(), DeValue::Table(table));
    T::deserialize(ValueDeserializer::from(value)).map_err(|error| Mistake::syntax("", &error))
}

/// One tick or several.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum At {
    One(u64),
    Many(Vec<u64>),
}

/// The expected behaviour of a run. A value that is not set is not checked, except for the defaults.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Expect {
    /// The run's exit code; -9 if signal 9 ended it.
    pub exit_code: i32,
    /// Maximum length of a gap in the output, in ticks.
    pub hole_max: Option<u64>,
    /// Maximum number of ticks without forecasts.
    pub lost_max: Option<u64>,
    /// Maximum number of ticks whose forecasts are not learned.
    pub not_learned_max: Option<u64>,
    /// Maximum number of ticks from the end of a fault until forecasts are learned again.
    pub learned_within: Option<u64>,
    /// Outages that the report must list.
    pub outages: Vec<Outages>,
    /// Maximum number of restarts of stages that no fault targets.
    pub restarts_of_others: u64,
    /// Replacements that the report must list.
    pub replacements: Vec<Replacements>,
    /// The exact set of stages that must be given up.
    pub given_up: Vec<String>,
    /// Maximum number of files left in shared memory and the run's folder.
    pub leftovers: u64,
    /// Maximum number of missing ticks and forecasts that are not learned without a counted cause.
    pub unexplained: u64,
    /// Causes that forecasts must have.
    pub causes: Vec<String>,
    /// Minimum number of ticks with predicted tracks.
    pub predicted_min: Option<u64>,
    /// Maximum age of a held forecast.
    pub age_ms_max: Option<f64>,
    /// Counters of lost frames that the report must contain.
    pub counted: Vec<Counted>,
    /// Stages that the report must name as starved; "any" for at least one.
    pub starved: Vec<String>,
    /// Minimum number of readers that the report counts as dead. No consumer may end by itself.
    pub dead_readers_min: Option<u64>,
    /// Minimum number of late ticks in the report.
    pub late_ticks_min: Option<u64>,
    /// Maximum growth of the launcher's resident memory, in KiB.
    pub launcher_growth_kib_max: Option<u64>,
    /// Maximum growth of the resident memory of all stages together, in KiB.
    pub stages_growth_kib_max: Option<u64>,
    /// Maximum growth of the launcher's open descriptors.
    pub descriptors_growth_max: Option<u64>,
    /// Maximum growth of the run's file count.
    pub files_growth_max: Option<u64>,
    /// Text that the report must contain as the cause of the run's end.
    pub ended_by: Option<String>,
    /// Required number of promotions of each stage's spare.
    pub promotions: BTreeMap<String, u32>,
}

/// Outages of a stage.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outages {
    pub stage: String,
    /// Text that the cause contains.
    #[serde(default)]
    pub cause: String,
    /// The required number.
    pub count: u64,
}

/// Replacements of a stage.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Replacements {
    pub stage: String,
    /// The required outcome.
    pub outcome: recorder::ReplacementOutcome,
    /// Text that the cause contains.
    #[serde(default)]
    pub cause: String,
    /// The required number.
    pub count: u64,
}

/// A counter of a stage's lost frames.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Counted {
    pub stage: String,
    /// `gap`, `refused` or `restart`, or a cause of refusals such as `check value`.
    pub cause: String,
    /// The count must equal the number of frames on which this kind of fault acted.
    pub as_injected: Option<String>,
    /// Restricts the count to frames of this topic.
    pub topic: Option<String>,
    /// The minimum count.
    pub min: Option<u64>,
    /// The maximum count.
    pub max: Option<u64>,
}
