use scene::{ContextMap, OnlineMap, PatchOptions, State};
use wire::{
    ContextMut, ContextShape, HISTORY_MAX, Header, PATCH_SIDE_MAX, Rejected, Track, TrackStatus, equal,
};

use crate::cache::PatchCache;

/// Where the context map comes from.
pub enum MapSource {
    /// No map: every patch is zero.
    None,
    /// A map of the site, built from earlier recordings.
    Fixed(ContextMap),
    /// A map that grows from observations during the run.
    Online,
}

/// Settings of a [`Localiser`].
pub struct LocaliserOptions {
    /// Steps of the history window, T_h.
    pub history_len: usize,
    /// Size of the patches.
    pub patch: PatchOptions,
    /// Where the context map comes from.
    pub map: MapSource,
}

enum Map {
    None,
    Fixed(ContextMap),
    Online(Box<OnlineMap>),
}

/// Keeps the context map and cuts the agents' patches from it.
pub struct Localiser {
    history_len: usize,
    patch: PatchOptions,
    map: Map,
    cache: PatchCache,
    /// Number and stamp of the newest tick.
    last: Option<(u64, i64)>,
}

impl Localiser {
    /// A localiser that has observed nothing yet.
    ///
    /// # Panics
    /// If the history or the patches are larger than a frame can hold.
    #[must_use]
    pub fn new(options: LocaliserOptions) -> Self {
        let LocaliserOptions { history_len, patch, map } = options;
        assert!((1..=HISTORY_MAX).contains(&history_len), "history of {history_len} steps");
        assert!((1..=PATCH_SIDE_MAX).contains(&patch.side), "patches of {} cells", patch.side);
        let map = match map {
            MapSource::None => Map::None,
            MapSource::Fixed(map) => Map::Fixed(map),
            MapSource::Online => Map::Online(Box::default()),
        };
        Self { history_len, patch, map, cache: PatchCache::new(patch.len()), last: None }
    }

    /// The shape of a frame of `track_count` tracks.
    #[must_use]
    pub const fn shape(&self, track_count: usize) -> ContextShape {
        ContextShape { agents_len: track_count, history_len: self.history_len, patch_side: self.patch.side }
    }

    /// Writes the tracks and their patches, then adds the observed tracks to an online map.
    ///
    /// # Errors
    /// [`Rejected`] if the frame is not newer than the last, does not fit the model or holds impossible
    /// numbers. The localiser is then unchanged.
    ///
    /// # Panics
    /// If the shape of `out` differs from [`Localiser::shape`].
    pub fn step(
        &mut self,
        header: &Header,
        tracks: &[Track],
        out: &mut ContextMut<'_>,
    ) -> Result<(), Rejected> {
        assert_eq!(out.shape, self.shape(tracks.len()), "room for the frame");
        self.check(header, tracks)?;
        if !header.is_tick() {
            return Ok(());
        }
        if self.last.is_some_and(|last| header.begins_session_after(last)) {
            // Stamps of patches have no meaning any more. The map of the place stays.
            self.cache.clear();
        }
        out.tracks.copy_from_slice(tracks);
        self.cache.touch(tracks.iter().map(|track| track.id), header.stamp_ns);
        for (agent, track) in tracks.iter().enumerate() {
            self.write_patches(header, agent, track, out);
        }
        if let Map::Online(map) = &mut self.map {
            let confirmed = tracks.iter().filter(|track| track.status == TrackStatus::Confirmed as u32);
            map.observe(
                header.ego_m,
                confirmed.map(|track| ([track.x_m, track.y_m], [track.vx_mps, track.vy_mps])),
            );
        }
        self.last = Some((header.seq, header.stamp_ns));
        Ok(())
    }

    fn check(&self, header: &Header, tracks: &[Track]) -> Result<(), Rejected> {
        header.check_agents(tracks.len())?;
        if !header.is_tick() {
            return Ok(());
        }
        equal("history_len", header.counts.history_len as usize, self.history_len)?;
        match self.last {
            Some(last) if header.stamp_ns <= last.1 && !header.begins_session_after(last) => {
                Err(Rejected::NotNewer { stamp_ns: header.stamp_ns, last_ns: last.1 })
            }
            _ => tracks.iter().try_for_each(Track::check),
        }
    }

    fn write_patches(&mut self, header: &Header, agent: usize, track: &Track, out: &mut ContextMut<'_>) {
        if matches!(self.map, Map::None) {
            for step in 0..self.history_len {
                out.patch_mut(agent, step).fill(0.0);
            }
            return;
        }
        let slot = self.cache.claim(track.id, header.stamp_ns);
        let newest = self.history_len - 1;
        for step in 0..self.history_len {
            let patch = out.patch_mut(agent, step);
            let Some(state) = State::of(&track.history[step]) else {
                patch.fill(0.0);
                continue;
            };
            let age_ns = header.step_ns.saturating_mul((newest - step) as u64);
            let stamp_ns = header.stamp_ns.saturating_sub_unsigned(age_ns);
            match self.cache.get(slot, stamp_ns) {
                Some(held) => patch.copy_from_slice(held),
                None => {
                    self.map.patch(&state, self.patch, patch);
                    // Also cache patches of stamps before the track was confirmed. An online map grows, but
                    // the patch of a stamp must stay the same in later ticks.
                    self.cache.put(slot, stamp_ns, patch);
                }
            }
        }
    }
}

impl Map {
    fn patch(&self, state: &State, options: PatchOptions, out: &mut [f32]) {
        match self {
            Self::None => out.fill(0.0),
            Self::Fixed(map) => map.patch(state, options, out),
            Self::Online(map) => map.patch(state, options, out),
        }
    }
}
