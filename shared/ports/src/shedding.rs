//! Load shedding: decides how many agents a tick has time to serve, and which ones.
//!
//! [`Turns`] is the policy: it orders the agents, and each tick serves a prefix of this order. A [`Shedder`]
//! decides for a stage how long the prefix of a tick may be; this is the tick's [`Allowance`]. The shedder
//! learns from the times of earlier ticks. Only its caller has a clock.
//!
//! Five of six turns go to the agents that matter most to the ego: agents on a conflicting path, then the
//! nearest [`NEAREST_LEN`]. Every sixth turn goes to the agent that has waited longest for a learned
//! forecast. After the nearest agents, all remaining turns go by waiting time. If a tick serves k agents, at
//! least ⌊k / 6⌋ of them are therefore the longest waiting. No agent starves: see [`wait_ticks_max`].

mod capacity;
mod cutoff;
mod shedder;
mod turns;

pub use capacity::SERVED_MIN;
pub use shedder::{Allowance, Shedder};
pub use turns::{CONFLICT_S, CONFLICTS_MAX, Candidate, Ego, NEAREST_LEN, Turns, wait_ticks_max};
