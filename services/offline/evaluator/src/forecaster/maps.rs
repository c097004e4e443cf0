//! Context maps for the model: which map a recording's forecasts use, and how a site's recordings make one.

use localiser::MapSource;
use scene::ContextMap;

use crate::scenes::{Agent, Scene};

/// The source of local map patches.
#[derive(Clone, Copy, Debug)]
pub enum MapInput<'a> {
    /// No map: every patch is empty.
    None,
    /// The map of the recording up to the patch's own time.
    Online,
    /// The map of a site, made from other recordings.
    Site(&'a ContextMap),
}

impl MapInput<'_> {
    /// The localiser's map.
    pub(crate) fn source(self) -> MapSource {
        match self {
            Self::None => MapSource::None,
            Self::Online => MapSource::Online,
            Self::Site(map) => MapSource::Fixed(map.clone()),
        }
    }
}

/// The map of all places where the scenes' agents were, with one visit per step. `None` if there are no
/// agents or they span more than a map holds.
#[must_use]
pub fn site_map<'a>(scenes: impl IntoIterator<Item = &'a Scene>) -> Option<ContextMap> {
    let agents = scenes.into_iter().flat_map(|scene| &scene.agents);
    ContextMap::of_visits(&agents.filter_map(Agent::newest).collect::<Vec<_>>())
}
