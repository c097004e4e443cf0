use run::Declaration;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wire::{EncodingsTopic, FeaturesTopic, StageId, Topic};

/// The encoder.
pub const STAGE: Declaration<Options> =
    Declaration::new(StageId::Encoder, &[FeaturesTopic::NAME], &[EncodingsTopic::NAME]);

/// What may be set of the encoder: nothing yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Options {}
