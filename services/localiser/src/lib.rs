//! Local patches of the context map for every agent: the stage between tracker and extractor. It does not
//! localise the ego.
//!
//! The [`Localiser`] keeps the global context map and cuts from it the local patch of each agent at each step
//! of its history. The map is a fixed one of the site, or grows online, or there is none and all patches are
//! zero.
//!
//! An online map is strictly causal: the patches of a tick contain what was observed *before* it, and the
//! tick's own tracks are added once all its patches are cut. One visit is added per tick and confirmed track;
//! a coasting track was not observed and adds none.
//!
//! A patch belongs to an agent and a time, not to the tick in which it is sent: the patch of (track, stamp)
//! is cut when that state is the newest, cached, and sent again with each later tick whose history contains
//! the state. Where it is not cached, after a restart or for a step between two ticks, it is cut from the map
//! as it is now.

mod cache;
mod localiser;
mod options;
mod step;

pub use localiser::{Localiser, LocaliserOptions, MapSource};
pub use options::{MapChoice, Options, STAGE, UnknownMap};
pub use step::{run, settings};
