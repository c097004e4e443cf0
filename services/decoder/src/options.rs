use nn::{Precision, WORKERS_MAX};
use run::Declaration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::StageId;

use crate::Decoder;

/// The decoder.
pub const STAGE: Declaration<Options> = ports::declare::<Decoder, _>(StageId::Decoder);

/// What may be set of the decoder.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Number of threads for the work of a tick; by default one per available processor, at most 4. Forecasts
    /// do not depend on it.
    #[schemars(range(min = 1, max = WORKERS_MAX))]
    pub workers: Option<usize>,
    /// Precision of the recurrent layer, which is nine tenths of the stage's work. `bf16` needs AVX-512 BF16
    /// and changes the forecasts as docs/real-time.md shows.
    pub precision: Precision,
}
