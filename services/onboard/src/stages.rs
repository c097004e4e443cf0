use bytemuck::Zeroable;
use decoder::Decoder;
use encoder::Encoder;
use extractor::Extractor;
use localiser::Localiser;
use nn::{ModelConfig, Weights};
use run::Run;
use sampler::journal::{Identity, Journal};
use sampler::{Sampler, SamplerOptions};
use tracker::Tracker;
use wire::{
    AGENTS_MAX, AgentControls, AgentEncoding, Cause, Context, ContextMut, ContextShape, ContextTopic,
    ControlsTopic, Counts, Detection, EncodingsTopic, FeatureShape, Features, FeaturesMut, FeaturesTopic,
    Forecast, ForecastsTopic, Header, Rejected, Row, StageId, Topic, Track, TracksTopic, context_rows,
    feature_rows, flags,
};

use crate::ChainError;

/// A frame in owned memory.
#[derive(Clone, Debug)]
pub struct OwnFrame<T: Topic> {
    /// Its header, without clocks, and without hops except those of the input.
    pub header: Header,
    /// Its elements.
    pub elements: Vec<T::Element>,
}

impl<T: Topic> OwnFrame<T> {
    /// A stage's output for a tick that it refuses or that an earlier stage refused.
    fn void(header: &Header) -> Self {
        let (flags, counts) = (header.flags | flags::VOID, Counts::default());
        Self { header: Header { flags, counts, ..*header }, elements: Vec::new() }
    }

    fn is_void(&self) -> bool {
        self.header.has(flags::VOID)
    }
}

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
    /// The state that outlives the sampler; `None` if the run kept nothing.
    journal: Option<Journal<Vec<u64>>>,
    tracks: Vec<Track>,
}

impl Stages {
    /// Sets up all stages of a run from its record.
    ///
    /// # Errors
    /// [`ChainError`] if weights, options, map or retrieval memory can't be used.
    pub fn new(run: &Run, weights: Weights) -> Result<Self, ChainError> {
        let model = weights.config().clone();
        let sampler = sampler::stage::open(run, &model)?;
        let journal = journal(run, sampler.options());
        Ok(Self {
            tracker: Tracker::new(tracker::stage::settings(run, &model)?),
            localiser: Localiser::new(localiser::stage::settings(run, &model)?),
            extractor: Extractor::new(&weights, extractor::stage::settings(run)?)?,
            encoder: Encoder::new(&weights, encoder::stage::settings(run)?)?,
            decoder: Decoder::new(&weights, decoder::stage::settings(run)?)?,
            sampler,
            journal,
            tracks: vec![Track::zeroed(); AGENTS_MAX],
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
                self.tracker = Tracker::new(tracker::stage::settings(run, model)?).with_ids_of(incarnation);
            }
            StageId::Localiser => self.localiser = Localiser::new(localiser::stage::settings(run, model)?),
            StageId::Extractor => {
                self.extractor = Extractor::new(weights, extractor::stage::settings(run)?)?;
            }
            StageId::Sampler => self.sampler = sampler::stage::open(run, model)?,
            _ => {}
        }
        Ok(())
    }

    /// Resumes a new sampler with the state after `ticks` ticks of the previous one, or with an empty state
    /// if 0. Returns whether that state is known.
    pub fn resume_sampler(&mut self, ticks: u32) -> bool {
        let Some(journal) = &mut self.journal else { return ticks == 0 };
        let resumed = match ticks {
            0 => None,
            _ => journal.resume(Some(ticks.into())).ok().flatten(),
        };
        if let Some(resumed) = resumed {
            return self.sampler.resume(resumed).is_ok();
        }
        journal.clear().is_ok() && ticks == 0
    }

    /// The tracker's answer to detections and the available forecasts.
    pub fn track(
        &mut self,
        header: &Header,
        detections: &[Detection],
        prior: Option<(&Header, &[Forecast])>,
    ) -> OwnFrame<TracksTopic> {
        let tracked = self.tracker.step(header, detections, prior, &mut self.tracks);
        let given = header;
        let mut header = self.tracker.header(given);
        self.tracker.audit(given, detections);
        match tracked {
            Ok(tracked) if tracked.replayed_len == 0 => {
                let tracks = &mut self.tracks[..tracked.tracks_len];
                if !header.has(flags::LOCKSTEP) {
                    tracker::feedback::tell(&mut header, tracks, prior);
                }
                OwnFrame { header, elements: tracks.to_vec() }
            }
            // The detections are out of sequence, or refused.
            Ok(_) | Err(_) => OwnFrame::void(&header),
        }
    }

    /// The localiser's answer to tracks.
    pub fn locate(&mut self, tracks: &OwnFrame<TracksTopic>) -> OwnFrame<ContextTopic> {
        if tracks.is_void() {
            return OwnFrame::void(&tracks.header);
        }
        let shape = self.localiser.shape(tracks.elements.len());
        let mut header = tracks.header;
        header.counts.patch_side = shape.patch_side as u32;
        let mut elements = vec![Row::zeroed(); context_rows(&shape)];
        let located = ContextMut::over(&mut elements, shape)
            .and_then(|mut context| self.localiser.step(&tracks.header, &tracks.elements, &mut context));
        or_void(header, located.map(|()| elements))
    }

    /// The extractor's answer to a context. It had time for `served_max` agents; `None` means that it did not
    /// have to choose.
    pub fn extract(
        &mut self,
        context: &OwnFrame<ContextTopic>,
        served_max: Option<usize>,
    ) -> OwnFrame<FeaturesTopic> {
        if context.is_void() {
            return OwnFrame::void(&context.header);
        }
        let mut header = context.header;
        let read = Context::read(&context.elements, ContextShape::of(&header.counts));
        let extracted = read.and_then(|read| self.extractor.prepare_most(&context.header, &read, served_max));
        let written = extracted.and_then(|shape| {
            header.counts.edges_len = shape.edges_len as u32;
            let mut elements = vec![Row::zeroed(); feature_rows(&shape)];
            self.extractor.write(&mut FeaturesMut::over(&mut elements, shape)?);
            Ok(elements)
        });
        or_void(header, written)
    }

    /// The encoder's answer to features, if it had time for `served_max` agents.
    pub fn encode(
        &mut self,
        features: &OwnFrame<FeaturesTopic>,
        served_max: usize,
    ) -> OwnFrame<EncodingsTopic> {
        if features.is_void() {
            return OwnFrame::void(&features.header);
        }
        let counts = &features.header.counts;
        let mut elements = vec![AgentEncoding::zeroed(); counts.agents_len as usize];
        let read = Features::read(&features.elements, FeatureShape::of(counts), counts.history_len as usize);
        let encoded =
            read.and_then(|read| self.encoder.step_most(&features.header, &read, served_max, &mut elements));
        or_void(features.header, encoded.map(|_| elements))
    }

    /// The decoder's answer to encodings, without the agents that the recorded frame lists as shed.
    pub fn decode(
        &mut self,
        encodings: &OwnFrame<EncodingsTopic>,
        recorded: Option<&Header>,
    ) -> OwnFrame<ControlsTopic> {
        if encodings.is_void() {
            return OwnFrame::void(&encodings.header);
        }
        let mut header = encodings.header;
        let mut encodings = encodings.clone();
        for (place, agent) in encodings.elements.iter_mut().enumerate() {
            let is_shed = agent.shed != 0 || recorded.is_some_and(|recorded| recorded.is_shed(place));
            if agent.forecastable != 0 && is_shed {
                agent.shed = 1;
                header.mark_shed(place);
            }
        }
        let mut elements = vec![AgentControls::zeroed(); Decoder::len(&encodings.elements)];
        header.counts.agents_len = elements.len() as u32;
        (header.counts.horizon_len, header.counts.modes_len) = self.lens();
        let decoded = self.decoder.step(&encodings.header, &encodings.elements, &mut elements);
        or_void(header, decoded.map(|()| elements))
    }

    /// The sampler's answer to tracks, with their controls if these were in time.
    pub fn sample(
        &mut self,
        tracks: &OwnFrame<TracksTopic>,
        controls: Option<&OwnFrame<ControlsTopic>>,
    ) -> OwnFrame<ForecastsTopic> {
        if tracks.is_void() {
            return OwnFrame::void(&tracks.header);
        }
        let (mut header, tracks) = (tracks.header, &tracks.elements);
        let mut elements = vec![Forecast::zeroed(); tracks.len()];
        let learned = match controls {
            Some(controls) if !controls.is_void() => {
                header.shed = controls.header.shed;
                let learned = self.sampler.learned(&header, tracks, &controls.elements, &mut elements);
                learned.map_err(|_| Cause::Rejected)
            }
            Some(_) => Err(Cause::Rejected),
            None => Err(Cause::Late),
        };
        let written = match learned {
            Ok(written) => Ok(written),
            Err(cause) => self.sampler.fallback(&header, tracks, cause, &mut elements),
        };
        if let Some(journal) = &mut self.journal
            && self.sampler.commit(header.seq + 1, journal).is_err()
        {
            self.journal = None;
        }
        let tracks_header = header;
        header.resumed_ticks = self.sampler.resumed_ticks();
        (header.counts.horizon_len, header.counts.modes_len) = self.lens();
        match written {
            Ok(written) => {
                if written < tracks.len() {
                    header.counts.agents_len = written as u32;
                    header.silent_len = (tracks.len() - written) as u32;
                    elements.truncate(written);
                }
                OwnFrame { header, elements }
            }
            Err(_) => OwnFrame::void(&tracks_header),
        }
    }

    /// Number of steps of the model's horizon, and number of its modes.
    fn lens(&self) -> (u32, u32) {
        (self.model.horizon_len as u32, self.model.modes as u32)
    }
}

/// The journal of the sampler's state, with the same identity as in the sampler's process; `None` if that
/// process keeps none.
fn journal(run: &Run, options: &SamplerOptions) -> Option<Journal<Vec<u64>>> {
    let identity = Identity::of(run.id, options).filter(|_| !run.lockstep)?;
    let mut journal = Journal::over(Vec::new(), identity);
    journal.clear().is_ok().then_some(journal)
}

/// A stage's output, or a VOID frame if the stage refuses the tick.
fn or_void<T: Topic>(header: Header, elements: Result<Vec<T::Element>, Rejected>) -> OwnFrame<T> {
    match elements {
        Ok(elements) => OwnFrame { header, elements },
        Err(_) => OwnFrame::void(&header),
    }
}
