use decoder::Decoder;
use encoder::Encoder;
use evidence::{Evidence, Prior};
use extractor::Extractor;
use localiser::Localiser;
use nn::{ModelConfig, Weights};
use ports::StageError;
use run::{Declared, Run};
use sampler::Sampler;
use tracker::Tracker;
use wire::{
    ControlsTopic, Detection, DetectionsTopic, EncodingsTopic, FeatureShape, Features, FeaturesTopic,
    Forecast, ForecastsTopic, Header, Rejected, StageId, Track, TracksTopic,
};

use crate::graph::{Node, node};
use crate::{ChainError, Graph, Load, OwnFrame};

/// The declarations of the compute stages.
pub const STAGES: [&dyn Declared; 6] = [
    &tracker::STAGE,
    &localiser::STAGE,
    &extractor::STAGE,
    &encoder::STAGE,
    &decoder::STAGE,
    &sampler::STAGE,
];

/// Sets up the compute stages of a run with these weights from the run's record.
///
/// # Errors
/// [`ChainError`] if weights, options, map or retrieval memory can't be used.
pub fn open_all(run: &Run, weights: &Weights) -> Result<Vec<Box<dyn Node>>, ChainError> {
    let model = weights.config();
    Ok(vec![
        node(&tracker::STAGE, Tracker::new(tracker::settings(run, model)?)),
        node(&localiser::STAGE, Localiser::new(localiser::settings(run, model)?)),
        node(&extractor::STAGE, Extractor::new(weights, extractor::settings(run)?)?),
        node(&encoder::STAGE, Encoder::new(weights, encoder::settings(run)?)?),
        node(&decoder::STAGE, Decoder::new(weights, decoder::settings(run)?)?),
        node(&sampler::STAGE, sampler::open(run, model)?),
    ])
}

/// All compute stages, from detections to forecasts.
pub struct Chain(Graph);

impl Chain {
    /// Sets up all stages of a lockstep run with this model from its record.
    ///
    /// # Errors
    /// [`StageError`] if weights, options, map or retrieval memory can't be used.
    pub fn new(run: &Run, model: &ModelConfig) -> Result<Self, StageError> {
        let weights = Weights::of_model(run.weights.as_deref(), model).map_err(StageError::data)?;
        let mut graph = Graph::new(open_all(run, &weights)?);
        graph.begin(run, 0);
        Ok(Self(graph))
    }

    /// Joins a tracker and later stages of the same model. Stages that tracks do not need may be missing.
    ///
    /// # Panics
    /// As [`Graph::new`].
    #[must_use]
    pub fn of(nodes: Vec<Box<dyn Node>>) -> Self {
        Self(Graph::new(nodes))
    }

    /// Takes a tick through all stages; `passed` is called after each stage that answers it.
    ///
    /// If the tracker refuses the tick or the tick is late, there are no forecasts. If a later stage refuses
    /// it, the sampler's fallback forecasts are returned.
    pub fn tick(
        &mut self,
        header: &Header,
        detections: &[Detection],
        passed: impl FnMut(StageId),
    ) -> (Header, &[Forecast]) {
        self.0.put::<DetectionsTopic>(header, detections);
        self.0.tick(passed);
        let (_, forecasts) = self.frames();
        (forecasts.header, &forecasts.elements)
    }

    /// Ends the stages of a run: saves the retrieval memory if the run's record names a file.
    ///
    /// # Errors
    /// [`StageError`] if the file can't be written.
    pub fn end(&mut self, run: &Run) -> Result<(), StageError> {
        self.0.end(run)
    }

    /// Replaces the shipped prior of the sampler's experts by `prior`.
    pub fn expect(&mut self, prior: Prior) {
        if let Some(sampler) = self.0.step_mut::<Sampler>() {
            sampler.expect(prior);
        }
    }

    /// Continues with the evidence that the sampler of an earlier chain has learned.
    pub fn continue_from(&mut self, mut earlier: Self) {
        if let (Some(sampler), Some(earlier)) = (self.0.step_mut::<Sampler>(), earlier.0.step_mut()) {
            sampler.continue_from(earlier);
        }
    }

    /// The sampler's evidence on its experts.
    pub fn evidence(&self) -> Option<&Evidence> {
        self.0.step::<Sampler>()?.evidence()
    }

    /// Why the tracker has refused the last tick, if it has.
    pub fn refusal(&self) -> Option<&Rejected> {
        self.0.refusal(StageId::Tracker)
    }

    /// The tracks of the last tick; empty if it was refused.
    pub fn tracks(&self) -> &[Track] {
        &self.frames().0.elements
    }

    /// Tracks and forecasts of the last tick.
    pub fn frames(&self) -> (&OwnFrame<TracksTopic>, &OwnFrame<ForecastsTopic>) {
        (self.0.frame(), self.0.frame())
    }

    /// What enters the attention and what leaves the decoder, of the last tick.
    pub fn network(&self) -> (&OwnFrame<FeaturesTopic>, &OwnFrame<ControlsTopic>) {
        (self.0.frame(), self.0.frame())
    }

    /// How large the last tick was.
    pub fn load(&self) -> Load {
        let (features, encodings) = (self.0.frame::<FeaturesTopic>(), self.0.frame::<EncodingsTopic>());
        let counts = &features.header.counts;
        let shape = FeatureShape::of(counts);
        match Features::read(&features.elements, shape, counts.history_len as usize) {
            Ok(features) => Load::of(&features, &encodings.elements, counts.history_len),
            Err(_) => Load::default(),
        }
    }
}
