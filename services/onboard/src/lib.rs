//! The compute stages in one process: the same [steps](ports::Step) on the same settings as in a run of processes,
//! so forecasts are equal to the bit.
//!
//! The input consists of wire payloads (detections or tracks, tick by tick). The output consists of tracks,
//! controls and forecasts.
//!
//! ```text
//! detections ─ tracker ─┬─ localiser ─ extractor ─┬─ encoder ─ decoder ─┬─ sampler ─ forecasts
//!                       └─ TracksToFeatures ──────┴─ FeaturesToControls ┘
//!              Chain    └─ TracksToForecasts ──────────────────────────────────────┘
//! ```
//!
//! * [`Chain`] is the whole pipeline: `stgdat predict`, `track` and `bench` run it.
//! * [`TracksToForecasts`] is its part from a `tracks` payload on.
//! * [`TracksToFeatures`] and [`FeaturesToControls`] are the parts of that. The first depends on the ticks
//!   before, the second on the tick alone, so that evaluations can share its ticks among threads.
//! * [`Stages`] are the same stages one by one, and [`Replay`] takes a recording through them.

mod chain;
mod error;
mod frame;
mod load;
mod replay;
mod stages;

pub use chain::{Chain, FeaturesToControls, TracksToFeatures, TracksToForecasts};
pub use error::ChainError;
pub use frame::OwnFrame;
pub use load::Load;
pub use replay::{OwnTime, Replay, ReplayError, Replayed, STAGES};
pub use stages::Stages;
