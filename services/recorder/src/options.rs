use std::path::PathBuf;

use run::Declaration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::{ForecastsTopic, StageId, Topic, TruthTopic};

/// The recorder.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Recorder, &[ForecastsTopic::NAME, TruthTopic::NAME], &[]);

/// Options of the recorder.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// File for the recorder's report; by default report.json in the run's directory.
    #[schemars(extend("format" = "path"))]
    pub report: Option<PathBuf>,
    /// File for the forecasts as JSON lines; by default they are not written.
    #[schemars(extend("format" = "path"))]
    pub forecasts: Option<PathBuf>,
}
