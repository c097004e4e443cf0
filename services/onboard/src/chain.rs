use decoder::{Decoder, DecoderOptions};
use encoder::{Encoder, EncoderOptions};
use evidence::{Evidence, Prior};
use extractor::{Effort, Extractor, ExtractorOptions};
use localiser::{Localiser, LocaliserOptions};
use nn::{ModelConfig, StartError, Weights};
use ports::{Allowance, NoTopic, Second, Step, Tick};
use run::Run;
use sampler::Sampler;
use tracker::Tracker;
use wire::{
    ContextTopic, ControlsTopic, Detection, EncodingsTopic, FeatureShape, Features, FeaturesTopic, Forecast,
    ForecastsTopic, Header, Rejected, StageId, Topic, Track, TracksTopic, flags,
};

use crate::{ChainError, Load, OwnFrame};

/// All compute stages, one after the other, from detections to forecasts.
pub struct Chain {
    tracker: Tracker,
    rest: TracksToForecasts,
    tracks: OwnFrame<TracksTopic>,
    /// The newest forecasts that the tracker has received.
    prior: OwnFrame<ForecastsTopic>,
    refusal: Option<Rejected>,
}

/// The stages that start at a `tracks` payload: localiser, extractor, encoder, decoder and sampler.
pub struct TracksToForecasts {
    features: TracksToFeatures,
    controls: FeaturesToControls,
    sampler: Sampler,
    frame: OwnFrame<FeaturesTopic>,
    forecasts: OwnFrame<ForecastsTopic>,
}

/// Localiser and extractor. They keep maps and embeddings of earlier ticks.
pub struct TracksToFeatures {
    localiser: Localiser,
    extractor: Extractor,
    context: OwnFrame<ContextTopic>,
}

/// Encoder and decoder. Their output for a tick does not depend on other ticks.
pub struct FeaturesToControls {
    encoder: Encoder,
    decoder: Decoder,
    /// The encodings of the last tick.
    pub encodings: OwnFrame<EncodingsTopic>,
    /// The controls of the last tick.
    pub controls: OwnFrame<ControlsTopic>,
}

/// Answers a frame by a step that serves all agents; `passed` is called after the step.
fn take_through<S: Step<Second = NoTopic>>(
    (id, step): (StageId, &mut S),
    (header, input): (&Header, &[<S::Input as Topic>::Element]),
    out: &mut OwnFrame<S::Output>,
    passed: &mut impl FnMut(StageId),
) -> Result<(), Rejected> {
    let tick = Tick { header, input, second: Second::None, allowance: Allowance::All };
    out.answer(step, &tick, || passed(id))
}

impl Chain {
    /// Sets up all stages of a run with this model from its record.
    ///
    /// # Errors
    /// [`ChainError`] if weights, options, map or retrieval memory can't be used.
    pub fn new(run: &Run, model: &ModelConfig) -> Result<Self, ChainError> {
        let tracker = Tracker::new(tracker::settings(run, model)?);
        Ok(Self::of_stages(tracker, TracksToForecasts::new(run, model)?))
    }

    /// Joins a tracker and later stages of the same model.
    #[must_use]
    pub fn of_stages(tracker: Tracker, rest: TracksToForecasts) -> Self {
        Self { tracker, rest, tracks: OwnFrame::default(), prior: OwnFrame::default(), refusal: None }
    }

    /// Takes a tick through all stages; `passed` is called after each stage that answers it.
    ///
    /// If the tracker refuses the tick or the tick is late, there are no forecasts. If a later stage refuses
    /// it, the sampler's fallback forecasts are returned.
    pub fn tick(
        &mut self,
        header: &Header,
        detections: &[Detection],
        mut passed: impl FnMut(StageId),
    ) -> (Header, &[Forecast]) {
        let Self { tracker, rest, tracks, prior, refusal } = self;
        // After a VOID frame the tracker keeps the older forecasts.
        if !header.has(flags::VOID) && !rest.forecasts.is_void() {
            std::mem::swap(prior, &mut rest.forecasts);
        }
        let second = if prior.is_void() { Second::None } else { prior.as_second() };
        let tick = Tick { header, input: detections, second, allowance: Allowance::All };
        // A refused tick leaves a VOID frame.
        *refusal = tracks.answer(tracker, &tick, || passed(StageId::Tracker)).err();
        if tracks.is_void() {
            rest.forecasts.make_void(tracks.header);
            return (tracks.header, &[]);
        }
        let _ = rest.answer(tracks.parts(), passed);
        (rest.forecasts.header, &rest.forecasts.elements)
    }

    /// Saves the retrieval memory if the run's record names a file.
    ///
    /// # Errors
    /// [`ChainError`] if the file can't be written.
    pub fn keep_memory(&self, run: &Run) -> Result<(), ChainError> {
        Ok(sampler::save_memory(run, &self.rest.sampler)?)
    }

    /// Replaces the shipped prior of the sampler's experts by `prior`.
    pub fn expect(&mut self, prior: Prior) {
        self.rest.sampler.expect(prior);
    }

    /// Continues with the evidence that the sampler of an earlier chain has learned.
    pub fn continue_from(&mut self, earlier: Self) {
        self.rest.sampler.continue_from(earlier.rest.sampler);
    }

    /// The sampler's evidence on its experts.
    pub fn evidence(&self) -> Option<&Evidence> {
        self.rest.sampler.evidence()
    }

    /// Why the tracker has refused the last tick, if it has.
    pub const fn refusal(&self) -> Option<&Rejected> {
        self.refusal.as_ref()
    }

    /// The tracks of the last tick; empty if it was refused.
    pub fn tracks(&self) -> &[Track] {
        &self.tracks.elements
    }

    /// Tracks and forecasts of the last tick.
    pub const fn frames(&self) -> (&OwnFrame<TracksTopic>, &OwnFrame<ForecastsTopic>) {
        (&self.tracks, &self.rest.forecasts)
    }

    /// How large the last tick was.
    pub fn load(&self) -> Load {
        self.rest.load()
    }
}

impl TracksToForecasts {
    /// Sets up the stages of a run with this model from its record.
    ///
    /// # Errors
    /// [`ChainError`] if weights, options, map or retrieval memory can't be used.
    pub fn new(run: &Run, model: &ModelConfig) -> Result<Self, ChainError> {
        let weights = Weights::of_model(run.weights.as_deref(), model)?;
        let localiser = localiser::settings(run, model)?;
        let features = TracksToFeatures::new(&weights, localiser, extractor::settings(run)?)?;
        let controls = FeaturesToControls::new(&weights, encoder::settings(run)?, decoder::settings(run)?)?;
        Ok(Self::of_stages(features, controls, sampler::open(run, model)?))
    }

    /// Joins stages of the same model.
    #[must_use]
    pub fn of_stages(features: TracksToFeatures, controls: FeaturesToControls, sampler: Sampler) -> Self {
        Self { features, controls, sampler, frame: OwnFrame::default(), forecasts: OwnFrame::default() }
    }

    /// Forecasts the tracks of a tick, in their order, with the header of the forecasts.
    ///
    /// If a stage before the sampler refuses the tick, the sampler's fallback forecasts are returned.
    ///
    /// # Errors
    /// [`Rejected`] if the sampler refuses header or tracks.
    pub fn step(&mut self, header: &Header, tracks: &[Track]) -> Result<(Header, &[Forecast]), Rejected> {
        self.answer((header, tracks), |_| ())?;
        Ok((self.forecasts.header, &self.forecasts.elements))
    }

    fn answer(
        &mut self,
        (header, input): (&Header, &[Track]),
        mut passed: impl FnMut(StageId),
    ) -> Result<(), Rejected> {
        let Self { features, controls, sampler, frame, forecasts } = self;
        let learned =
            features.step(header, input, frame, &mut passed).and_then(|()| controls.step(frame, &mut passed));
        let second = learned.map_or(Second::Refused, |()| controls.controls.as_second());
        let tick = Tick { header, input, second, allowance: Allowance::All };
        forecasts.answer(sampler, &tick, || passed(StageId::Sampler))
    }

    /// The size of the last tick.
    pub fn load(&self) -> Load {
        self.controls.load(&self.frame)
    }
}

impl TracksToFeatures {
    /// Stages before their first tick.
    ///
    /// # Errors
    /// [`StartError`] if the weights do not contain the model or a thread can't be started.
    pub fn new(
        weights: &Weights,
        localiser: LocaliserOptions,
        extractor: ExtractorOptions,
    ) -> Result<Self, StartError> {
        let (localiser, extractor) = (Localiser::new(localiser), Extractor::new(weights, extractor)?);
        Ok(Self { localiser, extractor, context: OwnFrame::default() })
    }

    /// Takes the tracks of a tick to features; `passed` is called after each stage that answers it.
    ///
    /// # Errors
    /// [`Rejected`] if a stage refuses the tick. `out` is then VOID.
    pub fn step(
        &mut self,
        header: &Header,
        tracks: &[Track],
        out: &mut OwnFrame<FeaturesTopic>,
        mut passed: impl FnMut(StageId),
    ) -> Result<(), Rejected> {
        let Self { localiser, extractor, context } = self;
        let located = take_through((StageId::Localiser, localiser), (header, tracks), context, &mut passed);
        let extracted = take_through((StageId::Extractor, extractor), context.parts(), out, &mut passed);
        located.and(extracted)
    }

    /// The extractor's work for the last tick, and the number of edges that it left out.
    pub const fn effort(&self) -> Effort {
        self.extractor.effort()
    }
}

impl FeaturesToControls {
    /// Stages with the model's networks.
    ///
    /// # Errors
    /// [`StartError`] if the weights do not contain the model or a thread can't be started.
    pub fn new(
        weights: &Weights,
        encoder: EncoderOptions,
        decoder: DecoderOptions,
    ) -> Result<Self, StartError> {
        Ok(Self {
            encoder: Encoder::new(weights, encoder)?,
            decoder: Decoder::new(weights, decoder)?,
            encodings: OwnFrame::default(),
            controls: OwnFrame::default(),
        })
    }

    /// Takes the features of a tick to controls; `passed` is called after each stage that answers it.
    ///
    /// # Errors
    /// [`Rejected`] if a stage refuses the tick. The controls are then VOID.
    pub fn step(
        &mut self,
        features: &OwnFrame<FeaturesTopic>,
        mut passed: impl FnMut(StageId),
    ) -> Result<(), Rejected> {
        let Self { encoder, decoder, encodings, controls } = self;
        let encoded = take_through((StageId::Encoder, encoder), features.parts(), encodings, &mut passed);
        let decoded = take_through((StageId::Decoder, decoder), encodings.parts(), controls, &mut passed);
        encoded.and(decoded)
    }

    /// The size of the last tick.
    #[must_use]
    pub fn load(&self, features: &OwnFrame<FeaturesTopic>) -> Load {
        let counts = &features.header.counts;
        let shape = FeatureShape::of(counts);
        match Features::read(&features.elements, shape, counts.history_len as usize) {
            Ok(features) => Load::of(&features, &self.encodings.elements, counts.history_len),
            Err(_) => Load::default(),
        }
    }
}
