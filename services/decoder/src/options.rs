use nn::{Precision, WORKERS_MAX};
use run::Declaration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::{ControlsTopic, EncodingsTopic, StageId, Topic};

/// The decoder.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Decoder, &[EncodingsTopic::NAME], &[ControlsTopic::NAME]);

/// What may be set of the decoder.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Threads that share the work of a tick, the stage's own included; if not given as many as there are
    /// processors that the process may use, at most 4. Forecasts do not depend on it.
    #[schemars(range(min = 1, max = WORKERS_MAX))]
    pub workers: Option<usize>,
    /// Precision of the recurrent layer, nine tenths of the stage's work. `bf16` needs a processor with AVX-512 BF16
    /// and gives other forecasts, by what docs/real-time.md tells.
    pub precision: Precision,
}
