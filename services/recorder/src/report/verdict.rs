use serde::{Deserialize, Serialize};

use crate::input::DOUBT;

wire::named! {
    /// Status of a run.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Status {
        /// Every tick was in time, nothing was lost, and every forecast was learned once its agent was old
        /// enough.
        Ok => "OK",
        /// Like `ok`, but the input is doubtful: a finding of the audit concerns more than [`audit::DOUBT_SHARE`]
        /// of its rows.
        Doubtful => "DOUBTFUL",
        /// Forecasts were received, but some were late, lost or not learned.
        Degraded => "DEGRADED",
        /// No agent was forecast in any tick.
        #[default]
        Empty => "EMPTY",
    }
}

/// The status of a run, and why it is not `ok`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verdict {
    /// The status.
    pub status: Status,
    /// The faults, worst first.
    pub reasons: Vec<String>,
}

impl Verdict {
    /// The verdict for these reasons. A fault of the run takes precedence over a doubt about its input.
    #[must_use]
    pub fn new(is_empty: bool, reasons: Vec<String>) -> Self {
        let mut verdict = Self { status: if is_empty { Status::Empty } else { Status::Ok }, reasons };
        verdict.settle();
        verdict
    }

    /// Determines the status again after the reasons have changed.
    pub(super) fn settle(&mut self) {
        self.status = match self.status {
            Status::Empty => Status::Empty,
            _ if self.reasons.is_empty() => Status::Ok,
            _ if self.reasons.iter().all(|reason| reason.starts_with(DOUBT)) => Status::Doubtful,
            _ => Status::Degraded,
        };
    }
}
