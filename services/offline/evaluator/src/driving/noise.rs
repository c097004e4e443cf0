//! How noise of the detections changes the forecasts.
//!
//! [`synthetic`] plays generated agents, whose true motion is a formula. [`under_noise`] plays recordings, whose
//! motion is the truth, as a noisy sensor reports them.

mod motion;
mod real;
mod synthetic;

pub use real::{network_under_noise, under_noise};
pub use synthetic::synthetic;
