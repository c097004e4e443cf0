//! The compute stages in one process. They run the same [steps](ports::Step) with the same settings as in a
//! run of processes, so that forecasts are equal to the bit.
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
//! * [`TracksToForecasts`] is the part of the pipeline that starts at a `tracks` payload.
//! * [`TracksToFeatures`] and [`FeaturesToControls`] are the parts of [`TracksToForecasts`] before the
//!   sampler. The first depends on earlier ticks. The second depends only on its tick, so that evaluations
//!   can spread ticks over threads.
//! * [`Stages`] holds the same stages one by one. [`Replay`] takes a recording through them.

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
