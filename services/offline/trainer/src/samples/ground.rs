//! The map patches of agents, one per agent and frame. \[model §2\]

use half::f16;
use scene::{ContextMap, PatchOptions, State};

use super::agents::{StoredState, restored, stored};
use crate::TrainError;
use crate::spool::{Spool, Spooling};

/// Offsets of the map patches of a recording in the spool, and the map of its site.
#[derive(Debug)]
pub(crate) struct Ground {
    /// The patches of the online map, from observations before each patch's time.
    online: u64,
    /// The state of each patch's agent.
    states: u64,
    patch_count: usize,
    /// The map of the site's other training recordings.
    site: Option<ContextMap>,
}

/// The ground of a recording while its patches are written.
#[derive(Debug)]
pub(super) struct GroundSpooling<'a> {
    spooling: &'a mut Spooling,
    online: u64,
    states: Vec<StoredState>,
}

impl<'a> GroundSpooling<'a> {
    pub(super) const fn new(spooling: &'a mut Spooling) -> Self {
        Self { online: spooling.len(), spooling, states: Vec::new() }
    }

    /// Adds a patch and the state of its agent.
    pub(super) fn push(&mut self, state: &State, patch: &[f32]) -> Result<(), TrainError> {
        let halves: Vec<u16> = patch.iter().map(|&value| f16::from_f32(value).to_bits()).collect();
        self.spooling.append(&halves)?;
        self.states.push(stored(state));
        Ok(())
    }

    pub(super) fn finish(self) -> Result<Ground, TrainError> {
        let Self { spooling, online, states } = self;
        Ok(Ground { online, states: spooling.append(&states)?, patch_count: states.len(), site: None })
    }
}

/// The kind of map of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MapKind {
    /// Observations before the present.
    Online,
    /// The site's other recordings.
    Site,
}

/// The patches of a recording from one kind of map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MapView<'a> {
    pub(crate) recording: u32,
    ground: &'a Ground,
    spool: &'a Spool,
    kind: MapKind,
}

impl Ground {
    /// The patches, for the recording with this index; `None` if there is no such map.
    pub(crate) fn view<'a>(&'a self, spool: &'a Spool, recording: u32, kind: MapKind) -> Option<MapView<'a>> {
        let known = match kind {
            MapKind::Online => self.patch_count > 0,
            MapKind::Site => self.site.is_some(),
        };
        known.then_some(MapView { recording, ground: self, spool, kind })
    }

    pub(super) fn set_site(&mut self, site: Option<ContextMap>) {
        self.site = site;
    }
}

/// The map of all positions of agents; `None` if there are none, or if they span more ground than a map can
/// hold.
pub(super) fn site_map(spool: &Spool, grounds: &[&Ground]) -> Result<Option<ContextMap>, TrainError> {
    let mut states = Vec::new();
    for ground in grounds {
        let stored = spool.read::<StoredState>(ground.states, ground.patch_count)?;
        states.extend(stored.into_iter().map(restored));
    }
    Ok(ContextMap::of_visits(&states))
}

impl MapView<'_> {
    /// Appends the values of a patch.
    pub(crate) fn extend(
        &self,
        patch: u32,
        options: PatchOptions,
        values: &mut Vec<f32>,
    ) -> Result<(), TrainError> {
        let Self { ground, spool, .. } = self;
        match (self.kind, &ground.site) {
            (MapKind::Site, Some(site)) => {
                let offset = ground.states + u64::from(patch) * size_of::<StoredState>() as u64;
                let states: Vec<StoredState> = spool.read(offset, 1)?;
                let start = values.len();
                values.resize(start + options.len(), 0.0);
                site.patch(&restored(states[0]), options, &mut values[start..]);
            }
            _ => {
                let offset = ground.online + u64::from(patch) * (options.len() * size_of::<u16>()) as u64;
                let halves: Vec<u16> = spool.read(offset, options.len())?;
                values.extend(halves.into_iter().map(|half| f16::from_bits(half).to_f32()));
            }
        }
        Ok(())
    }
}
