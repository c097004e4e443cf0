//! The network: weights, layers and the kernels that run them.
//!
//! Layers are built once from [`Weights`]. The constructor checks every shape, folds constants and packs the
//! matrices in the kernels' reading order. A layer is then immutable. The scratch data of a call is in a
//! separate *memory* (`ContextMemory`, `GdatMemory`, …). A memory grows only when a larger input arrives, so
//! a steady caller never allocates.
//!
//! Each row of a result depends only on its own inputs and is summed in one fixed order. Rows may therefore
//! be split over workers or batched in any way without changing a bit.

pub mod base;
pub mod kernels;

mod attention;
mod buffer;
mod context;
mod decoder;
mod embedding;
mod encoding;
mod linear;
mod motion;
mod precision;
mod weights;
mod workers;

pub use attention::{AgentSet, Gdat, GdatMemory, Graph, GraphTrace, RoundTrace, with_senders};
pub use context::{ContextCnn, ContextMemory};
pub use decoder::{
    AgentDraws, BurnIn, Decoder, DecoderGroup, DecoderMemory, Draws, Encoded, RAW_CONTROL, TypeDecoder,
    control_gaussian,
};
pub use embedding::{RelationMlp, StateMlp};
pub use encoding::EncodingFunction;
pub use kernels::bf16::PrecisionError;
pub use linear::MlpMemory;
pub use model::{
    Attention, ConfigError, Displacement, Feedback, Integrator, Latents, ModelConfig, NodeTypes, Stem,
    Temporal, VehicleMotion,
};
pub use motion::{motion_kind, motion_options};
pub use precision::Precision;
pub use weights::{Stored, Weights, WeightsError, encode};
pub use workers::{Deadline, Job, StartError, WORKERS_MAX, Workers, default_workers};
