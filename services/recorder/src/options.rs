use std::path::PathBuf;

use crate::arrivals::SILENCE_NS;
use run::Declaration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::{ForecastsTopic, StageId, Topic, TruthTopic};

/// The recorder.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Recorder, &[ForecastsTopic::NAME, TruthTopic::NAME], &[]);

/// Options of the recorder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// File for the recorder's report; by default report.json in the run's directory.
    #[schemars(extend("format" = "path"))]
    pub report: Option<PathBuf>,
    /// File for the forecasts as JSON lines; by default they are not written.
    #[schemars(extend("format" = "path"))]
    pub forecasts: Option<PathBuf>,
    /// Time without a tick after which the run has no input, in seconds.
    #[schemars(range(min = 0.1, max = 3600.0))]
    pub silence_s: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { report: None, forecasts: None, silence_s: SILENCE_NS as f64 / 1e9 }
    }
}

impl Options {
    /// Time without a tick after which the run has no input.
    #[must_use]
    pub const fn silence_ns(&self) -> u64 {
        (self.silence_s * 1e9) as u64
    }
}
