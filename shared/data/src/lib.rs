//! Where detections come from: recordings of every known format, training windows, and generated scenes.

mod recording;

pub use recording::{Ego, Frame, Recording};
