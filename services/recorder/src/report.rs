//! What a run was like: the report as data.
//!
//! As JSON (`stgdat run --report FILE`) these top-level keys stay as they are within a [`REPORT_VERSION`]: `ticks`,
//! `late_ticks`, `drops`, `forecasts {learned, held, kinematic}`, `end_to_end_ms {p50, p99, max}`,
//! `overhead_ms {p50, p99}`, `stages [{name, compute_ms {p50, p99}, budget_ms}]` and
//! `accuracy {ade_m, fde_m, cv_ade_m, cv_fde_m, draws}`. Units end the names; shares are 0 to 1; what is unknown is
//! `null`, never NaN.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Version of the report's fields.
pub const REPORT_VERSION: u32 = 1;

/// All that the recorder learned of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// [`REPORT_VERSION`].
    pub version: u32,
    /// Version of the program.
    pub stgdat_version: String,
    /// Whether all went as it should, and if not, why.
    pub verdict: Verdict,
    /// What was run.
    pub run: RunInfo,
    /// Ticks whose forecasts came.
    pub ticks: u64,
    /// Ticks whose forecasts came later than `late_limit_ms` after their release.
    pub late_ticks: u64,
    /// The tick limit or the frame interval, whichever is shorter.
    pub late_limit_ms: Option<f64>,
    /// Frames lost on their way, all stages together; `stages` tells where and why.
    pub drops: u64,
    /// Agents that found no room in a full frame, summed over ticks.
    pub agents_left_out: u64,
    /// Agents per tick.
    pub agents: Agents,
    /// Forecasts by quality, and why some were not learned.
    pub forecasts: ForecastCounts,
    /// What moved the states of their tracks to each tick.
    #[serde(default)]
    pub priors: PriorCounts,
    /// From release at the source to the sending of the forecasts.
    pub end_to_end_ms: Percentiles,
    /// End to end less the compute of all stages, over the ticks that passed them all.
    pub overhead_ms: Percentiles,
    /// The stages in the order in which a tick passes them.
    pub stages: Vec<StageReport>,
    /// How far forecasts were from what came to pass.
    pub accuracy: Accuracy,
}

/// The run as a whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Every tick in time, nothing lost, every forecast learned once its agent was old enough.
    Ok,
    /// Forecasts came all the time, but not all as they should.
    Degraded,
    /// No forecast came.
    #[default]
    Empty,
}

/// The run in one word, and why it is not `ok`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verdict {
    /// The word.
    pub status: Status,
    /// What went wrong, the worst first.
    pub reasons: Vec<String>,
}

/// What was run, as far as the caller tells.
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
    /// Whether forecasts recall how others went on at the same place.
    pub recalls: Option<bool>,
    /// Moments that the memory of the place began with, where one was kept: they may be of this recording.
    pub memory_moments: Option<u64>,
    /// Seed of the run.
    pub seed: Option<u64>,
    /// `real` or `max`.
    pub speed: Option<String>,
    /// Ticks after which the run was to end.
    pub ticks_limit: Option<u64>,
    /// Agents asked of the generated scene.
    pub scene_agents: Option<u64>,
    /// Frames in the recording.
    pub recorded_frames: Option<u64>,
    /// Of the recording's frames every so many-th was played; more than 1 where it is faster than 12.5 Hz.
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
    /// Most in one tick.
    pub max: Option<u64>,
}

/// Forecasts of single agents by quality.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ForecastCounts {
    /// The model's, of the same tick.
    pub learned: u64,
    /// The model's, of an earlier tick and moved on.
    pub held: u64,
    /// Constant control.
    pub kinematic: u64,
    /// Why forecasts were held or kinematic: `late`, `rejected`, `missing`, or `young`, which is no fault.
    pub causes: BTreeMap<String, u64>,
    /// Ticks with a forecast that is not learned for another cause than `young`.
    pub degraded_ticks: u64,
    /// Greatest age of a held forecast.
    pub age_ms_max: Option<f64>,
}

/// States of tracks by what moved them there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PriorCounts {
    /// A forecast of an earlier tick, at most a step old.
    pub learned: u64,
    /// An older forecast.
    pub held: u64,
    /// The process model alone.
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
    /// Greatest.
    pub max: Option<f64>,
}

/// One stage's share in the run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageReport {
    /// The stage's name.
    pub name: String,
    /// Its part of the 80 ms.
    pub budget_ms: Option<f64>,
    /// Median of compute over budget.
    pub budget_share_p50: Option<f64>,
    /// 99th percentile of compute over budget.
    pub budget_share_p99: Option<f64>,
    /// The input had come, but the stage was busy or waited for other input.
    pub waiting_ms: Percentiles,
    /// Transport, scheduler and check of the frame.
    pub wake_up_ms: Percentiles,
    /// Computation.
    pub compute_ms: Percentiles,
    /// Handing over the output.
    pub publish_ms: Percentiles,
    /// Ticks that passed the stage on their way to the forecast.
    pub ticks: u64,
    /// Ticks whose compute exceeded the budget.
    pub late_ticks: u64,
    /// Frames lost in this stage, by cause: `gap` (never arrived: the queue was full or the sender was gone) and
    /// `refused` (impossible content). A frame lost before counts there only.
    pub drops: StageDrops,
    /// How often the stage was started again.
    pub restarts: u32,
}

/// Frames lost in one stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageDrops {
    /// Never arrived.
    pub gap: u64,
    /// Arrived and were refused.
    pub refused: u64,
}

impl StageDrops {
    /// All causes together.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.gap + self.refused
    }
}

/// Accuracy of the forecasts as published, against the recording's later truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Errors of all forecasts.
    #[serde(flatten)]
    pub errors: Errors,
    /// Most draws of an agent, K.
    pub draws: Option<u32>,
    /// How far ahead the last step lies.
    pub horizon_s: Option<f64>,
    /// An end farther from the truth than this is a miss.
    pub miss_radius_m: f64,
    /// Errors of the learned forecasts alone.
    pub learned: Errors,
    /// Errors by agent type.
    pub by_type: BTreeMap<String, Errors>,
    /// Forecasts whose agent has no truth for the whole horizon: it left, or the run ended.
    pub uncovered: u64,
    /// Forecasts of what is no agent of the truth: false alarms, or no truth near.
    pub unmatched: u64,
}

/// Errors of a group of forecasts; constant velocity on the same agents beside them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Forecasts compared.
    pub forecasts: u64,
    /// Mean distance over the horizon, the best of the draws of each agent.
    pub ade_m: Option<f64>,
    /// Distance at the end of the horizon, the best of the draws of each agent.
    pub fde_m: Option<f64>,
    /// Share of forecasts none of whose draws ends within the miss radius.
    pub miss_rate: Option<f64>,
    /// Mean distance of the single best forecast (K = 1).
    pub single_ade_m: Option<f64>,
    /// Distance at the end of the single best forecast.
    pub single_fde_m: Option<f64>,
    /// Share of single best forecasts that miss.
    pub single_miss_rate: Option<f64>,
    /// Mean distance of constant velocity.
    pub cv_ade_m: Option<f64>,
    /// Distance at the end of constant velocity.
    pub cv_fde_m: Option<f64>,
    /// Share of constant velocities that miss.
    pub cv_miss_rate: Option<f64>,
}

/// A report file could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The file system refused.
    #[error("{path}: {source}")]
    File {
        /// The report's path.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file holds no report of this version.
    #[error("{path}: not a report: {source}")]
    Format {
        /// The report's path.
        path: String,
        /// Where and why.
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
