//! Offline checks of the pipeline's parts against references, and of its forecasts against what really came.
//!
//! [`verify`] recomputes every tensor of a folder of golden vectors with the very code that runs on board and tells
//! which ones are off: users run it on their own processor before they trust it.

mod baselines;
mod error;
mod forecaster;
mod judge;
mod maps;
mod method;
mod motion;
pub mod picture;
mod scenes;
mod tally;
mod threads;
mod verify;

pub use baselines::{ANCHOR_AGENTS, Baselines};
pub use error::EvaluateError;
pub use forecaster::{BaseForecast, Forecast, Forecaster, ForecasterMemory};
pub use judge::{Block, Judge, MOVING_MPS, Subset};
pub use maps::{MapInput, site_map};
pub use method::Method;
pub use scenes::{Agent, Cut, Scene};
pub use tally::{Errors, Measure, Sureness, Tally};
pub use verify::{Comparison, TOLERANCE, VerifyError, verify};
