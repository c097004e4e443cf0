//! What the launcher observed of the stages: outages, replacements, spares and memory.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// The launcher's observations of the stages.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Supervision {
    /// The reason why the run ended early; `None` if the recording ended or a signal asked for the end.
    pub ended_by: Option<String>,
    /// Stages that the launcher has given up on, with the reason.
    pub given_up: BTreeMap<String, String>,
    /// Each death of a stage that was followed by a restart.
    pub outages: Vec<Outage>,
    /// Number of outages that are not listed.
    pub outages_unlisted: u64,
    /// Number of times that a stage got no CPU for longer than its `hang_after`, by stage.
    pub starved: BTreeMap<String, u64>,
    /// Settings of pipeline.toml that the system did not allow.
    pub notes: Vec<String>,
    /// Page faults and memory of each stage.
    pub memory: BTreeMap<String, StageMemory>,
    /// Stages that were replaced during the run, or should have been.
    pub replacements: Vec<Replacement>,
    /// Number of replacements that are not listed.
    pub replacements_unlisted: u64,
    /// The spares, by stage.
    pub spares: BTreeMap<String, SpareReport>,
    /// Number of times that the detector was not ready before the run had begun. These are not restarts.
    pub early_starts: u32,
    /// Number of processes other than stages that read topics and have died. Their places on the topics were
    /// released.
    pub dead_readers: u64,
    /// Numbers of lines that are missing in the log, by stage and for `launcher`. A stage printed too many, or
    /// nobody read the log.
    pub lost_lines: BTreeMap<String, u64>,
    /// Processes that were left behind at the end because they could not be killed, by stage.
    pub not_ended: BTreeMap<String, u32>,
}

/// The spare of a stage: a process that waits to take the stage's place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SpareReport {
    /// Final state: `ready`, `starting`, `waiting` or `given up`.
    pub state: String,
    /// Number of times that it took the stage's place after a death.
    pub promotions: u32,
    /// Number of times that it died while it waited.
    pub deaths: u32,
    /// Why the launcher gave up on it, if it did.
    pub given_up: Option<String>,
    /// Time from its start until it was ready.
    pub warm_up_ms: Option<f64>,
    /// Private resident memory at the last check.
    pub memory_kib: u64,
    /// Memory that is shared with other processes.
    pub shared_kib: u64,
}

/// Memory of a stage's newest process, after its first ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageMemory {
    /// Number of ticks in which its faults were counted.
    pub ticks: u64,
    /// Number of page faults that needed no file or swap.
    pub minor_faults: u64,
    /// Number of page faults that had to read.
    pub major_faults: u64,
    /// Resident memory.
    pub resident_kib: u64,
    /// Locked part of the resident memory.
    pub locked_kib: u64,
}

/// A stage that was replaced during the run, or should have been.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Replacement {
    /// The new program with its arguments; empty for the built-in one.
    pub command: Vec<String>,
    /// The outcome.
    pub outcome: ReplacementOutcome,
    /// Time from the start of the new process until it was ready.
    pub warm_up_ms: Option<f64>,
    /// Time from the request that the old process end until the new one was told to begin.
    pub hand_over_ms: Option<f64>,
    /// The ticks from the hand-over until the incarnation that stays makes learned forecasts again. `cause`
    /// states why the new one is not used.
    #[serde(flatten)]
    pub outage: Outage,
}

wire::named! {
    /// The outcome of a replacement.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum ReplacementOutcome {
        /// The new process is linked and stays.
        Replaced => "replaced",
        /// The new process failed before its turn. The old process continued unchanged.
        #[default]
        NotUsed => "not used",
        /// The new process failed after its turn. The old program was started again.
        RolledBack => "rolled back",
    }
}

impl ReplacementOutcome {
    /// Number of the stage's incarnations that were not restarts: the new process, and the old program after
    /// it.
    #[must_use]
    pub const fn incarnations(self) -> u32 {
        match self {
            Self::Replaced => 1,
            Self::NotUsed => 0,
            Self::RolledBack => 2,
        }
    }
}

impl Replacement {
    /// The program as text for people.
    #[must_use]
    pub fn program(&self) -> String {
        program_name(&self.command)
    }
}

/// A command as text for people: "the built-in one" if it is empty.
#[must_use]
pub fn program_name(command: &[String]) -> String {
    if command.is_empty() { "the built-in one".to_owned() } else { command.join(" ") }
}

/// The time from a death of a stage until the forecasts are learned again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Outage {
    /// The stage.
    pub stage: String,
    /// The incarnation that takes over.
    pub incarnation: u32,
    /// How the previous incarnation ended.
    pub cause: String,
    /// Number of the newest tick with forecasts when the death was noticed.
    pub tick: u64,
    /// Number of ticks without forecasts.
    pub ticks_lost: u64,
    /// Number of ticks with forecasts that are not learned because of a fault.
    pub ticks_not_learned: u64,
    /// Number of ticks with predicted tracks. Their detections are missing.
    pub ticks_predicted: u64,
    /// Number of ticks from its end until forecasts are learned again; `None` if the run ended before.
    pub ticks_to_learned: Option<u64>,
    /// Whether a spare took its place.
    #[serde(default)]
    pub by_spare: bool,
}
