//! The compute stages in one process: the same steps on the same settings as in a run of processes, so that
//! forecasts are equal to the bit.
//!
//! In go wire payloads (detections or tracks, tick by tick), out come tracks, controls and forecasts.
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
//! * [`Stages`] are the same stages one by one, from frame to frame, and [`Replay`] takes a recording through them.

mod chain;
mod controls;
mod error;
mod features;
mod forecasts;
mod load;
mod replay;
mod stages;

pub use chain::Chain;
pub use controls::{Controls, FeaturesToControls};
pub use error::ChainError;
pub use features::{FeatureFrame, TracksToFeatures};
pub use forecasts::TracksToForecasts;
pub use load::Load;
pub use replay::{OwnTime, Replay, ReplayError, Replayed, STAGES};
pub use stages::{OwnFrame, Stages};
