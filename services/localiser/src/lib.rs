//! Cuts local patches of the context map for every agent. This stage runs between tracker and extractor. It
//! does not localise the ego.
//!
//! The [`Localiser`] keeps the global context map. It cuts a local patch from the map for each agent at each
//! step of the agent's history. The map is a fixed map of the site or grows online. Without a map, all
//! patches are zero.
//!
//! An online map is strictly causal: the patches of a tick contain only observations from *before* the tick.
//! The tick's own tracks are added after all its patches are cut. Each tick adds one visit per confirmed
//! track. A coasting track was not observed and adds no visit.
//!
//! A patch belongs to an agent and a time, not to the tick in which it is sent. The patch of (track, stamp)
//! is cut when the state of that stamp is the newest. It is then cached, and sent again with each later tick
//! whose history contains the state. A patch may be missing from the cache, after a restart or for a step
//! between two ticks. It is then cut from the current map.

mod cache;
mod localiser;
mod options;
mod step;

pub use localiser::{Localiser, LocaliserOptions, MapSource};
pub use options::{MapChoice, Options, STAGE, UnknownMap};
pub use step::{run, settings};
