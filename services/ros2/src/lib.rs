//! The bridge to ROS 2: detections in, tracks and forecasts out, with Autoware's messages and QoS.
//!
//! Two stages of pipeline.toml run this program, and `stgdat ros2` attaches it to a running pipeline:
//!
//! * In place of the *source* it reads `DetectedObjects` or `TrackedObjects`. [`ticks`] makes ticks of the
//!   messages.
//! * As an *added stage* it publishes `TrackedObjects`, `PredictedObjects`, the ego vehicle's pose and
//!   diagnostics. [`output`] fills the messages with [`interop::autoware`]. No tick waits for it, and it
//!   never waits for a reader.
//!
//! DDS is behind the feature `ros2`: `ros2-client` on `rustdds`. Without the feature the crate has the
//! options and the conversions.

pub mod command;
pub mod diagnostics;
pub mod graph;
#[cfg(feature = "ros2")]
pub mod node;
pub mod options;
pub mod output;
#[cfg(feature = "ros2")]
pub mod publish;
pub mod since_stamp;
#[cfg(feature = "ros2")]
pub mod source;
pub mod ticks;
