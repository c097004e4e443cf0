use nn::WORKERS_MAX;
use run::Declaration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::StageId;

use crate::Extractor;

/// The extractor.
pub const STAGE: Declaration<Options> = ports::declare::<Extractor, _>(StageId::Extractor);

/// What may be set of the extractor.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Number of threads for the work of a tick; by default one per available processor, at most 4. Forecasts
    /// do not depend on it.
    #[schemars(range(min = 1, max = WORKERS_MAX))]
    pub workers: Option<usize>,
}
