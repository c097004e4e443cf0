use nn::WORKERS_MAX;
use run::Declaration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::{ContextTopic, FeaturesTopic, StageId, Topic};

/// The extractor.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Extractor, &[ContextTopic::NAME], &[FeaturesTopic::NAME]);

/// What may be set of the extractor.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Threads that share the work of a tick, the stage's own included; forecasts do not depend on it.
    #[schemars(range(min = 1, max = WORKERS_MAX))]
    pub workers: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { workers: 1 }
    }
}
