//! Golden vectors of the network and of tracking: the repository's vectors agree, and modified ones do not.

mod golden;
mod golden_tracking;
