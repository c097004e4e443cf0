use bytemuck::Zeroable;
use decoder::Decoder;
use encoder::Encoder;
use extractor::Extractor;
use localiser::Localiser;
use nn::{ModelConfig, Weights};
use run::Run;
use sampler::Sampler;
use tracker::Tracker;
use wire::{
    AGENTS_MAX, AgentControls, AgentEncoding, Cause, Context, ContextMut, Detection, Edge, FeatureShape,
    Features, FeaturesMut, Forecast, Header, Rejected, Row, StageId, Track, context_rows, feature_rows,
    flags,
};

use crate::failure::Failure;

/// The compute stages in one process, one after the other: the same steps on the same settings as in a run, so that
/// the forecasts are the same to the bit.
pub struct Chain {
    tracker: Tracker,
    localiser: Localiser,
    extractor: Extractor,
    encoder: Encoder,
    decoder: Decoder,
    sampler: Sampler,
    horizon_len: u32,
    modes_len: u32,
    frames: Frames,
    /// Header and number of the newest forecasts, where there are any: those of a late tick are none.
    prior: Option<(Header, usize)>,
}

/// What would lie in shared memory.
struct Frames {
    tracks: Vec<Track>,
    context: Vec<Row>,
    features: Vec<Row>,
    encodings: Vec<AgentEncoding>,
    controls: Vec<AgentControls>,
    forecasts: Vec<Forecast>,
    tracks_len: usize,
    controls_len: usize,
    /// Header of the features of the last tick that got so far.
    features_header: Option<Header>,
}

/// How much the last tick was, for those who count its work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Agents.
    pub agents_len: usize,
    /// Agents at the history steps at which they are present.
    pub nodes_len: usize,
    /// Edges of all history steps.
    pub edges_len: usize,
    /// Edges of the newest step.
    pub new_edges_len: usize,
    /// Agents that are forecast.
    pub forecast_len: usize,
    /// States that the decoder's burn-in reads.
    pub burn_in_len: usize,
}

impl Chain {
    /// Sets up all stages of a run with that model as its record says.
    pub fn new(run: &Run, model: &ModelConfig) -> Result<Self, Failure> {
        let weights = Weights::of_model(run.weights.as_deref(), model).map_err(Failure::data)?;
        Ok(Self {
            tracker: Tracker::new(tracker::stage::settings(run, model)?),
            localiser: Localiser::new(localiser::stage::settings(run, model)?),
            extractor: Extractor::new(&weights, extractor::stage::settings(run)?).map_err(Failure::data)?,
            encoder: Encoder::new(&weights).map_err(Failure::data)?,
            decoder: Decoder::new(&weights, decoder::stage::settings(run)?).map_err(Failure::data)?,
            sampler: sampler::stage::open(run, model)?,
            horizon_len: model.horizon_len as u32,
            modes_len: model.modes as u32,
            frames: Frames {
                tracks: vec![Track::zeroed(); AGENTS_MAX],
                context: Vec::new(),
                features: Vec::new(),
                encodings: vec![AgentEncoding::zeroed(); AGENTS_MAX],
                controls: vec![AgentControls::zeroed(); AGENTS_MAX],
                forecasts: vec![Forecast::zeroed(); AGENTS_MAX],
                tracks_len: 0,
                controls_len: 0,
                features_header: None,
            },
            prior: None,
        })
    }

    /// Takes a tick through all stages; `passed` is told after each of them.
    ///
    /// A tick that the tracker refuses, or that came late, has no forecasts; one that a later stage refuses has those of the
    /// sampler's fallback.
    pub fn tick(
        &mut self,
        header: &Header,
        detections: &[Detection],
        mut passed: impl FnMut(StageId),
    ) -> (Header, &[Forecast]) {
        let frames = &mut self.frames;
        let prior = self.prior.as_ref().map(|(header, len)| (header, &frames.forecasts[..*len]));
        let tracked = self.tracker.step(header, detections, prior, &mut frames.tracks);
        let mut header = self.tracker.header(header);
        passed(StageId::Tracker);
        frames.tracks_len = tracked.as_ref().map_or(0, |tracked| tracked.tracks_len);
        if !tracked.is_ok_and(|tracked| tracked.replayed_len == 0) {
            return nothing(header);
        }
        let learned = self.controls(&header, &mut passed);

        let Frames { tracks, controls, forecasts, tracks_len, controls_len, .. } = &mut self.frames;
        let (tracks, forecasts) = (&tracks[..*tracks_len], &mut forecasts[..*tracks_len]);
        let sampler = &mut self.sampler;
        let result = learned
            .and_then(|()| sampler.learned(&header, tracks, &controls[..*controls_len], forecasts))
            .or_else(|_| sampler.fallback(&header, tracks, Cause::Rejected, forecasts));
        passed(StageId::Sampler);
        if result.is_err() {
            self.prior = None;
            return nothing(header);
        }
        header.counts.horizon_len = self.horizon_len;
        header.counts.modes_len = self.modes_len;
        self.prior = Some((header, self.frames.tracks_len));
        (header, &self.frames.forecasts[..self.frames.tracks_len])
    }

    /// Keeps the memory of the place where the run's record wants it.
    pub fn keep_memory(&self, run: &Run) -> Result<(), Failure> {
        Ok(sampler::stage::save_memory(run, &self.sampler)?)
    }

    /// The tracks of the last tick; none where it was refused.
    #[must_use]
    pub fn tracks(&self) -> &[Track] {
        &self.frames.tracks[..self.frames.tracks_len]
    }

    /// How much the last tick was.
    #[must_use]
    pub fn load(&self) -> Load {
        let Frames { features, encodings, tracks_len, features_header, .. } = &self.frames;
        let Some(Header { counts, .. }) = features_header else { return Load::default() };
        let shape = FeatureShape::of(counts);
        let features = Features::read(&features[..feature_rows(&shape)], shape, counts.history_len as usize);
        features.map_or(Load::default(), |features| {
            Load::of(&features, &encodings[..*tracks_len], counts.history_len)
        })
    }

    /// From tracks to controls.
    fn controls(&mut self, header: &Header, passed: &mut impl FnMut(StageId)) -> Result<(), Rejected> {
        let Frames {
            tracks,
            context,
            features,
            encodings,
            controls,
            tracks_len,
            controls_len,
            features_header,
            ..
        } = &mut self.frames;
        let mut header = *header;

        let shape = self.localiser.shape(*tracks_len);
        let context = grown(context, context_rows(&shape));
        let mut out = ContextMut::over(context, shape)?;
        self.localiser.step(&header, &tracks[..*tracks_len], &mut out)?;
        header.counts.patch_side = shape.patch_side as u32;
        passed(StageId::Localiser);

        let context = Context::read(context, shape)?;
        let shape: FeatureShape = self.extractor.prepare(&header, &context)?;
        let features = grown(features, feature_rows(&shape));
        self.extractor.write(&mut FeaturesMut::over(features, shape)?);
        header.counts.edges_len = shape.edges_len as u32;
        *features_header = Some(header);
        passed(StageId::Extractor);

        let features = Features::read(features, shape, header.counts.history_len as usize)?;
        let encodings = &mut encodings[..*tracks_len];
        self.encoder.step(&header, &features, encodings)?;
        passed(StageId::Encoder);

        *controls_len = Decoder::len(encodings);
        header.counts.agents_len = *controls_len as u32;
        header.counts.horizon_len = self.horizon_len;
        header.counts.modes_len = self.modes_len;
        self.decoder.step(&header, encodings, &mut controls[..*controls_len])?;
        passed(StageId::Decoder);
        Ok(())
    }
}

/// The empty frame that follows a tick which was refused, or came late.
fn nothing(mut header: Header) -> (Header, &'static [Forecast]) {
    header.flags |= flags::VOID;
    header.counts = wire::Counts::default();
    (header, &[])
}

impl Load {
    fn of(features: &Features<'_>, encodings: &[AgentEncoding], history_len: u32) -> Self {
        let states = |encoding: &AgentEncoding| encoding.present.count_ones() as usize;
        let newest = |edge: &&Edge| u32::from(edge.step) + 1 == history_len;
        let forecast = || encodings.iter().filter(|encoding| encoding.forecastable != 0);
        Self {
            agents_len: encodings.len(),
            nodes_len: encodings.iter().map(states).sum(),
            edges_len: features.edges.len(),
            new_edges_len: features.edges.iter().filter(newest).count(),
            forecast_len: forecast().count(),
            burn_in_len: forecast().map(states).sum(),
        }
    }
}

/// The first `len` rows of a payload that is made longer where it is too short.
fn grown(rows: &mut Vec<Row>, len: usize) -> &mut [Row] {
    if rows.len() < len {
        rows.resize(len, Row::zeroed());
    }
    &mut rows[..len]
}
