//! The source: plays a recording tick by tick, as a sensor would have seen it.
//!
//! [`Playback`] decides what goes out in which tick; when it goes out is for the caller, who has a clock and knows
//! from [`Tick::due_ns`] how long after the first tick each one is due at the recording's own rate.

mod outputs;
mod pace;
mod playback;
mod scene;
pub mod stage;

pub use pace::Pace;
pub use playback::{INTERVAL_MIN_NS, Playback, PlaybackOptions, Tick};
pub use scene::recording;
