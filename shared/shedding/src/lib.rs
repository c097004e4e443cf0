//! Load shedding: whom a tick serves when it has no time for all agents, and for how many it has time.
//!
//! [`Turns`] is the policy: an order of the agents. Any beginning of it may be served. A [`Shedder`] decides for a
//! stage how long this beginning may be in a tick, its [`Allowance`]. It learns from the time that earlier ticks took.
//! Only the shedder's caller knows a clock.
//!
//! Five of six turns go to agents that matter most to the ego: those on a conflicting path, then the nearest
//! [`NEAREST_LEN`]. Every sixth goes to the agent that has waited longest for a learned forecast, and so do all
//! turns when the nearest are done. Where k agents fit a tick, at least ⌊k / 6⌋ are therefore those that have
//! waited longest, and nobody starves: see [`wait_ticks_max`].

mod capacity;
mod cutoff;
mod shedder;
mod turns;

pub use capacity::SERVED_MIN;
pub use shedder::{Allowance, Shedder};
pub use turns::{CONFLICT_S, CONFLICTS_MAX, Candidate, Ego, NEAREST_LEN, Turns, wait_ticks_max};
