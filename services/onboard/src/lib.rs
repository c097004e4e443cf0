//! The compute stages in one process. They take the same steps with the same settings as in a run of
//! processes, so that forecasts are equal to the bit.
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
//! * [`Stages`] holds the same stages one by one, from frame to frame. [`Replay`] takes a recording through
//!   them.

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
