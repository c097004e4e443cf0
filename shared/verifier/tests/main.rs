//! Golden vectors of the network and of tracking: those of the repository agree, and changed ones do not.

mod golden;
mod golden_tracking;
