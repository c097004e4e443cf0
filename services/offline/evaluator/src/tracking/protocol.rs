//! Protocols: the recordings, the input of the trackers and the truth of each evaluation.

mod interaction;
mod kitti;

pub use interaction::interaction;
pub use kitti::kitti;
