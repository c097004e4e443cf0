//! The source: plays a recording tick by tick, as a sensor would send it.
//!
//! [`Playback`] decides what goes out in which tick. The caller, which has the clock, decides when:
//! [`Tick::due_ns`] is the time after the first tick at which each one is due at the recording's own rate.

mod options;
mod outputs;
mod pace;
mod plan;
mod playback;
mod scene;
pub mod stage;
mod thinning;

pub use options::{Options, STAGE};
pub use playback::{Playback, PlaybackOptions, Tick};
pub use scene::recording;
