use bytemuck::Zeroable;
use evidence::Prior;
use nn::{ModelConfig, Weights};
use run::Run;
use sampler::Sampler;
use wire::{AGENTS_MAX, Cause, Forecast, Header, Rejected, StageId, Track};

use crate::{ChainError, FeatureFrame, FeaturesToControls, Load, TracksToFeatures};

/// The stages from a `tracks` payload on: localiser, extractor, encoder, decoder and sampler.
pub struct TracksToForecasts {
    features: TracksToFeatures,
    controls: FeaturesToControls,
    sampler: Sampler,
    frame: FeatureFrame,
    forecasts: Vec<Forecast>,
}

impl TracksToForecasts {
    /// Sets up the stages of a run with this model from its record.
    ///
    /// # Errors
    /// [`ChainError`] if weights, options, map or retrieval memory can't be used.
    pub fn new(run: &Run, model: &ModelConfig) -> Result<Self, ChainError> {
        let weights = Weights::of_model(run.weights.as_deref(), model)?;
        let localiser = localiser::stage::settings(run, model)?;
        let features = TracksToFeatures::new(&weights, localiser, extractor::stage::settings(run)?)?;
        let (encoder, decoder) = (encoder::stage::settings(run)?, decoder::stage::settings(run)?);
        let controls = FeaturesToControls::new(&weights, encoder, decoder)?;
        Ok(Self::of_stages(features, controls, sampler::stage::open(run, model)?))
    }

    /// Joins stages of the same model.
    #[must_use]
    pub fn of_stages(features: TracksToFeatures, controls: FeaturesToControls, sampler: Sampler) -> Self {
        Self {
            features,
            controls,
            sampler,
            frame: FeatureFrame::default(),
            forecasts: vec![Forecast::zeroed(); AGENTS_MAX],
        }
    }

    /// Forecasts the tracks of a tick, in their order, with the header of the forecasts; `passed` is called
    /// after each stage.
    ///
    /// If a stage before the sampler refuses the tick, the sampler's fallback forecasts are returned.
    ///
    /// # Errors
    /// [`Rejected`] if the sampler refuses header or tracks.
    pub fn step(
        &mut self,
        header: &Header,
        tracks: &[Track],
        mut passed: impl FnMut(StageId),
    ) -> Result<(Header, &[Forecast]), Rejected> {
        let Self { features, controls, sampler, frame, forecasts, .. } = self;
        let forecasts = &mut forecasts[..tracks.len()];
        let learned = features
            .step(header, tracks, frame, &mut passed)
            .and_then(|()| controls.step(frame, &mut passed))
            .and_then(|made| sampler.learned(header, tracks, made.controls, forecasts));
        let result = learned.or_else(|_| sampler.fallback(header, tracks, Cause::Rejected, forecasts));
        passed(StageId::Sampler);
        result?;
        let mut header = *header;
        (header.counts.horizon_len, header.counts.modes_len) = controls.lens();
        Ok((header, forecasts))
    }

    /// The forecasts of the last tick, the first `len`.
    ///
    /// # Panics
    /// If `len` exceeds the payload's capacity.
    #[must_use]
    pub fn forecasts(&self, len: usize) -> &[Forecast] {
        &self.forecasts[..len]
    }

    /// Replaces the shipped prior of the sampler's experts by `prior`.
    pub(crate) fn expect(&mut self, prior: Prior) {
        self.sampler.expect(prior);
    }

    /// Continues with the evidence that the sampler of earlier stages has learned.
    pub(crate) fn continue_from(&mut self, earlier: Self) {
        self.sampler.continue_from(earlier.sampler);
    }

    /// The sampler, with its retrieval memory.
    #[must_use]
    pub const fn sampler(&self) -> &Sampler {
        &self.sampler
    }

    /// How large the last tick was.
    #[must_use]
    pub fn load(&self) -> Load {
        self.controls.load(&self.frame)
    }
}
