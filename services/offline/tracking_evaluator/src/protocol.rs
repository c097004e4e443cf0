//! Protocols: which recordings are tracked from what, and what tracks are compared with.

mod interaction;
mod kitti;

pub use interaction::interaction;
pub use kitti::kitti;
