//! The source: plays a recording tick by tick, as a sensor would have seen it.
//!
//! [`Playback`] decides what goes out in which tick; when it goes out is for the caller, who has a clock and knows
//! from [`Tick::due_ns`] how long after the first tick each one is due at the recording's own rate.

mod options;
mod outputs;
mod pace;
mod playback;
mod scene;
pub mod stage;

pub use options::{Options, STAGE};
pub use pace::Pace;
pub use playback::{Playback, PlaybackOptions, Tick};
pub use scene::recording;
