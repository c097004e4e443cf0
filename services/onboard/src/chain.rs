use bytemuck::Zeroable;
use evidence::{Evidence, Prior};
use nn::ModelConfig;
use run::Run;
use tracker::Tracker;
use wire::{AGENTS_MAX, Detection, Forecast, Header, StageId, Track, flags};

use crate::{ChainError, Load, TracksToForecasts};

/// All compute stages, one after the other, from detections to forecasts.
pub struct Chain {
    tracker: Tracker,
    rest: TracksToForecasts,
    tracks: Vec<Track>,
    tracks_len: usize,
    /// Header and number of the newest forecasts; `None` before the first ones, or if the sampler refused the
    /// last tick that it received.
    prior: Option<(Header, usize)>,
}

impl Chain {
    /// Sets up all stages of a run with this model from its record.
    ///
    /// # Errors
    /// [`ChainError`] if weights, options, map or retrieval memory can't be used.
    pub fn new(run: &Run, model: &ModelConfig) -> Result<Self, ChainError> {
        let rest = TracksToForecasts::new(run, model)?;
        Ok(Self {
            tracker: Tracker::new(tracker::stage::settings(run, model)?),
            rest,
            tracks: vec![Track::zeroed(); AGENTS_MAX],
            tracks_len: 0,
            prior: None,
        })
    }

    /// Takes a tick through all stages; `passed` is called after each of them.
    ///
    /// If the tracker refuses the tick or the tick is late, there are no forecasts. If a later stage refuses
    /// it, the sampler's fallback forecasts are returned.
    pub fn tick(
        &mut self,
        header: &Header,
        detections: &[Detection],
        mut passed: impl FnMut(StageId),
    ) -> (Header, &[Forecast]) {
        let prior = self.prior.as_ref().map(|(header, len)| (header, self.rest.forecasts(*len)));
        let tracked = self.tracker.step(header, detections, prior, &mut self.tracks);
        let before = header;
        let header = self.tracker.header(before);
        passed(StageId::Tracker);
        self.tracker.audit(before, detections);
        self.tracks_len = tracked.as_ref().map_or(0, |tracked| tracked.tracks_len);
        if !tracked.is_ok_and(|tracked| tracked.replayed_len == 0) {
            return nothing(header);
        }
        match self.rest.step(&header, &self.tracks[..self.tracks_len], passed) {
            Ok((header, forecasts)) => {
                self.prior = Some((header, forecasts.len()));
                (header, forecasts)
            }
            Err(_) => {
                self.prior = None;
                nothing(header)
            }
        }
    }

    /// Saves the retrieval memory if the run's record names a file.
    ///
    /// # Errors
    /// [`ChainError`] if the file can't be written.
    pub fn keep_memory(&self, run: &Run) -> Result<(), ChainError> {
        Ok(sampler::stage::save_memory(run, self.rest.sampler())?)
    }

    /// Replaces the shipped prior of the sampler's experts by `prior`.
    pub fn expect(&mut self, prior: Prior) {
        self.rest.expect(prior);
    }

    /// Continues with the evidence that the sampler of an earlier chain has learned.
    pub fn continue_from(&mut self, earlier: Self) {
        self.rest.continue_from(earlier.rest);
    }

    /// The sampler's evidence on its experts.
    #[must_use]
    pub fn evidence(&self) -> Option<&Evidence> {
        self.rest.sampler().evidence()
    }

    /// The tracks of the last tick; empty if it was refused.
    #[must_use]
    pub fn tracks(&self) -> &[Track] {
        &self.tracks[..self.tracks_len]
    }

    /// How large the last tick was.
    #[must_use]
    pub fn load(&self) -> Load {
        self.rest.load()
    }
}

/// The empty frame after a refused or late tick.
fn nothing(mut header: Header) -> (Header, &'static [Forecast]) {
    header.flags |= flags::VOID;
    header.counts = wire::Counts::default();
    (header, &[])
}
