//! What the stages say to each other: topics, message headers and payload elements.
//!
//! A *topic* names a stream, fixes the element type of its messages and bounds every queue. A *frame* is one message:
//! a [`Header`] and a slice of elements. All frames of one tick carry the same `seq` and `stamp_ns`, and each stage
//! appends a [`Hop`], so that the last frame of a tick tells the whole tick.
//!
//! Payloads are plain old data (`#[repr(C)]`, explicit padding, any bit pattern is a value): they cross process
//! borders as they lie in memory. A change of layout changes the topic's type name, so that old and new never meet.
//!
//! Frames of reference: positions are in one right-handed, metric *world frame* (x, y; z up) whose origin lies within
//! [`POSITION_MAX_M`]; headings are counter-clockwise from +x in radians. Times are nanoseconds: `stamp_ns` on the
//! sensor's or recording's clock, all others on `CLOCK_MONOTONIC`.

mod agent;
mod check;
mod header;
mod layout;
mod records;
mod tick;
mod topic;

pub use agent::{AGENT_TYPES, AgentType, UnknownAgentType};
pub use check::{Rejected, finite};
pub use header::{Counts, HOPS_MAX, Header, Hop, SCHEMA, StageId, flags};
pub use layout::{
    Context, ContextMut, ContextShape, Edge, FeatureShape, Features, FeaturesMut, Row, context_rows,
    feature_rows,
};
pub use records::{
    AgentControls, AgentEncoding, AgentFeatures, Cause, ControlGaussian, Detection, Forecast, Heartbeat,
    HistoryState, Quality, Steering, Track, TrackStatus, Truth, detection_flags,
};
pub use tick::{TICK_MS, TICK_NS};
pub use topic::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic,
    HeartbeatsTopic, Topic, TracksTopic, TruthTopic,
};

/// Most agents in a frame. When the tracker holds more, the nearest to the ego or the scene's centre are kept.
pub const AGENTS_MAX: usize = 128;
/// Most detections in a frame.
pub const DETECTIONS_MAX: usize = 512;
/// Longest history, T_h, in steps.
pub const HISTORY_MAX: usize = 8;
/// Longest forecast, T_f, in steps.
pub const HORIZON_MAX: usize = 12;
/// Most latent draws (modes), K, of an agent.
pub const MODES_MAX: usize = 20;
/// Most edges of all steps of the history graph together, the self edges included.
pub const EDGES_MAX: usize = 32_768;
/// Channels of a local context patch: density and the two components of the mean velocity.
pub const PATCH_CHANNELS: usize = 3;
/// Largest side of a local context patch, in cells.
pub const PATCH_SIDE_MAX: usize = 32;
/// Components of the state features s.
pub const STATE_FEATURES: usize = 6;
/// Components of the relation features φ.
pub const RELATION_FEATURES: usize = 6;
/// Components of the state embedding SE.
pub const STATE_EMBEDDING: usize = 32;
/// Components of the context embedding CE.
pub const CONTEXT_EMBEDDING: usize = 32;
/// Components of a node attribute v = \[SE ‖ CE\].
pub const NODE_ATTRIBUTES: usize = STATE_EMBEDDING + CONTEXT_EMBEDDING;
/// Components of an edge attribute e.
pub const EDGE_ATTRIBUTES: usize = 16;
/// Components of the temporal summary ṽ.
pub const TEMPORAL: usize = 64;
/// Components of the latent variable z.
pub const LATENT: usize = 32;
/// Largest magnitude of a world coordinate; beyond it f32 resolves less than 4 mm.
pub const POSITION_MAX_M: f32 = 32_768.0;
/// Largest speed that is believed of an agent.
pub const SPEED_MAX_MPS: f32 = 120.0;
