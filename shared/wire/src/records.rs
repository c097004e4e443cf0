//! The elements of the topics' payloads.

mod agent;
mod check;
mod detection;
mod forecast;
mod heartbeat;
mod refusals;
mod track;

pub use agent::{AgentControls, AgentEncoding, AgentFeatures, ControlGaussian};
pub use detection::{Detection, Truth, detection_flags};
pub use forecast::{Cause, Expert, Forecast, ForeseenConflict, Quality, Steering};
pub use heartbeat::Heartbeat;
pub use refusals::{LinkCount, RefusalCause, Refusals};
pub use track::{HistoryState, Track, TrackStatus};
