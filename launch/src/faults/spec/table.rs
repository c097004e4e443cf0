//! The specification as written. Values that can be wrong have their span in the text.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Deserialize;
use toml::Spanned;

use super::Resource;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    pub shows: String,
    pub run: RunTable,
    #[serde(rename = "fault", default)]
    pub faults: Vec<Spanned<FaultTable>>,
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

/// A fault with the keys of all kinds. The check decides which keys a kind may have.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FaultTable {
    pub kind: Spanned<String>,
    pub stage: Option<Spanned<String>>,
    pub topic: Option<Spanned<String>>,
    pub at: Option<Spanned<At>>,
    pub after_start_ms: Option<Spanned<u64>>,
    pub within_ms: Option<Spanned<[u64; 2]>>,
    pub stages: Option<Spanned<Vec<String>>>,
    pub count: Option<Spanned<u64>>,
    pub point: Option<Spanned<String>>,
    pub for_ms: Option<Spanned<u64>>,
    pub ticks: Option<Spanned<[u64; 2]>>,
    pub probability: Option<Spanned<f64>>,
    pub seed: Option<Spanned<u64>>,
    pub delay_ms: Option<Spanned<u64>>,
    pub jitter_ms: Option<Spanned<u64>>,
    pub jump_ms: Option<Spanned<i64>>,
    pub bits: Option<Spanned<u32>>,
    pub r#in: Option<Spanned<String>>,
    pub hold_ms: Option<Spanned<u64>>,
    pub resource: Option<Spanned<Resource>>,
    pub value: Option<Spanned<u64>>,
    pub exit_code: Option<Spanned<u8>>,
    pub command: Option<Spanned<Vec<String>>>,
    pub threads: Option<Spanned<usize>>,
}

/// One tick or several.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum At {
    One(u64),
    Many(Vec<u64>),
}

impl FaultTable {
    /// Returns the keys that are set in addition to `kind`, with the spans of their values.
    pub fn keys(&self) -> Vec<(&'static str, std::ops::Range<usize>)> {
        macro_rules! spans {
            ($($key:literal $field:ident),*) => {
                [$(self.$field.as_ref().map(|value| ($key, value.span()))),*]
            };
        }
        let spans = spans!(
            "stage" stage, "topic" topic, "at" at, "after_start_ms" after_start_ms,
            "within_ms" within_ms, "stages" stages, "count" count, "point" point,
            "for_ms" for_ms, "ticks" ticks, "probability" probability, "seed" seed, "delay_ms" delay_ms,
            "jitter_ms" jitter_ms, "jump_ms" jump_ms, "bits" bits, "in" r#in, "hold_ms" hold_ms,
            "resource" resource, "value" value, "exit_code" exit_code, "command" command, "threads" threads
        );
        spans.into_iter().flatten().collect()
    }
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
    /// The stage.
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
    /// The stage.
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
    /// The stage.
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
