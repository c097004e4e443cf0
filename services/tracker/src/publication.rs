use bytemuck::Zeroable;
use wire::{HistoryState, Track};

use crate::estimate::{Birth, Estimate};
use crate::front::under_way_rad;
use crate::history::History;
use crate::options::TrackerOptions;

/// What the other stages have been told of an agent: no replay changes it.
#[derive(Clone, Debug)]
pub struct Publication {
    /// The track's identity.
    pub id: u64,
    birth: Birth,
    /// Stamp of the last frame published at which there was an estimate of the agent.
    held_ns: i64,
    /// Whether the track has been published.
    begun: bool,
    /// The heading as it was last recorded.
    heading_rad: f64,
    history: History,
}

impl Publication {
    fn new(id: u64, birth: Birth) -> Self {
        Self { id, birth, held_ns: birth.stamp_ns, begun: false, heading_rad: 0.0, history: History::new() }
    }

    /// Keeps the estimate's state of now for the window, so that it can be published.
    pub fn record(&mut self, estimate: &Estimate) {
        let (now_ns, motion) = (estimate.stamp_ns(), estimate.motion());
        let heading_rad = estimate.heading_rad();
        let under_way_rad = if self.begun { under_way_rad(self.heading_rad, heading_rad) } else { None };
        self.heading_rad = under_way_rad.unwrap_or(heading_rad);
        let state = HistoryState {
            x_m: motion.position_m[0] as f32,
            y_m: motion.position_m[1] as f32,
            vx_mps: motion.velocity_mps[0] as f32,
            vy_mps: motion.velocity_mps[1] as f32,
            heading_rad: self.heading_rad as f32,
            present: 1,
        };
        if estimate.is_ready() && !self.begun {
            self.begun = true;
            self.history.backfill(&state);
        }
        // Before the first publication only what was detected counts: predictions without a velocity stand still.
        if self.begun || estimate.is_seen() {
            self.history.push(now_ns, state);
        }
        self.held_ns = now_ns;
    }

    /// Writes the track as it is published; the state of now must have been recorded.
    pub fn write(&self, estimate: &Estimate, options: &TrackerOptions, track: &mut Track) {
        *track = Track { id: self.id, heading_rad: self.heading_rad as f32, ..Track::zeroed() };
        estimate.write(options.step_ns, track);
        let window = &mut track.history[..options.history_len];
        self.history.window(self.held_ns, options.step_ns, options.gap_max_ns, window);
        let present_len: u32 = window.iter().map(|state| state.present).sum();
        let age_ns = self.held_ns.saturating_sub(track.born_ns).unsigned_abs();
        track.forecastable = u32::from(present_len >= 2 && age_ns >= options.step_ns);
    }
}

/// All publications, mostly in the order of the estimates.
#[derive(Clone, Debug)]
pub struct Publications {
    all: Vec<Publication>,
    next_id: u64,
    /// Where the next search begins.
    next: usize,
    /// Stamp of the last frame published.
    last_ns: i64,
}

impl Publications {
    /// Room for those of so many estimates.
    #[must_use]
    pub fn with_capacity(len: usize) -> Self {
        Self { all: Vec::with_capacity(len), next_id: 1, next: 0, last_ns: i64::MIN }
    }

    /// What has been told of an agent.
    pub fn find(&mut self, birth: Birth) -> Option<&Publication> {
        self.place(birth).map(|place| &self.all[place])
    }

    /// Records an estimate, under a new id where nothing has been told of the agent; returns the publication's place.
    pub fn record(&mut self, estimate: &Estimate) -> usize {
        let place = self.place(estimate.birth()).unwrap_or_else(|| {
            self.all.push(Publication::new(self.next_id, estimate.birth()));
            self.next_id += 1;
            self.all.len() - 1
        });
        self.all[place].record(estimate);
        place
    }

    /// The publication at a place that was [recorded](Publications::record) since the last that were let go.
    #[must_use]
    pub fn at(&self, place: usize) -> &Publication {
        &self.all[place]
    }

    /// Whether an agent has been told of that a detection of that frame started: only where frames are taken in again.
    #[must_use]
    pub fn has_births_at(&self, stamp_ns: i64) -> bool {
        stamp_ns <= self.last_ns && self.all.iter().any(|of| of.birth.stamp_ns == stamp_ns)
    }

    /// Hands on the identity of the agent that a detection had started: a late frame shows that it was there before.
    ///
    /// Nothing happens where the agent of the older birth has been told of already.
    pub fn hand_on(&mut self, from: Birth, to: Birth) {
        let Some(heir) = self.place(from) else { return };
        match self.place(to) {
            None => self.all[heir].birth = to,
            Some(own) if self.all[heir].begun && !self.all[own].begun => {
                self.all[heir].birth = to;
                self.all.remove(own);
            }
            Some(_) => {}
        }
    }

    /// Ends the publishing of a frame: lets go of agents of whom there is no estimate, unless they were published and a
    /// frame not before `oldest_ns` may bring them back.
    pub fn settle(&mut self, now_ns: i64, oldest_ns: i64) {
        self.all.retain(|of| of.held_ns == now_ns || (of.begun && of.held_ns >= oldest_ns));
        self.last_ns = now_ns;
    }

    fn place(&mut self, birth: Birth) -> Option<usize> {
        if birth.stamp_ns > self.last_ns {
            return None;
        }
        let len = self.all.len();
        let next = self.next.min(len);
        let place = (next..len).chain(0..next).find(|&place| self.all[place].birth == birth)?;
        self.next = place + 1;
        Some(place)
    }
}
