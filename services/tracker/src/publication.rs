use bytemuck::Zeroable;
use wire::{HistoryState, Track};

use crate::estimate::{Birth, Estimate};
use crate::front::rate_limited_rad;
use crate::history::History;
use crate::options::TrackerOptions;

/// Everything that is published about an agent. A replay never changes it.
#[derive(Clone, Debug)]
pub struct Publication {
    /// The track's identity.
    pub id: u64,
    birth: Birth,
    /// Stamp of the last published frame with an estimate of the agent.
    held_ns: i64,
    /// Whether the track is published.
    is_published: bool,
    /// The heading that was last recorded.
    heading_rad: f64,
    history: History,
}

impl Publication {
    fn new(id: u64, birth: Birth) -> Self {
        Self {
            id,
            birth,
            held_ns: birth.stamp_ns,
            is_published: false,
            heading_rad: 0.0,
            history: History::new(),
        }
    }

    /// Records the estimate's present state in the window, so that it can be published.
    pub fn record(&mut self, estimate: &Estimate) {
        let (now_ns, motion) = (estimate.stamp_ns(), estimate.motion());
        let heading_rad = estimate.heading_rad();
        let limited_rad =
            if self.is_published { rate_limited_rad(self.heading_rad, heading_rad) } else { None };
        self.heading_rad = limited_rad.unwrap_or(heading_rad);
        let state = HistoryState {
            x_m: motion.position_m[0] as f32,
            y_m: motion.position_m[1] as f32,
            vx_mps: motion.velocity_mps[0] as f32,
            vy_mps: motion.velocity_mps[1] as f32,
            heading_rad: self.heading_rad as f32,
            present: 1,
        };
        if estimate.is_ready() && !self.is_published {
            self.is_published = true;
            self.history.backfill(&state);
        }
        // Before the first publication only detected states count, because predictions without a velocity
        // stand still.
        if self.is_published || estimate.is_seen() {
            self.history.push(now_ns, state, *estimate.spread());
        }
        self.held_ns = now_ns;
    }

    /// Writes the track to publish. Its present state must have been recorded.
    pub fn write(&self, estimate: &Estimate, options: &TrackerOptions, track: &mut Track) {
        *track = Track { id: self.id, heading_rad: self.heading_rad as f32, ..Track::zeroed() };
        estimate.write(options.step_ns, track);
        let window = &mut track.history[..options.history_len];
        self.history.window(self.held_ns, options.step_ns, options.gap_max_ns, window);
        let present_count: u32 = window.iter().map(|state| state.present).sum();
        let age_ns = self.held_ns.saturating_sub(track.born_ns).unsigned_abs();
        track.forecastable = u32::from(present_count >= Track::STATES_MIN && age_ns >= options.step_ns);
    }
}

/// All publications, mostly in the order of the estimates.
#[derive(Clone, Debug)]
pub struct Publications {
    all: Vec<Publication>,
    next_id: u64,
    /// Start of the next search.
    next: usize,
    /// Stamp of the last published frame.
    last_ns: i64,
}

impl Publications {
    /// Room for the publications of this number of estimates.
    #[must_use]
    pub fn with_capacity(len: usize) -> Self {
        Self { all: Vec::with_capacity(len), next_id: 1, next: 0, last_ns: i64::MIN }
    }

    /// Sets the ids of new publications, which count from `first`.
    pub const fn set_next_id(&mut self, first: u64) {
        self.next_id = first;
    }

    /// Ends all publications. Their ids are not used again.
    pub fn end_session(&mut self) {
        self.all.clear();
        (self.next, self.last_ns) = (0, i64::MIN);
    }

    /// Continues a track that another tracker has published at `now_ns`.
    pub fn resume(&mut self, track: &Track, birth: Birth, now_ns: i64, history: &History) {
        self.all.push(Publication {
            id: track.id,
            birth,
            held_ns: now_ns,
            is_published: true,
            heading_rad: f64::from(track.heading_rad),
            history: *history,
        });
        self.last_ns = now_ns;
    }

    /// The publication of an agent.
    pub fn find(&mut self, birth: Birth) -> Option<&Publication> {
        self.index_of(birth).map(|index| &self.all[index])
    }

    /// Records an estimate, under a new id if the agent has no publication. Returns the index of the
    /// publication.
    pub fn record(&mut self, estimate: &Estimate) -> usize {
        let index = self.index_of(estimate.birth()).unwrap_or_else(|| {
            self.all.push(Publication::new(self.next_id, estimate.birth()));
            self.next_id += 1;
            self.all.len() - 1
        });
        self.all[index].record(estimate);
        index
    }

    /// The publication at an index that was [recorded](Publications::record) since the last
    /// [prune](Publications::prune).
    #[must_use]
    pub fn at(&self, index: usize) -> &Publication {
        &self.all[index]
    }

    /// Whether a detection of this frame started a publication. This happens only in a replay.
    #[must_use]
    pub fn has_births_at(&self, stamp_ns: i64) -> bool {
        stamp_ns <= self.last_ns && self.all.iter().any(|of| of.birth.stamp_ns == stamp_ns)
    }

    /// Transfers a publication from the detection that started it to an older birth of the same agent. An
    /// out-of-sequence frame has shown the older birth.
    ///
    /// Does nothing if the older birth is already published.
    pub fn transfer(&mut self, from: Birth, to: Birth) {
        let Some(heir) = self.index_of(from) else { return };
        match self.index_of(to) {
            None => self.all[heir].birth = to,
            Some(own) if self.all[heir].is_published && !self.all[own].is_published => {
                self.all[heir].birth = to;
                self.all.remove(own);
            }
            Some(_) => {}
        }
    }

    /// Ends the publishing of a frame. Drops agents without an estimate, unless they are published and a
    /// frame that is not older than `oldest_ns` may bring them back.
    pub fn prune(&mut self, now_ns: i64, oldest_ns: i64) {
        self.all.retain(|of| of.held_ns == now_ns || (of.is_published && of.held_ns >= oldest_ns));
        self.last_ns = now_ns;
    }

    fn index_of(&mut self, birth: Birth) -> Option<usize> {
        if birth.stamp_ns > self.last_ns {
            return None;
        }
        let len = self.all.len();
        let next = self.next.min(len);
        let index = (next..len).chain(0..next).find(|&index| self.all[index].birth == birth)?;
        self.next = index + 1;
        Some(index)
    }
}
