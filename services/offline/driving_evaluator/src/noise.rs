//! How noise of the detections changes the forecasts.
//!
//! [`synthetic`] plays generated agents, whose true motion is a formula.

mod motion;
mod sheet;
mod synthetic;

pub use synthetic::{SyntheticReport, synthetic};
