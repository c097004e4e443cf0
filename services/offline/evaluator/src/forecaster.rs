//! Forecasts of windows by the onboard stages.
//!
//! A window becomes a `tracks` payload. The shipped stages compute its `forecasts` payload, so this crate has
//! no forecasting code. Only the input differs from a run: recorded states replace a tracker's estimates.

use std::sync::Arc;

use bytemuck::Zeroable;
use data::Recording;
use decoder::{BaseDecoder, Decoder, DecoderOptions};
use encoder::{Encoder, EncoderOptions};
use extractor::{Extractor, ExtractorOptions};
use lanes::LaneMap;
use localiser::{Localiser, LocaliserOptions};
use nn::{ModelConfig, Precision, Weights};
use onboard::{Chain, ChainError, Graph, Node, OwnFrame, node};
use retrieval::RetrievalMemory;
use run::{Run, StageRun};
use sampler::Sampler;
use serde::{Deserialize, Serialize};
use tracker::Tracker;
use wire::{
    AgentControls, ControlsTopic, EncodingsTopic, FeaturesTopic, Forecast as Payload, Header, Track,
    TracksTopic,
};

mod maps;
mod tracks;
mod weights;

pub use maps::{MapInput, site_map};
use tracks::Publisher;
pub use tracks::TracksPayload;
pub use weights::{EMBEDDED, Model, Provenance, WeightsChoice};

use crate::lines::Candidate;
use crate::method::Method;
use crate::scenes::Scene;
use crate::threads;

/// Windows that are decoded together before the samplers continue. Bounds the memory use.
pub(crate) const TOGETHER: usize = 32;

/// A model that can forecast windows.
pub struct Forecaster {
    weights: Weights,
    run: Run,
}

/// The stages up to the decoder, for the windows of one recording in time order.
pub(crate) struct Session {
    /// Localiser and extractor.
    features: Graph,
    networks: Vec<Network>,
    publisher: Publisher,
}

/// A thread's encoder and decoder, and its decoder with the network switched off.
struct Network {
    controls: Graph,
    base: Option<BaseDecoder>,
}

/// A window with its controls.
pub(crate) struct Decoded {
    pub(crate) payload: TracksPayload,
    pub(crate) controls: Vec<AgentControls>,
    /// Base controls of the counted agents only.
    base: Vec<AgentControls>,
    /// Indices of the counted agents' tracks.
    counting: Vec<usize>,
    /// Edges for which the frame had no room.
    edges_left_out: usize,
}

/// The corrections of the network's forecasts.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Correction {
    /// Uncorrected.
    None,
    /// The retrieval memory.
    Retrieval,
    /// The retrieval memory, then evidence.
    RetrievalAndEvidence,
}

/// Windows that do not fit a payload, and the agents and edges without room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Crowding {
    pub(crate) window_count: u64,
    /// Agents for which the `tracks` payload has no room. They are not seen as neighbours.
    pub(crate) agents_len: u64,
    /// Edges for which the `features` payload has no room. They belong to the farthest neighbours.
    pub(crate) edges_len: u64,
}

impl Crowding {
    /// Adds the counts of `other`.
    pub(crate) fn merge(&mut self, other: &Self) {
        self.window_count += other.window_count;
        self.agents_len += other.agents_len;
        self.edges_len += other.edges_len;
    }
}

/// What a sampler of [`Samplers`] gets of a window.
#[derive(Clone, Copy)]
enum Input {
    /// The counted agents with the network's controls.
    Counted,
    /// The counted agents with the base controls.
    Base,
    /// All agents, because a memory learns from all of them.
    All,
}

/// The forecasts of an agent from the same controls, by [`Method`]. A variant that the model lacks is empty.
pub type Variants = [Candidate; Method::STAGES];

/// The inputs of the samplers, by [`Method`].
const INPUTS: [Input; Method::STAGES] = [Input::Counted, Input::All, Input::All, Input::All, Input::Base];

/// One sampler per variant, by [`Method`]. The warm-started one may be missing.
pub(crate) struct Samplers {
    samplers: [Option<Sampler>; Method::STAGES],
    horizon_len: usize,
}

impl Forecaster {
    /// Checks that the stages can run the weights. `seed` draws the latent variables if the model draws them.
    ///
    /// # Errors
    /// [`ChainError`] if the weights do not hold the model, or if the model does not fit the payloads.
    pub fn new(weights: Weights, seed: u64) -> Result<Self, ChainError> {
        let run = Run { lockstep: true, seed, ..Run::default() };
        let forecaster = Self { weights, run };
        forecaster.features_to_controls()?;
        forecaster.tracks_to_features(MapInput::None, 1)?;
        Ok(forecaster)
    }

    /// Sets the precision of the decoder.
    ///
    /// # Errors
    /// [`ChainError`] if this process can't compute in this precision.
    pub fn decode_in(&mut self, precision: Precision) -> Result<(), ChainError> {
        let options = decoder::Options { precision, ..decoder::Options::default() };
        self.run.stages = vec![StageRun::with_options(&decoder::STAGE, &options)?];
        self.features_to_controls().map(|_| ())
    }

    /// The model's options.
    pub const fn config(&self) -> &ModelConfig {
        self.weights.config()
    }

    /// The weights.
    pub const fn weights(&self) -> &Weights {
        &self.weights
    }

    /// An empty retrieval memory.
    pub fn memory(&self) -> RetrievalMemory {
        RetrievalMemory::new(self.config().horizon_len, self.config().step_ns())
    }

    /// The `tracks` payloads of a recording's scenes, which are in time order.
    #[must_use]
    pub fn payloads(&self, recording: &Recording, scenes: &[Scene]) -> Vec<TracksPayload> {
        let mut publisher = Publisher::new(self.header(), recording);
        scenes.iter().map(|scene| publisher.next(scene)).collect()
    }

    /// Forecasts the complete agents of a recording's scenes in all variants. The scenes are in time order.
    /// Each forecast comes with its agent's place in the scene. `memory` is the initial memory of the
    /// warm-started variant.
    #[must_use]
    pub fn variants(
        &self,
        recording: &Recording,
        scenes: &[Scene],
        map: MapInput<'_>,
        threads: usize,
        memory: Option<RetrievalMemory>,
    ) -> Vec<Vec<(usize, Variants)>> {
        let mut session = Session::new(self, recording, map, threads);
        let mut samplers = Samplers::new(self, memory, None);
        let part = |scenes: &[Scene]| samplers.forecast(&session.decode(scenes, Scene::complete), threads);
        scenes.chunks(TOGETHER).flat_map(part).collect()
    }

    /// Adds a recording to a retrieval memory, as its own forecasts would have stored it, and ends the
    /// session.
    pub fn visit(
        &self,
        recording: &Recording,
        scenes: &[Scene],
        map: MapInput<'_>,
        threads: usize,
        memory: &mut RetrievalMemory,
    ) {
        let mut session = Session::new(self, recording, map, threads);
        let mut sampler = self.sampler(Correction::Retrieval);
        sampler.warm_start(memory.clone());
        for scenes in scenes.chunks(TOGETHER) {
            for decoded in session.decode(scenes, |_| Vec::new()) {
                let TracksPayload { header, tracks, .. } = &decoded.payload;
                sample(&mut sampler, header, tracks, &decoded.controls);
            }
        }
        if let Some(filled) = sampler.memory() {
            *memory = filled.clone();
        }
        memory.end_session();
    }

    /// The stages from `tracks` to `forecasts`, with retrieval from `memory` if there is one.
    pub fn stages(&self, map: MapInput<'_>, memory: Option<RetrievalMemory>) -> Graph {
        let correction = if memory.is_some() { Correction::Retrieval } else { Correction::None };
        let mut sampler = self.sampler(correction);
        memory.into_iter().for_each(|memory| sampler.warm_start(memory));
        Graph::new(self.nodes(map, sampler).expect("stages that started before start again"))
    }

    /// All stages with the default options of a run, for detections that are `interval_ns` apart.
    ///
    /// # Errors
    /// [`ChainError`] if the tracker can't be set up.
    pub fn chain(&self, map: MapInput<'_>, interval_ns: u64) -> Result<Chain, ChainError> {
        let run = Run { interval_ns, ..self.run.clone() };
        let tracker = Tracker::new(tracker::settings(&run, self.config())?);
        let mut nodes = self.nodes(map, self.sampler(Correction::RetrievalAndEvidence))?;
        nodes.push(node(&tracker::STAGE, tracker));
        Ok(Chain::of(nodes))
    }

    /// The stages from `tracks` to `forecasts`.
    fn nodes(&self, map: MapInput<'_>, sampler: Sampler) -> Result<Vec<Box<dyn Node>>, ChainError> {
        let mut nodes = self.tracks_to_features(map, 1)?;
        nodes.extend(self.features_to_controls()?);
        nodes.push(node(&sampler::STAGE, sampler));
        Ok(nodes)
    }

    /// A sampler as in a run, with this correction.
    fn sampler(&self, correction: Correction) -> Sampler {
        let options = sampler::Options {
            retrieval: correction != Correction::None,
            evidence: correction == Correction::RetrievalAndEvidence,
            workers: Some(1),
            ..sampler::Options::default()
        };
        let stage = StageRun::with_options(&sampler::STAGE, &options).expect("the stage's own options");
        let run = Run { stages: vec![stage], ..self.run.clone() };
        sampler::open(&run, self.config()).expect("a sampler without a file opens")
    }

    /// Localiser and extractor.
    fn tracks_to_features(
        &self,
        map: MapInput<'_>,
        workers: usize,
    ) -> Result<Vec<Box<dyn Node>>, ChainError> {
        let map = if self.config().context { map } else { MapInput::None };
        self.config().check_frames().map_err(nn::WeightsError::from)?;
        let localiser =
            LocaliserOptions { map: map.source(), ..localiser::settings(&self.run, self.config())? };
        let extractor = Extractor::new(&self.weights, ExtractorOptions { workers })?;
        Ok(vec![node(&localiser::STAGE, Localiser::new(localiser)), node(&extractor::STAGE, extractor)])
    }

    /// An encoder and decoder on one thread. Each thread of an evaluation has its own pair.
    fn features_to_controls(&self) -> Result<Vec<Box<dyn Node>>, ChainError> {
        let decoder = DecoderOptions { workers: 1, ..decoder::settings(&self.run)? };
        let encoder = Encoder::new(&self.weights, EncoderOptions { workers: 1 })?;
        let decoder = Decoder::new(&self.weights, decoder)?;
        Ok(vec![node(&encoder::STAGE, encoder), node(&decoder::STAGE, decoder)])
    }

    /// The header of a recording's first tick.
    pub fn header(&self) -> Header {
        let mut header = Header { step_ns: self.config().step_ns(), ..Header::new(1, 0, 0) };
        header.counts.history_len = self.config().history_len as u32;
        header
    }
}

impl Session {
    /// Stages without any state of a recording; `threads` share their work.
    pub(crate) fn new(
        forecaster: &Forecaster,
        recording: &Recording,
        map: MapInput<'_>,
        threads: usize,
    ) -> Self {
        let threads = threads.clamp(1, nn::WORKERS_MAX);
        let network = || {
            let controls = Graph::new(forecaster.features_to_controls()?);
            Ok::<_, ChainError>(Network { controls, base: BaseDecoder::new(&forecaster.weights)? })
        };
        let started = "stages that started before start again";
        Self {
            features: Graph::new(forecaster.tracks_to_features(map, threads).expect(started)),
            networks: (0..threads).map(|_| network().expect(started)).collect(),
            publisher: Publisher::new(forecaster.header(), recording),
        }
    }

    /// Decodes the next scenes. `counts` returns the places of the agents whose forecasts are needed.
    pub(crate) fn decode(&mut self, scenes: &[Scene], counts: impl Fn(&Scene) -> Vec<usize>) -> Vec<Decoded> {
        let mut begun = Vec::with_capacity(scenes.len());
        for scene in scenes {
            let payload = self.publisher.next(scene);
            self.features.put::<TracksTopic>(&payload.header, &payload.tracks);
            self.features.tick(|_| ());
            let extractor = self.features.step::<Extractor>();
            let edges_left_out = extractor.map_or(0, |extractor| extractor.effort().edges_dropped);
            let counting = counts(scene);
            let counting = (0..payload.places.len())
                .filter(|&track| counting.contains(&payload.places[track]))
                .collect();
            let decoded =
                Decoded { payload, controls: Vec::new(), base: Vec::new(), counting, edges_left_out };
            begun.push((decoded, self.features.shared()));
        }
        let made = threads::each_with(&begun, &mut self.networks, |(decoded, frame), network| match frame {
            Some(frame) => network.step(frame.clone(), decoded),
            None => (Vec::new(), Vec::new()),
        });
        let filled = begun.into_iter().zip(made);
        filled.map(|((decoded, _), (controls, base))| Decoded { controls, base, ..decoded }).collect()
    }
}

impl Network {
    /// The controls of a tick, and the base controls of the counted agents.
    fn step(
        &mut self,
        frame: Arc<OwnFrame<FeaturesTopic>>,
        decoded: &Decoded,
    ) -> (Vec<AgentControls>, Vec<AgentControls>) {
        self.controls.put_shared(frame);
        self.controls.tick(|_| ());
        let controls = self.controls.frame::<ControlsTopic>();
        if controls.is_void() {
            return (Vec::new(), Vec::new());
        }
        let encodings = &self.controls.frame::<EncodingsTopic>().elements;
        let base = self.base.iter_mut().flat_map(|base| {
            decoded.counting.iter().map(|&track| base.controls(&encodings[track])).collect::<Vec<_>>()
        });
        (controls.elements.clone(), base.collect())
    }
}

impl Samplers {
    /// Samplers for a recording. `memory` is the initial memory of the warm-started one. Forecasts follow
    /// `lanes`, except those of the base.
    pub(crate) fn new(
        forecaster: &Forecaster,
        memory: Option<RetrievalMemory>,
        lanes: Option<&Arc<LaneMap>>,
    ) -> Self {
        let sampler = |correction: Correction| {
            let mut sampler = forecaster.sampler(correction);
            lanes.into_iter().for_each(|map| sampler.guide_along(map));
            sampler
        };
        let warm_started = memory.map(|memory| {
            let mut sampler = sampler(Correction::Retrieval);
            sampler.warm_start(memory);
            sampler
        });
        let samplers = [
            Some(sampler(Correction::None)),
            Some(sampler(Correction::Retrieval)),
            warm_started,
            Some(sampler(Correction::RetrievalAndEvidence)),
            Some(forecaster.sampler(Correction::None)),
        ];
        Self { samplers, horizon_len: forecaster.config().horizon_len }
    }

    /// The current memory of the warm-started sampler.
    pub(crate) fn memory(&self) -> Option<&RetrievalMemory> {
        self.samplers[Method::WarmStartedRetrieval.index()].as_ref()?.memory()
    }

    /// The forecasts of the counted agents, scene by scene, with their places in the scene. If a sampler
    /// refuses a payload, the scene's agents are missing.
    pub(crate) fn forecast(&mut self, decoded: &[Decoded], threads: usize) -> Vec<Vec<(usize, Variants)>> {
        let horizon_len = self.horizon_len;
        let forecasts = |input: &Input, sampler: &mut Option<Sampler>| {
            let Some(sampler) = sampler else { return vec![Vec::new(); decoded.len()] };
            decoded.iter().map(|of| of.forecasts(*input, sampler, horizon_len)).collect::<Vec<_>>()
        };
        let all = if threads < 2 {
            INPUTS.iter().zip(&mut self.samplers).map(|(input, sampler)| forecasts(input, sampler)).collect()
        } else {
            threads::each_with(&INPUTS, &mut self.samplers, forecasts)
        };
        let mut all: Vec<_> = all.into_iter().map(Vec::into_iter).collect();
        let of_scene = |decoded: &Decoded| {
            let mut of_scene: Vec<_> =
                all.iter_mut().map(|of| of.next().unwrap_or_default().into_iter()).collect();
            let mut of_agent = |&track: &usize| {
                let variants: Variants = std::array::from_fn(|of| of_scene[of].next().unwrap_or_default());
                (!variants[0].is_empty()).then(|| (decoded.payload.places[track], variants))
            };
            decoded.counting.iter().map_while(&mut of_agent).collect()
        };
        decoded.iter().map(of_scene).collect()
    }
}

impl Decoded {
    /// Counts what the stages left out of the window.
    pub(crate) fn crowding(&self) -> Crowding {
        let (agents_len, edges_len) = (self.payload.left_out as u64, self.edges_left_out as u64);
        Crowding { window_count: u64::from(agents_len + edges_len > 0), agents_len, edges_len }
    }

    /// The forecasts of the counted agents.
    fn forecasts(&self, input: Input, sampler: &mut Sampler, horizon_len: usize) -> Vec<Candidate> {
        let TracksPayload { header, tracks, .. } = &self.payload;
        let counted = || self.counting.iter().map(|&track| tracks[track]).collect::<Vec<Track>>();
        let payloads = match input {
            Input::Counted => sample(sampler, header, &counted(), &self.controls),
            Input::Base if self.base.is_empty() => Vec::new(),
            Input::Base => sample(sampler, header, &counted(), &self.base),
            Input::All => {
                let all = sample(sampler, header, tracks, &self.controls);
                self.counting.iter().filter_map(|&track| all.get(track).copied()).collect()
            }
        };
        let published = payloads.iter().map(|payload| Candidate::published(payload, horizon_len));
        // The network gives the probabilities.
        let is_base = matches!(input, Input::Base);
        published.map(|of| Candidate { probability: of.probability.filter(|_| !is_base), ..of }).collect()
    }
}

/// One forecast per track; empty if the sampler refuses the payload.
fn sample(
    sampler: &mut Sampler,
    header: &Header,
    tracks: &[Track],
    controls: &[AgentControls],
) -> Vec<Payload> {
    let mut payloads = vec![Payload::zeroed(); tracks.len()];
    match sampler.step(header, tracks, Ok(controls), &mut payloads) {
        Ok(written) => {
            payloads.truncate(written);
            payloads
        }
        Err(_) => Vec::new(),
    }
}
