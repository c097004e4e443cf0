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
    /// Header and number of the newest forecasts, where there are any: those of a late tick are none.
    prior: Option<(Header, usize)>,
}

impl Chain {
    /// Sets up all stages of a run with that model from its record.
    ///
    /// # Errors
    /// [`ChainError`] where weights, options, map or retrieval memory can't be used.
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
    /// A tick that the tracker refuses, or that came late, has no forecasts; one that a later stage refuses
    /// has those of the sampler's fallback.
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

    /// Saves the retrieval memory where the run's record wants it.
    ///
    /// # Errors
    /// [`ChainError`] where it can't be written.
    pub fn keep_memory(&self, run: &Run) -> Result<(), ChainError> {
        Ok(sampler::stage::save_memory(run, self.rest.sampler())?)
    }

    /// Expects of the sampler's experts what `prior` says, not what is shipped.
    pub fn expect(&mut self, prior: Prior) {
        self.rest.expect(prior);
    }

    /// Goes on with what an earlier chain's sampler has learned of its experts.
    pub fn continue_from(&mut self, earlier: Self) {
        self.rest.continue_from(earlier.rest);
    }

    /// The sampler's evidence on its experts.
    #[must_use]
    pub fn evidence(&self) -> Option<&Evidence> {
        self.rest.sampler().evidence()
    }

    /// The tracks of the last tick; none where it was refused.
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

/// The empty frame that follows a tick which was refused, or came late.
fn nothing(mut header: Header) -> (Header, &'static [Forecast]) {
    header.flags |= flags::VOID;
    header.counts = wire::Counts::default();
    (header, &[])
}
