//! Conflicts: pairs of agents that may come too close within the horizon of their forecasts.
//!
//! The outline of an agent is three circles along it, or one for a pedestrian. The *gap* of a pair is the smallest
//! distance between their outlines at a common step. A pair has a *conflict* if its gap falls below
//! [`CONFLICT_M`].
//!
//! Agents watch each other, so far fewer pairs meet than independent forecasts foretell: a driver brakes behind the
//! vehicle ahead. [`Signs`] are what the forecasts of a pair say, and [`Odds`] how often pairs with such signs had
//! a conflict on recordings.
//!
//! | layer | modules |
//! |---|---|
//! | 1 | `outline`: the circles of an agent along its paths |
//! | 2 | `signs`: what the modes of two agents say about their gap |
//! | 3 | `odds`: the probability of a conflict by these signs |
//! | 4 | `finder`: the conflicts of all agents of a tick |

mod finder;
mod odds;
mod outline;
mod signs;

pub use finder::{Finder, Pair};
pub use odds::{Odds, OddsOfSources};
pub use outline::{Body, Outline};
pub use signs::{Moving, Room, SIGNS, Signs, are_judged};

/// A smaller gap is a conflict.
pub const CONFLICT_M: f32 = 0.5;
/// A smaller gap counts as near.
pub const NEAR_M: f32 = 2.0;
/// Pairs that are closer already are left out.
pub const APART_MIN_M: f32 = 1.0;
/// Pairs that are farther apart are left out.
pub const APART_MAX_M: f32 = 60.0;
/// An agent that is not faster stands. Pairs of which both stand are left out.
pub const STANDS_MPS: f32 = 0.5;
