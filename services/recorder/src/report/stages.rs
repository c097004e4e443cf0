//! Times and losses by stage.

use serde::{Deserialize, Serialize};

use super::Percentiles;

/// Programs that connect a run to another box or to ROS 2, and the name of the other side.
pub const PARTNERS: [(&str, &str); 2] = [("stgdat-bridge", "other box"), ("stgdat-ros2", "ROS 2")];

/// Times and losses of one stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageReport {
    /// The stage's name.
    pub name: String,
    /// File name of its program; empty for one of stgdat's own.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub program: String,
    /// Topics that it reads; empty if they are unknown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reads: Vec<String>,
    /// Topics that it writes; empty if they are unknown.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub writes: Vec<String>,
    /// Share of the tick limit of 80 ms.
    pub budget_ms: Option<f64>,
    /// Median of compute over budget.
    pub budget_share_p50: Option<f64>,
    /// 99th percentile of compute over budget.
    pub budget_share_p99: Option<f64>,
    /// Time in which the input was available, but the stage was busy or waited for other input.
    pub waiting_ms: Percentiles,
    /// Transport, scheduling and the check of the frame.
    pub wake_up_ms: Percentiles,
    /// Computation.
    pub compute_ms: Percentiles,
    /// Writing the header and sending the output.
    pub publish_ms: Percentiles,
    /// Number of ticks that passed the stage on their way to the forecast.
    pub ticks: u64,
    /// Number of ticks whose compute exceeded the budget.
    pub late_ticks: u64,
    /// Frames lost in this stage, by cause: `gap` (never arrived, because the queue was full or the sender
    /// had ended) and `refused` (invalid content). A frame counts only in the stage that lost it first.
    /// `unanswered` is included in these.
    pub drops: StageDrops,
    /// Number of restarts after a death.
    pub restarts: u32,
    /// Number of replacements during the run.
    #[serde(default)]
    pub replacements: u32,
    /// Time from the sensor's stamp to the publication in ROS 2, as `stgdat-ros2` has measured it since its start.
    #[serde(default, skip_serializing_if = "Percentiles::is_empty")]
    pub since_stamp_ms: Percentiles,
}

impl StageReport {
    /// Whether the stage has times or counts. A program that only reads forecasts has none.
    #[must_use]
    pub const fn is_measured(&self) -> bool {
        self.ticks > 0 || self.budget_ms.is_some() || self.drops.total() > 0
    }
}

/// Start of a verdict's reason that counts restarts.
pub(super) const RESTARTS: &str = "restarts: ";

/// The restarts of all stages as a reason of the verdict; `None` if there were none.
pub(crate) fn restarts(stages: &[StageReport]) -> Option<String> {
    let all: u32 = stages.iter().map(|stage| stage.restarts).sum();
    let named = stages.iter().filter(|stage| stage.restarts > 0);
    let named: Vec<String> = named.map(|stage| format!("{} {}", stage.name, stage.restarts)).collect();
    (all > 0).then(|| format!("{RESTARTS}{all} ({})", named.join(", ")))
}

/// Frames lost in one stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageDrops {
    /// Number of frames that never arrived.
    pub gap: u64,
    /// Number of ticks for which the stage has sent nothing, because the frame that begins a step never
    /// arrived or was refused as a whole. They are included in the other counts.
    #[serde(default)]
    pub unanswered: u64,
    /// Number of frames that arrived and were refused.
    pub refused: u64,
    /// Number of ticks without forecasts because the stage had died. For the recorder: ticks that it did not
    /// record.
    #[serde(default)]
    pub restart: u64,
}

impl StageDrops {
    /// Sum over all causes.
    #[must_use]
    pub const fn total(&self) -> u64 {
        self.gap + self.refused + self.restart
    }
}
