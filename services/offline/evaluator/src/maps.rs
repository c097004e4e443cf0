//! Context maps for the model: which map a recording's forecasts use, and how a site's recordings make one.

use localiser::MapSource;
use scene::{ContextMap, MapBuilder, State};

use crate::Scene;

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
    let states: Vec<State> = scenes.into_iter().flat_map(newest).map(|(_, state)| state).collect();
    let first = states.first()?.position_m;
    let (low, high) = states.iter().fold((first, first), |(low, high), state| {
        let extreme = |of: [f32; 2], pick: fn(f32, f32) -> f32| {
            [0, 1].map(|axis| pick(of[axis], state.position_m[axis]))
        };
        (extreme(low, f32::min), extreme(high, f32::max))
    });
    let origin_m = low.map(f32::floor);
    let [cols, rows] = [0, 1].map(|axis| (high[axis] - origin_m[axis]) as usize + 1);
    let mut builder = MapBuilder::new(origin_m, rows, cols)?;
    for state in states {
        builder.visit(state.position_m, state.velocity_mps);
    }
    Some(builder.build())
}

/// Identity and newest state of every agent.
fn newest(scene: &Scene) -> impl Iterator<Item = (u64, State)> + '_ {
    scene.agents.iter().filter_map(|agent| Some((agent.id, agent.newest()?)))
}
