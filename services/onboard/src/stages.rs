use decoder::Decoder;
use encoder::Encoder;
use extractor::Extractor;
use localiser::Localiser;
use nn::{ModelConfig, Weights};
use ports::{Allowance, Second, Step, Tick};
use run::Run;
use sampler::Sampler;
use sampler::journal::{Identity, Journal, Storage};
use tracker::Tracker;
use wire::{
    ContextTopic, ControlsTopic, Detection, EncodingsTopic, FeaturesTopic, ForecastsTopic, Header, StageId,
    TracksTopic,
};

use crate::{ChainError, OwnFrame};

/// The compute stages in this process and without a clock. Each works from frame to frame, as in its own
/// process.
///
/// A stage can be renewed alone, as its process is when it is restarted.
pub struct Stages {
    run: Run,
    model: ModelConfig,
    weights: Weights,
    tracker: Tracker,
    localiser: Localiser,
    extractor: Extractor,
    encoder: Encoder,
    decoder: Decoder,
    sampler: Sampler,
}

/// A step's answer to a frame.
fn answer<S: Step>(
    step: &mut S,
    (header, input): (&Header, &[<S::Input as wire::Topic>::Element]),
    second: Second<'_, S::Second>,
    allowance: Allowance<'_>,
) -> OwnFrame<S::Output> {
    let mut out = OwnFrame::default();
    // A refused tick leaves a VOID frame, which is compared with the recorded frame.
    let _ = out.answer(step, &Tick { header, input, second, allowance }, || ());
    out
}

impl Stages {
    /// Sets up all stages of a run from its record.
    ///
    /// # Errors
    /// [`ChainError`] if weights, options, map or retrieval memory can't be used.
    pub fn new(run: &Run, weights: Weights) -> Result<Self, ChainError> {
        let model = weights.config().clone();
        let mut sampler = sampler::open(run, &model)?;
        sampler.keep_in(journal(run, &sampler));
        Ok(Self {
            tracker: Tracker::new(tracker::settings(run, &model)?),
            localiser: Localiser::new(localiser::settings(run, &model)?),
            extractor: Extractor::new(&weights, extractor::settings(run)?)?,
            encoder: Encoder::new(&weights, encoder::settings(run)?)?,
            decoder: Decoder::new(&weights, decoder::settings(run)?)?,
            sampler,
            run: run.clone(),
            model,
            weights,
        })
    }

    /// Replaces a stage by a new one, as a restart of its process does; `incarnation` counts these restarts.
    /// Encoder and decoder are kept, because they keep nothing from tick to tick.
    ///
    /// # Errors
    /// As [`Stages::new`].
    pub fn renew(&mut self, stage: StageId, incarnation: u32) -> Result<(), ChainError> {
        let Self { run, model, weights, .. } = self;
        match stage {
            StageId::Tracker => {
                self.tracker = Tracker::new(tracker::settings(run, model)?).with_ids_of(incarnation);
            }
            StageId::Localiser => self.localiser = Localiser::new(localiser::settings(run, model)?),
            StageId::Extractor => {
                self.extractor = Extractor::new(weights, extractor::settings(run)?)?;
            }
            StageId::Sampler => {
                let journal = self.sampler.take_journal();
                self.sampler = sampler::open(run, model)?;
                self.sampler.keep_in(journal);
            }
            _ => {}
        }
        Ok(())
    }

    /// Resumes a new sampler with the state after `ticks` ticks of the previous one, or with an empty state
    /// if 0. Returns whether that state is known.
    pub fn resume_sampler(&mut self, ticks: u32) -> bool {
        self.sampler.resume_after(ticks)
    }

    /// The tracker's answer to detections and the available forecasts.
    pub fn track(
        &mut self,
        header: &Header,
        detections: &[Detection],
        prior: Option<&OwnFrame<ForecastsTopic>>,
    ) -> OwnFrame<TracksTopic> {
        let prior = prior.map_or(Second::None, OwnFrame::as_second);
        answer(&mut self.tracker, (header, detections), prior, Allowance::All)
    }

    /// The localiser's answer to tracks.
    pub fn locate(&mut self, tracks: &OwnFrame<TracksTopic>) -> OwnFrame<ContextTopic> {
        answer(&mut self.localiser, tracks.parts(), Second::None, Allowance::All)
    }

    /// The extractor's answer to a context.
    pub fn extract(
        &mut self,
        context: &OwnFrame<ContextTopic>,
        allowance: Allowance<'_>,
    ) -> OwnFrame<FeaturesTopic> {
        answer(&mut self.extractor, context.parts(), Second::None, allowance)
    }

    /// The encoder's answer to features.
    pub fn encode(
        &mut self,
        features: &OwnFrame<FeaturesTopic>,
        allowance: Allowance<'_>,
    ) -> OwnFrame<EncodingsTopic> {
        answer(&mut self.encoder, features.parts(), Second::None, allowance)
    }

    /// The decoder's answer to encodings.
    pub fn decode(
        &mut self,
        encodings: &OwnFrame<EncodingsTopic>,
        allowance: Allowance<'_>,
    ) -> OwnFrame<ControlsTopic> {
        answer(&mut self.decoder, encodings.parts(), Second::None, allowance)
    }

    /// The sampler's answer to tracks, with their controls if these were in time.
    pub fn sample(
        &mut self,
        tracks: &OwnFrame<TracksTopic>,
        controls: Option<&OwnFrame<ControlsTopic>>,
    ) -> OwnFrame<ForecastsTopic> {
        let controls = controls.map_or(Second::None, OwnFrame::as_second);
        answer(&mut self.sampler, tracks.parts(), controls, Allowance::All)
    }
}

/// The journal of the sampler's state, with the same identity as in the sampler's process; `None` if that
/// process keeps none.
fn journal(run: &Run, sampler: &Sampler) -> Option<Journal<Box<dyn Storage + Send>>> {
    let identity = Identity::of(run.id, sampler.options()).filter(|_| !run.lockstep)?;
    let memory: Box<dyn Storage + Send> = Box::new(Vec::<u64>::new());
    let mut journal = Journal::over(memory, identity);
    journal.clear().is_ok().then_some(journal)
}
