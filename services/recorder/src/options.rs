use std::path::PathBuf;

use run::Declaration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::{ForecastsTopic, StageId, Topic, TruthTopic};

/// The recorder.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Recorder, &[ForecastsTopic::NAME, TruthTopic::NAME], &[]);

/// What may be set of the recorder.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// File for the report as the launcher finds it, in the run's directory where not given.
    #[schemars(extend("format" = "path"))]
    pub report: Option<PathBuf>,
    /// File for the forecasts as JSON lines; they are not written where not given.
    #[schemars(extend("format" = "path"))]
    pub forecasts: Option<PathBuf>,
}
