//! Load shedding: whom a tick serves when it has no time for all agents, and for how many it has time.
//!
//! [`Turns`] is the policy: an order of the agents of which any beginning may be served. [`Capacity`] is how
//! long that beginning may be, and [`Deadline`] until when there is time for it, both learned from what
//! earlier ticks took. None of them knows a clock.
//!
//! Five of six turns go to agents that matter most to the ego: those on a conflicting path, then the nearest
//! [`NEAREST_LEN`]. Every sixth goes to the agent that has waited longest for a learned forecast, and so do all
//! turns when the nearest are done. Where k agents fit a tick, at least ⌊k / 6⌋ are therefore those that have
//! waited longest, and nobody starves: see [`wait_ticks_max`].

mod capacity;
mod deadline;
mod turns;

pub use capacity::{Capacity, SERVED_MIN};
pub use deadline::Deadline;
pub use turns::{CONFLICT_S, CONFLICTS_MAX, Candidate, Ego, NEAREST_LEN, Turns, wait_ticks_max};
