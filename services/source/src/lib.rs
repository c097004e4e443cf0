//! The source: plays a recording tick by tick, as a sensor would send it.
//!
//! [`Playback`] decides the contents of each tick. The caller has the clock and decides when a tick goes out.
//! [`Tick::due_ns`] is the time from the first tick to this one at the recording's own rate.

mod inbox;
mod live;
mod options;
mod outputs;
mod pace;
mod plan;
mod playback;
mod scene;
pub mod stage;
mod thinning;

pub use inbox::Inbox;
pub use live::{LiveSource, LiveTick, LiveTicks};
pub use options::{Options, STAGE};
pub use outputs::Outputs;
pub use plan::start_ns;
pub use playback::{Playback, PlaybackOptions, Tick};
pub use scene::{generated_scene, recording};
pub use thinning::merge;
