//! The report of a run as data.
//!
//! As JSON (`stgdat run --report FILE`) these top-level keys stay as they are within a [`REPORT_VERSION`]:
//! `ticks`, `late_ticks`, `drops`, `forecasts {learned, held, kinematic}`, `end_to_end_ms {p50, p99, max}`,
//! `overhead_ms {p50, p99}`, `stages [{name, compute_ms {p50, p99}, budget_ms}]` and
//! `accuracy {ade_m, fde_m, cv_ade_m, cv_fde_m, draws}`. Units end the names; shares are 0 to 1; what is
//! unknown is `null`, never NaN.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::input::{DOUBT, InputReport};
use crate::lanes::LaneCounts;
use crate::text::percent;

/// Version of the report's fields.
pub const REPORT_VERSION: u32 = 1;

/// What the recorder measured of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`REPORT_VERSION`].
    pub version: u32,
    /// Version of the program.
    pub stgdat_version: String,
    /// Whether everything worked, and what did not.
    pub verdict: Verdict,
    /// What was run.
    pub run: RunInfo,
    /// Ticks whose forecasts were received.
    pub ticks: u64,
    /// Ticks whose forecasts were sent later than `late_limit_ms` after their release.
    pub late_ticks: u64,
    /// The tick limit or the frame interval, whichever is shorter.
    pub late_limit_ms: Option<f64>,
    /// Frames lost, summed over all stages; `stages` has them by stage and cause.
    pub drops: u64,
    /// Refused frames by reader, sender and cause.
    #[serde(default)]
    pub refusals: Vec<RefusedFrames>,
    /// Agents left out of full frames, summed over ticks.
    pub agents_left_out: u64,
    /// Passages of ticks through stages for which their headers had no room.
    #[serde(default)]
    pub hops_missing: u64,
    /// What the input contained, and what is probably wrong with it.
    #[serde(default)]
    pub input: InputReport,
    /// Agents per tick.
    pub agents: Agents,
    /// Forecasts by quality, and the causes of those that are held or kinematic.
    pub forecasts: ForecastCounts,
    /// Forecasts of agents that move as none did in training.
    #[serde(default)]
    pub out_of_distribution: OutOfDistribution,
    /// Forecasts of vehicles on the map of lanes.
    #[serde(default)]
    pub lanes: LaneCounts,
    /// Track states by the prior that predicted them.
    #[serde(default)]
    pub priors: PriorCounts,
    /// Time from release at the source to the sending of the forecasts.
    pub end_to_end_ms: Percentiles,
    /// End to end less the compute of all stages, over the ticks that passed them all.
    pub overhead_ms: Percentiles,
    /// The stages in the order in which a tick passes them.
    pub stages: Vec<StageReport>,
    /// Errors of the forecasts against the recording's later truth.
    pub accuracy: Accuracy,
    /// The worst ticks, the worst first: those without forecasts, then those with the longest latency.
    #[serde(default)]
    pub worst_ticks: Vec<WorstTick>,
    /// Deaths, restarts and other events of the stages, as the launcher saw them.
    #[serde(default)]
    pub supervision: Supervision,
}

/// One of the worst ticks of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WorstTick {
    /// Its number; of several ticks without forecasts, the first.
    pub tick: u64,
    /// Its stamp; of ticks without forecasts, that of the next tick.
    pub stamp_ns: i64,
    /// From its release to the sending of its forecasts; none without forecasts.
    pub end_to_end_ms: Option<f64>,
    /// Ticks without forecasts; 0 for a tick with forecasts.
    pub ticks_lost: u64,
    /// Its forecasts.
    pub agents: u64,
    /// Those that are not learned for another cause than `young` and `outdone`.
    pub not_learned: u64,
    /// The stage that cost most.
    pub stage: Option<String>,
    /// The phase in which it did: `waiting`, `wake-up`, `compute` or `publish`; or `restart`.
    pub phase: Option<String>,
    /// What happened, in a sentence.
    pub cause: String,
}

/// Frames that a stage refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusedFrames {
    /// The stage that refused them.
    pub reader: String,
    /// The stage that sent them, or `unknown`.
    pub sender: String,
    /// Why: `schema`, `foreign run`, `old incarnation`, `size`, `value`, `order`, `check value`,
    /// `unprotected`, `repeated` or `frozen`.
    pub cause: String,
    /// How many.
    pub frames: u64,
}

/// What the launcher saw of the stages.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Supervision {
    /// What ended the run before its time; none where the recording ended or a signal asked for it.
    pub ended_by: Option<String>,
    /// Stages that were given up for good, with the reason.
    pub given_up: BTreeMap<String, String>,
    /// Each death of a stage after which it was started again.
    pub outages: Vec<Outage>,
    /// Outages beyond those listed.
    pub outages_unlisted: u64,
    /// How often a stage got no CPU for longer than its `hang_after`, by stage.
    pub starved: BTreeMap<String, u64>,
    /// Settings of pipeline.toml that the system did not allow.
    pub notes: Vec<String>,
    /// Page faults and memory of each stage.
    pub memory: BTreeMap<String, StageMemory>,
    /// Stages that were replaced while the run went on, or were to be.
    pub replacements: Vec<Replacement>,
    /// Replacements beyond those listed.
    pub replacements_unlisted: u64,
    /// The spares, by stage.
    pub spares: BTreeMap<String, SpareReport>,
    /// Processes that read topics, were no stages, and have died. Their places on the topics were given back.
    pub dead_readers: u64,
}

/// The spare of a stage: a process that waits to take its place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SpareReport {
    /// What it did in the end: `ready`, `starting`, `waiting` or `given up`.
    pub state: String,
    /// Times that it took the stage's place after a death.
    pub promotions: u32,
    /// Times that it died while it waited.
    pub deaths: u32,
    /// Why it was given up, if it was.
    pub given_up: Option<String>,
    /// Time from its start until it was ready.
    pub warm_up_ms: Option<f64>,
    /// Memory of its own that lies in RAM, at the last look.
    pub memory_kib: u64,
    /// Memory that it shares with others.
    pub shared_kib: u64,
}

/// Memory of a stage's newest process, after its first ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageMemory {
    /// Ticks in which its faults were counted.
    pub ticks: u64,
    /// Page faults that needed no file or swap.
    pub minor_faults: u64,
    /// Page faults that had to read.
    pub major_faults: u64,
    /// Resident memory.
    pub resident_kib: u64,
    /// How much of it is locked.
    pub locked_kib: u64,
}

/// A stage that was replaced while the run went on, or was to be.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Replacement {
    /// The new program with its arguments; empty for the built-in one.
    pub command: Vec<String>,
    /// What came of it.
    pub outcome: ReplacementOutcome,
    /// Time from the start of the new process until it was ready.
    pub warm_up_ms: Option<f64>,
    /// Time from the request to the old process to end until the new one was told to begin.
    pub hand_over_ms: Option<f64>,
    /// The ticks from the hand-over until the forecasts are learned again, by the incarnation that stays; its
    /// `cause` is why the new one is not used.
    #[serde(flatten)]
    pub outage: Outage,
}

/// What came of a replacement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReplacementOutcome {
    /// The new process is linked, and stays.
    Replaced,
    /// The new process failed before its turn: the old one went on, untouched.
    #[default]
    NotUsed,
    /// The new process failed after its turn: the old program was started again.
    RolledBack,
}

impl ReplacementOutcome {
    /// In words.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Replaced => "replaced",
            Self::NotUsed => "not used",
            Self::RolledBack => "rolled back",
        }
    }

    /// Incarnations of the stage that were no restarts: the new process, and the old program after it.
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
    /// The program, as a person would call it.
    #[must_use]
    pub fn program(&self) -> String {
        program_name(&self.command)
    }
}

/// A command as a person would call it: "the built-in one" where it is empty.
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
    /// How the one before ended.
    pub cause: String,
    /// Number of the newest tick with forecasts when its death was noticed.
    pub tick: u64,
    /// Ticks without forecasts.
    pub ticks_lost: u64,
    /// Ticks with forecasts that are not learned through a fault.
    pub ticks_not_learned: u64,
    /// Ticks of predicted tracks: their detections are missing.
    pub ticks_predicted: u64,
    /// Ticks from its end until forecasts are learned again; none where the run ended before.
    pub ticks_to_learned: Option<u64>,
    /// Whether its spare took its place.
    #[serde(default)]
    pub by_spare: bool,
}

/// Status of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Every tick in time, nothing lost, every forecast learned once its agent was old enough.
    Ok,
    /// As `ok`, but the input is doubtful: a finding of the audit concerns more than [`audit::DOUBT_SHARE`]
    /// of its rows.
    Doubtful,
    /// Forecasts were received, but some were late, lost or not learned.
    Degraded,
    /// No agent was forecast in any tick.
    #[default]
    Empty,
}

/// The status of a run, and why it is not `ok`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verdict {
    /// The status.
    pub status: Status,
    /// What went wrong, the worst first.
    pub reasons: Vec<String>,
}

impl Verdict {
    /// The verdict for these reasons. A fault of the run counts more than a doubt about its input.
    #[must_use]
    pub fn new(is_empty: bool, reasons: Vec<String>) -> Self {
        let mut verdict = Self { status: if is_empty { Status::Empty } else { Status::Ok }, reasons };
        verdict.settle();
        verdict
    }

    /// Finds the status again after the reasons have changed.
    fn settle(&mut self) {
        self.status = match self.status {
            Status::Empty => Status::Empty,
            _ if self.reasons.is_empty() => Status::Ok,
            _ if self.reasons.iter().all(|reason| reason.starts_with(DOUBT)) => Status::Doubtful,
            _ => Status::Degraded,
        };
    }
}

/// What was run; `None` where the caller does not know.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RunInfo {
    /// Name of the recording or generated scene.
    pub recording: Option<String>,
    /// SHA-256 of the recording's files.
    pub recording_sha256: Option<String>,
    /// Whether the weights were trained on this recording.
    pub seen_in_training: Option<bool>,
    /// Name of the weights.
    pub weights: Option<String>,
    /// SHA-256 of the weights.
    pub weights_sha256: Option<String>,
    /// In which precision the stages multiply, where not all of them do so in f32.
    pub precision: Option<String>,
    /// Whether the retrieval memory corrects forecasts.
    pub retrieval: Option<bool>,
    /// Entries that the retrieval memory began with, where it has a file: they may be of this recording.
    pub memory_entries: Option<u64>,
    /// Seed of the run.
    pub seed: Option<u64>,
    /// `real` or `max`.
    pub speed: Option<String>,
    /// Limit of the run in ticks.
    pub ticks_limit: Option<u64>,
    /// Number of agents asked for in the generated scene.
    pub scene_agents: Option<u64>,
    /// Frames in the recording.
    pub recorded_frames: Option<u64>,
    /// One frame in this many was played: more than 1 where the recording is faster than 12.5 Hz.
    pub thinned_by: Option<u32>,
    /// Interval between frames.
    pub interval_ms: Option<f64>,
    /// Time between the first and the last stamp.
    pub played_s: Option<f64>,
    /// Time between the first and the last release.
    pub elapsed_s: Option<f64>,
    /// Whether the source waited for the forecasts of each tick before it released the next.
    pub lockstep: Option<bool>,
}

/// Agents forecast per tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Agents {
    /// Mean over all ticks.
    pub mean: Option<f64>,
    /// Maximum over all ticks.
    pub max: Option<u64>,
}

/// Forecasts of single agents by quality.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForecastCounts {
    /// Forecast by the model at the same tick.
    pub learned: u64,
    /// Forecast by the model at an earlier tick and shifted in time.
    pub held: u64,
    /// Constant control.
    pub kinematic: u64,
    /// Forecasts that are held or kinematic by cause: `late`, `rejected`, `missing`, `shed`, or `young` and
    /// `outdone`, which are no fault.
    pub causes: BTreeMap<String, u64>,
    /// Forecasts that are held or kinematic through a fault: for another cause than `young` and `outdone`.
    #[serde(default)]
    pub not_learned: u64,
    /// Share of the forecasts that are constant velocity because it proved better.
    #[serde(default)]
    pub constant_velocity_share: Option<f64>,
    /// Ticks with a forecast that is not learned through a fault.
    pub degraded_ticks: u64,
    /// Ticks of predicted tracks: their detections are missing.
    #[serde(default)]
    pub predicted_ticks: u64,
    /// Agents of which nothing was said, by the policy of degradation, summed over ticks.
    #[serde(default)]
    pub silent: u64,
    /// Greatest age of a held forecast.
    pub age_ms_max: Option<f64>,
    /// What was left out because ticks had no time for all agents.
    #[serde(default)]
    pub shed: Shed,
}

/// Agents that were left out of ticks that had no time for all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shed {
    /// Agents left out, summed over ticks.
    pub forecasts: u64,
    /// Ticks that left out any.
    pub ticks: u64,
    /// Share of all forecasts.
    pub share: Option<f64>,
    /// Most agents that a tick left out.
    pub agents_max: u64,
    /// Greatest age of the forecast that stands for one left out.
    pub age_ms_max: Option<f64>,
}

impl ForecastCounts {
    /// The counts with the names of their qualities.
    #[must_use]
    pub const fn by_quality(&self) -> [(&'static str, u64); 3] {
        [("learned", self.learned), ("held", self.held), ("kinematic", self.kinematic)]
    }
}

/// Forecasts whose out-of-distribution measure says that the network adds less than half of what it would.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OutOfDistribution {
    /// Forecasts beyond what was trained.
    pub forecasts: u64,
    /// The highest measure.
    pub measure_max: Option<f64>,
    /// The highest speed among them.
    pub speed_mps_max: Option<f64>,
}

/// Track states by the prior that predicted them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PriorCounts {
    /// A forecast of an earlier tick, at most a step old.
    pub learned: u64,
    /// An older forecast.
    pub held: u64,
    /// The kinematic prior: the process model alone.
    pub kinematic: u64,
}

/// Percentiles of a time; all `null` where none was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Median.
    pub p50: Option<f64>,
    /// 99th percentile.
    pub p99: Option<f64>,
    /// 99.9th percentile, from 10,000 values up.
    pub p999: Option<f64>,
    /// Maximum.
    pub max: Option<f64>,
}

/// Times and losses of one stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageReport {
    /// The stage's name.
    pub name: String,
    /// Its share of the tick limit of 80 ms.
    pub budget_ms: Option<f64>,
    /// Median of compute over budget.
    pub budget_share_p50: Option<f64>,
    /// 99th percentile of compute over budget.
    pub budget_share_p99: Option<f64>,
    /// Time in which the input was there, but the stage was busy or waited for other input.
    pub waiting_ms: Percentiles,
    /// Transport, scheduling and the check of the frame.
    pub wake_up_ms: Percentiles,
    /// Computation.
    pub compute_ms: Percentiles,
    /// Writing the header and sending the output.
    pub publish_ms: Percentiles,
    /// Ticks that passed the stage on their way to the forecast.
    pub ticks: u64,
    /// Ticks whose compute exceeded the budget.
    pub late_ticks: u64,
    /// Frames lost in this stage, by cause: `gap` (never arrived: the queue was full or the sender had ended)
    /// and `refused` (invalid content). A frame counts only in the stage that lost it first. `unanswered` is
    /// part of these.
    pub drops: StageDrops,
    /// Number of restarts after a death.
    pub restarts: u32,
    /// Times that it was replaced while the run went on.
    #[serde(default)]
    pub replacements: u32,
}

/// What the reason of a verdict begins with that counts restarts.
const RESTARTS: &str = "restarts: ";

/// The restarts of all stages as a reason of the verdict; none where there were none.
pub(crate) fn restarts(stages: &[StageReport]) -> Option<String> {
    let all: u32 = stages.iter().map(|stage| stage.restarts).sum();
    let named = stages.iter().filter(|stage| stage.restarts > 0);
    let named: Vec<String> = named.map(|stage| format!("{} {}", stage.name, stage.restarts)).collect();
    (all > 0).then(|| format!("{RESTARTS}{all} ({})", named.join(", ")))
}

/// Frames lost in one stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageDrops {
    /// Never arrived.
    pub gap: u64,
    /// Ticks of which the frame that begins a step never arrived or was refused whole: the stage has sent
    /// nothing for them. They are part of the others.
    #[serde(default)]
    pub unanswered: u64,
    /// Arrived and were refused.
    pub refused: u64,
    /// Ticks without forecasts because the stage had died; of the recorder: ticks that it did not record.
    #[serde(default)]
    pub restart: u64,
}

impl StageDrops {
    /// All causes together.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.gap + self.refused + self.restart
    }
}

/// Accuracy of the forecasts as published, against the recording's later truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Errors of all forecasts.
    #[serde(flatten)]
    pub errors: Errors,
    /// Most modes of a forecast, K.
    pub draws: Option<u32>,
    /// Time from the stamp to the last step.
    pub horizon_s: Option<f64>,
    /// A forecast whose last position is farther from the truth is a miss.
    pub miss_radius_m: f64,
    /// Errors of the learned forecasts alone.
    pub learned: Errors,
    /// Errors by agent type.
    pub by_type: BTreeMap<String, Errors>,
    /// Errors of each agent, by its identity in the truth.
    #[serde(default)]
    pub agents: Vec<AgentErrors>,
    /// Agents beyond those listed.
    #[serde(default)]
    pub agents_unlisted: u64,
    /// Forecasts whose agent has no truth for the whole horizon: it left the scene, or the run ended.
    pub uncovered: u64,
    /// Forecasts that match no agent of the truth: false alarms, or no truth near.
    pub unmatched: u64,
}

/// Errors of the forecasts of one agent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AgentErrors {
    /// Its identity in the truth.
    pub agent: u64,
    /// Its type, as it was forecast last.
    #[serde(rename = "type")]
    pub agent_type: String,
    /// Forecasts compared.
    pub forecasts: u64,
    /// minADE_K.
    pub ade_m: Option<f64>,
    /// minFDE_K.
    pub fde_m: Option<f64>,
    /// The forecast whose best mode ends farthest from the truth.
    pub worst: WorstForecast,
}

/// The worst forecast of an agent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WorstForecast {
    /// Its tick.
    pub tick: u64,
    /// The tick's stamp.
    pub stamp_ns: i64,
    /// Where the agent was.
    pub x_m: f32,
    /// Where the agent was.
    pub y_m: f32,
    /// minFDE_K of this forecast.
    pub fde_m: f64,
}

/// Errors of a group of forecasts, and those of constant velocity for the same agents.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Forecasts compared.
    pub forecasts: u64,
    /// minADE_K: mean distance over the horizon of each forecast's best mode.
    pub ade_m: Option<f64>,
    /// minFDE_K: distance at the end of the horizon of each forecast's best mode.
    pub fde_m: Option<f64>,
    /// Miss rate: share of forecasts none of whose modes ends within the miss radius.
    pub miss_rate: Option<f64>,
    /// ADE of the single best forecast (K = 1).
    pub single_ade_m: Option<f64>,
    /// FDE of the single best forecast.
    pub single_fde_m: Option<f64>,
    /// Miss rate of the single best forecast.
    pub single_miss_rate: Option<f64>,
    /// ADE of constant velocity.
    pub cv_ade_m: Option<f64>,
    /// FDE of constant velocity.
    pub cv_fde_m: Option<f64>,
    /// Miss rate of constant velocity.
    pub cv_miss_rate: Option<f64>,
    /// Share of the regions of 50 % at the end of the horizon that held the truth.
    #[serde(default)]
    pub held_50: Option<f64>,
    /// Share of the regions of 90 % that held it.
    #[serde(default)]
    pub held_90: Option<f64>,
}

/// A report file could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The file can't be read or written.
    #[error("{path}: {source}")]
    File {
        /// The report's path.
        path: String,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file holds no report of this version.
    #[error("{path}: not a report: {source}")]
    Format {
        /// The report's path.
        path: String,
        /// The place in the file and the reason.
        source: serde_json::Error,
    },
}

impl Report {
    /// The report as indented JSON, ending with a line feed.
    ///
    /// # Panics
    /// Never: the report holds nothing that JSON can't.
    #[must_use]
    pub fn to_json(&self) -> String {
        let mut json =
            serde_json::to_string_pretty(self).expect("names are strings, numbers are finite or null");
        json.push('\n');
        json
    }

    /// What an OK means, in lines.
    #[must_use]
    pub fn ok_lines(&self) -> Vec<String> {
        let ticks = if self.run.lockstep == Some(true) { "forecast" } else { "in time" };
        let ok = format!("every tick {ticks}, nothing lost");
        match self.forecasts.constant_velocity_share.filter(|share| *share > 0.0) {
            None => vec![format!("{ok}, no fallback but of young tracks")],
            share => {
                let share = percent(share);
                vec![ok, format!("constant velocity: {} of the forecasts, as it proved better", share.trim())]
            }
        }
    }

    /// Completes the report with what the launcher saw; the verdict begins with what ended the run, and with
    /// stages that were given up.
    pub fn supervised(&mut self, supervision: Supervision) {
        let mut reasons = Vec::new();
        if let Some(ended_by) = &supervision.ended_by {
            reasons.push(format!("ended before its time: {ended_by}"));
        }
        for (stage, why) in &supervision.given_up {
            reasons.push(format!("the {stage} was given up: {why}"));
        }
        for Replacement { outcome, outage, .. } in &supervision.replacements {
            if *outcome == ReplacementOutcome::RolledBack {
                let Outage { stage, cause, .. } = outage;
                reasons.push(format!("the replacement of the {stage} was rolled back: it {cause}"));
            }
        }
        // Restarts of which no heartbeat told.
        for outage in &supervision.outages {
            if !self.stages.iter().any(|stage| stage.name == outage.stage) {
                self.stages.push(StageReport { name: outage.stage.clone(), ..StageReport::default() });
            }
            for stage in self.stages.iter_mut().filter(|stage| stage.name == outage.stage) {
                stage.restarts = stage.restarts.max(outage.incarnation);
            }
        }
        self.verdict.reasons.splice(0..0, reasons);
        self.verdict.settle();
        self.supervision = supervision;
        self.without_replacements();
    }

    /// Takes back what the recorder has counted as restarts, by their incarnations, and were replacements.
    fn without_replacements(&mut self) {
        let outcomes = self.supervision.replacements.iter();
        let outcomes: Vec<_> = outcomes.map(|of| (of.outage.stage.clone(), of.outcome)).collect();
        if outcomes.is_empty() {
            return;
        }
        for (name, outcome) in outcomes {
            for stage in self.stages.iter_mut().filter(|stage| stage.name == name) {
                stage.restarts = stage.restarts.saturating_sub(outcome.incarnations());
                stage.replacements += u32::from(outcome == ReplacementOutcome::Replaced);
            }
        }
        let place = self.verdict.reasons.iter().position(|reason| reason.starts_with(RESTARTS));
        if let Some(place) = place {
            self.verdict.reasons.splice(place..=place, restarts(&self.stages));
        }
        self.verdict.settle();
    }

    /// Completes the report with what is known of the recording: its doubts come last in the verdict.
    pub fn audited(&mut self, recording: &InputReport) {
        self.input.add(recording);
        self.verdict.reasons.retain(|reason| !reason.starts_with(DOUBT));
        self.verdict.reasons.extend(self.doubts());
        self.verdict.settle();
    }

    /// The reasons of the verdict that are doubts about the input and about the map of lanes.
    pub(crate) fn doubts(&self) -> Vec<String> {
        self.input.reasons().chain(self.lanes.reason()).collect()
    }

    /// Whether `--strict` refuses the run: the input is doubtful, or no agent was forecast.
    #[must_use]
    pub fn is_doubtful(&self) -> bool {
        self.verdict.status == Status::Empty || !self.doubts().is_empty()
    }

    /// Writes the report as JSON. The file appears whole or not at all.
    ///
    /// # Errors
    /// [`ReportError::File`] with the path.
    pub fn write(&self, path: &std::path::Path) -> Result<(), ReportError> {
        crate::whole_file::write(path, self.to_json().as_bytes())
            .map_err(|source| ReportError::File { path: path.display().to_string(), source })
    }

    /// Reads a report written by [`Report::write`].
    ///
    /// # Errors
    /// [`ReportError`] with the path, and the place in the file where its content is at fault.
    pub fn read(path: &std::path::Path) -> Result<Self, ReportError> {
        let shown = || path.display().to_string();
        let json = std::fs::read(path).map_err(|source| ReportError::File { path: shown(), source })?;
        serde_json::from_slice(&json).map_err(|source| ReportError::Format { path: shown(), source })
    }
}
