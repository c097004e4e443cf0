//! The report of a run as data.
//!
//! As JSON (`stgdat run --report FILE`) these top-level keys stay unchanged within a [`REPORT_VERSION`]:
//! `ticks`, `late_ticks`, `drops`, `forecasts {learned, held, kinematic}`, `end_to_end_ms {p50, p99, max}`,
//! `overhead_ms {p50, p99}`, `stages [{name, compute_ms {p50, p99}, budget_ms}]` and `accuracy {ade_m, fde_m,
//! cv_ade_m, cv_fde_m, draws}`. Names end in their units. Shares are 0 to 1. An unknown value is `null`,
//! never NaN.

mod accuracy;
mod forecasts;
mod stages;
mod supervision;
mod verdict;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wire::StageId;

use crate::arrivals::Silences;
use crate::input::{DOUBT, InputReport};
use crate::lanes::LaneCounts;
use crate::sessions::Sessions;
use crate::text::{count, number, percent};
pub use accuracy::{Accuracy, AgentErrors, Errors, WorstForecast};
pub use forecasts::{Agents, ForecastCounts, OutOfDistribution, PriorCounts, Shed};
use stages::RESTARTS;
pub(crate) use stages::restarts;
pub use stages::{PARTNERS, StageDrops, StageReport};
pub use supervision::{
    Outage, Replacement, ReplacementOutcome, SpareReport, StageMemory, Supervision, program_name,
};
pub use verdict::{Status, Verdict};

/// Version of the report's fields.
pub const REPORT_VERSION: u32 = 1;

/// The recorder's measurements of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`REPORT_VERSION`].
    pub version: u32,
    /// Version of the program.
    pub stgdat_version: String,
    /// Whether everything worked, and the faults.
    pub verdict: Verdict,
    /// The data of the run.
    pub run: RunInfo,
    /// Number of ticks whose forecasts were received.
    pub ticks: u64,
    /// Number of ticks whose forecasts were sent later than `late_limit_ms` after their release.
    pub late_ticks: u64,
    /// The tick limit or the frame interval, whichever is smaller.
    pub late_limit_ms: Option<f64>,
    /// Number of lost frames, summed over all stages. `stages` contains them by stage and cause.
    pub drops: u64,
    /// Refused frames by reader, sender and cause.
    #[serde(default)]
    pub refusals: Vec<RefusedFrames>,
    /// Counts of links to other boxes, by stage and kind.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub links: BTreeMap<String, BTreeMap<String, u64>>,
    /// Number of agents left out of full frames, summed over ticks.
    pub agents_left_out: u64,
    /// Number of passages of ticks through stages for which their headers had no room.
    #[serde(default)]
    pub hops_missing: u64,
    /// Number of times that the recorder could not save its state, for instance because the disk was full.
    #[serde(default)]
    pub files_unwritten: u64,
    /// Number of ticks whose stamp was not newer than the stamp of the tick before. Their detections were
    /// refused, or processed as out-of-sequence measurements, and newer forecasts had been published already.
    #[serde(default)]
    pub unpublished_ticks: u64,
    /// The parts of the run in which the stamps have one clock.
    #[serde(default)]
    pub sessions: Sessions,
    /// Times without input from a live source.
    #[serde(default)]
    pub silences: Silences,
    /// The content of the input, and its probable faults.
    #[serde(default)]
    pub input: InputReport,
    /// Agents per tick.
    pub agents: Agents,
    /// Forecasts by quality, and the causes of those that are held or kinematic.
    pub forecasts: ForecastCounts,
    /// Forecasts of agents that are out of distribution.
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
    /// End-to-end latency minus the compute of all stages, over the ticks that passed all stages.
    pub overhead_ms: Percentiles,
    /// Time from the sensor's stamp to the sending of the forecasts, if stamps are Unix time. It is as exact as the
    /// clocks of sensor and computer agree.
    #[serde(default)]
    pub since_stamp_ms: Percentiles,
    /// The stages in the order in which a tick passes them.
    pub stages: Vec<StageReport>,
    /// Errors of the forecasts against the recording's later truth.
    pub accuracy: Accuracy,
    /// The worst ticks, worst first: ticks without forecasts, then ticks with the longest latency.
    #[serde(default)]
    pub worst_ticks: Vec<WorstTick>,
    /// Deaths, restarts and other events of the stages, as observed by the launcher.
    #[serde(default)]
    pub supervision: Supervision,
}

/// One of the worst ticks of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WorstTick {
    /// Number of the tick. For several ticks without forecasts, the number of the first.
    pub tick: u64,
    /// Stamp of the tick. For ticks without forecasts, the stamp of the next tick.
    pub stamp_ns: i64,
    /// Time from the tick's release to the sending of its forecasts; `None` if it has no forecasts.
    pub end_to_end_ms: Option<f64>,
    /// Number of ticks without forecasts; 0 for a tick with forecasts.
    pub ticks_lost: u64,
    /// Number of its forecasts.
    pub agents: u64,
    /// Number of forecasts that are not learned, for a cause other than `young` and `outdone`.
    pub not_learned: u64,
    /// The stage that cost the most time.
    pub stage: Option<String>,
    /// The phase in which it did: `waiting`, `wake-up`, `compute` or `publish`; or `restart`.
    pub phase: Option<String>,
    /// The cause, in a sentence.
    pub cause: String,
}

/// Frames that a stage refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusedFrames {
    /// The stage that refused them.
    pub reader: String,
    /// The stage that sent them, or `unknown`.
    pub sender: String,
    /// The cause: `schema`, `foreign run`, `old incarnation`, `size`, `value`, `order`, `check value`,
    /// `unprotected`, `repeated` or `frozen`.
    pub cause: String,
    /// Number of frames.
    pub frames: u64,
}

/// The data of the run. A value is `None` if the caller does not know it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RunInfo {
    /// Number of the run in hexadecimal, which its recordings have too.
    #[serde(default)]
    pub run_id: Option<String>,
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
    /// The licences of the weights' training data, by data set.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub weights_licences: BTreeMap<String, String>,
    /// Precision of the stages' matrix products, unless all of them use f32.
    pub precision: Option<String>,
    /// Whether the retrieval memory corrects forecasts.
    pub retrieval: Option<bool>,
    /// Number of entries with which the retrieval memory began, if it has a file. They may come from this
    /// recording.
    pub memory_entries: Option<u64>,
    /// Seed of the run.
    pub seed: Option<u64>,
    /// `real` or `max`.
    pub speed: Option<String>,
    /// Limit of the run in ticks.
    pub ticks_limit: Option<u64>,
    /// Number of agents asked for in the generated scene.
    pub scene_agents: Option<u64>,
    /// Noise of the detections of the generated scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene_noise: Option<SceneNoise>,
    /// Frames in the recording.
    pub recorded_frames: Option<u64>,
    /// One frame in this many was played. It is more than 1 if the recording is faster than 12.5 Hz.
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

/// Noise of the detections of a generated scene: standard deviations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneNoise {
    /// Positions on each axis, by type: vehicles, cyclists, pedestrians.
    pub position_m: [f64; 3],
    /// Headings.
    pub heading_deg: f64,
}

/// Percentiles of a time. All are `null` if no time was measured.
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

impl Percentiles {
    /// Whether nothing was measured.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.p50.is_none()
    }

    /// `since the stamp 21.2 / 40.1 ms`: median and 99th percentile; `None` if nothing was measured.
    fn since_the_stamp(&self) -> Option<String> {
        self.p50?;
        Some(format!("since the stamp {} / {} ms", number(self.p50).trim(), number(self.p99).trim()))
    }
}

/// Why a report file could not be written or read.
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
    /// The file does not contain a report of this version.
    #[error("{path}: not a report: {source}")]
    Format {
        /// The report's path.
        path: String,
        /// The place in the file and the reason.
        source: serde_json::Error,
    },
}

impl RunInfo {
    /// The data sets of the weights whose licences forbid commercial use.
    pub(crate) fn non_commercial_data(&self) -> impl Iterator<Item = &str> {
        let forbids = |licence: &str| licence.contains("non-commercial") || licence.contains("-NC");
        let data = self.weights_licences.iter().filter(move |(_, licence)| forbids(licence));
        data.map(|(name, _)| name.as_str())
    }
}

impl Report {
    /// The report as indented JSON, ending with a line feed.
    ///
    /// # Panics
    /// Never: JSON can represent every report.
    #[must_use]
    pub fn to_json(&self) -> String {
        let mut json =
            serde_json::to_string_pretty(self).expect("names are strings, numbers are finite or null");
        json.push('\n');
        json
    }

    /// The counts of a stage's link to other boxes or to ROS 2, if it has one.
    #[must_use]
    pub fn link_line(&self, stage: &str) -> Option<String> {
        let counts = self.links.get(stage)?.iter();
        let counts = counts.map(|(kind, value)| format!("{kind} {}", count(*value)));
        let times = self.stages.iter().filter(|of| of.name == stage);
        let times = times.filter_map(|of| of.since_stamp_ms.since_the_stamp());
        Some(counts.chain(times).collect::<Vec<_>>().join(", "))
    }

    /// The meaning of an OK, in lines.
    #[must_use]
    pub fn ok_lines(&self) -> Vec<String> {
        let ticks = if self.run.lockstep == Some(true) { "forecast" } else { "in time" };
        let ok = format!("every tick {ticks}, nothing lost");
        match self.forecasts.constant_velocity_share.filter(|share| *share > 0.0) {
            None => vec![format!("{ok}, no fallback but of young tracks")],
            share => {
                let share = percent(share);
                vec![ok, format!("constant velocity: {} of the forecasts: its error was lower", share.trim())]
            }
        }
    }

    /// Completes the report with the launcher's observations. The verdict then begins with the reason for the
    /// end of the run and with stages that the launcher gave up on.
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
        // Restarts that no heartbeat has reported.
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

    /// Subtracts replacements, and starts before the run had begun, from the restarts that the recorder has
    /// counted by incarnations.
    fn without_replacements(&mut self) {
        let outcomes = self.supervision.replacements.iter();
        let outcomes: Vec<_> = outcomes.map(|of| (of.outage.stage.clone(), of.outcome)).collect();
        let early = self.supervision.early_starts;
        if outcomes.is_empty() && early == 0 {
            return;
        }
        for stage in self.stages.iter_mut().filter(|stage| stage.name == StageId::Source.name()) {
            stage.restarts = stage.restarts.saturating_sub(early);
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

    /// Completes the report with the information about the recording. Its doubts are last in the verdict.
    pub fn audited(&mut self, recording: &InputReport) {
        self.input.add(recording);
        self.sessions.name_steps(&mut self.input);
        self.verdict.reasons.retain(|reason| !reason.starts_with(DOUBT));
        self.verdict.reasons.extend(self.doubts());
        self.verdict.settle();
    }

    /// Puts the present state of the input before the reasons, for a run in progress.
    pub(crate) fn now(&mut self, state: Option<&str>) {
        if let Some(state) = state {
            self.verdict.reasons.insert(0, state.to_owned());
            self.verdict.settle();
        }
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

    /// Writes the report as JSON. The file is written atomically.
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
    /// [`ReportError`] with the path, and the position of the fault in the file.
    pub fn read(path: &std::path::Path) -> Result<Self, ReportError> {
        let shown = || path.display().to_string();
        let json = std::fs::read(path).map_err(|source| ReportError::File { path: shown(), source })?;
        serde_json::from_slice(&json).map_err(|source| ReportError::Format { path: shown(), source })
    }
}
