//! Replays a recording: takes its ticks through the stages again and compares the result with the recording.
//!
//! All numbers are computed again. Only facts that depended on the clock come from the recording:
//!
//! - the ticks that each stage received;
//! - the forecasts that were available to the tracker;
//! - whether the controls met the sampler's deadline;
//! - the agents that were shed;
//! - the restarts of stages.

mod pace;
mod tick;

use std::collections::{BTreeMap, VecDeque};
use std::time::Instant;

use nn::Weights;
use recording::{Comparison, Frame, FrameError, Message, Recording};
use thiserror::Error;
use wire::{
    ContextTopic, ControlsTopic, DetectionsTopic, EncodingsTopic, FeaturesTopic, ForecastsTopic, Header,
    HeartbeatsTopic, StageId, Topic, TracksTopic, flags,
};

use crate::replay::{pace::Pace, tick::Tick};
use crate::{ChainError, OwnFrame, Stages};

pub use self::pace::OwnTime;

/// A tick is replayed once this many later ticks have begun. Its last frame has arrived by then, or never
/// will.
const LATER: usize = 24;
/// Number of recent forecasts kept as candidates for the tracker's prior.
const PRIORS_MAX: usize = 24;

/// The stages that are replayed, with the topics of their inputs and of their output.
pub const STAGES: [(StageId, &[&str], &str); 6] = [
    (StageId::Tracker, &[DetectionsTopic::NAME, TracksTopic::NAME, ForecastsTopic::NAME], TracksTopic::NAME),
    (StageId::Localiser, &[TracksTopic::NAME], ContextTopic::NAME),
    (StageId::Extractor, &[ContextTopic::NAME], FeaturesTopic::NAME),
    (StageId::Encoder, &[FeaturesTopic::NAME], EncodingsTopic::NAME),
    (StageId::Decoder, &[EncodingsTopic::NAME], ControlsTopic::NAME),
    (StageId::Sampler, &[TracksTopic::NAME, ControlsTopic::NAME, ForecastsTopic::NAME], ForecastsTopic::NAME),
];

/// Why a recording can't be replayed.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// The stages can't be set up.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// A topic is not in the file, or not whole.
    #[error(
        "{path}: topic \"{topic}\" was not recorded, or without a part, which {wanted} needs: record with --topics {advice}"
    )]
    Missing {
        /// The file.
        path: String,
        /// The topic.
        topic: &'static str,
        /// What needs it.
        wanted: String,
        /// What to record.
        advice: &'static str,
    },
}

/// The results of a replay.
#[derive(Debug, Default)]
pub struct Replayed {
    /// The recorded frames (first) and the replayed ones (second).
    pub comparison: Comparison,
    /// Ticks that were replayed, without those before the file.
    pub ticks: u64,
    /// Ticks before the file that were replayed first, to restore the state of the stages.
    pub ticks_before: u64,
    /// Comparison of the ticks before the file. It contains only headers and identities.
    pub before: Comparison,
    /// Ticks for which the recording does not show the stages that received them, because intermediate topics
    /// are missing.
    pub guessed: u64,
    /// The last tick that was replayed.
    pub newest: Option<u64>,
    /// The first tick of the replay, if earlier ticks of the run are missing.
    pub missing_before: Option<u64>,
    /// Whether the recorded tracks were used. If a recording starts in the middle of a run, the tracker's
    /// state is unknown.
    pub tracks_are_recorded: bool,
    /// Ticks with detections that were replayed without them, because the file lacks them.
    pub without_detections: Vec<u64>,
    /// Ticks whose prior arrived while the tracker started. It is unknown whether the tracker used that
    /// prior.
    pub close_priors: Vec<u64>,
    /// Ticks at which a restarted sampler resumed with a state that the replay does not have.
    pub not_resumed: Vec<u64>,
    /// The first frame that no stage can have taken: a fault that was injected, or a faulty sender.
    pub impossible: Option<FrameError>,
    /// How long a replay in the rhythm of its stamps took; `None` for other replays.
    pub own_time: Option<OwnTime>,
}

/// A recording in replay.
pub struct Replay<'a> {
    recording: &'a Recording,
    stages: Stages,
    /// The only stage that is replayed; `None` for all.
    alone: Option<StageId>,
    incarnations: BTreeMap<StageId, u32>,
    /// The newest forecasts that are not VOID, each with the time at which it was sent.
    forecasts: VecDeque<(u64, OwnFrame<ForecastsTopic>)>,
    prior: Option<OwnFrame<ForecastsTopic>>,
    /// `None` if the ticks are replayed without pauses.
    pace: Option<Pace>,
    found: Replayed,
}

impl<'a> Replay<'a> {
    /// A replay of all stages or of one `alone`, with the options and the seed of the recorded run.
    ///
    /// # Errors
    /// [`ReplayError`] if the recording lacks a topic or the stages can't be set up.
    pub fn new(
        recording: &'a Recording,
        weights: Weights,
        alone: Option<StageId>,
    ) -> Result<Self, ReplayError> {
        let path = recording.path().display().to_string();
        let wanted: Vec<&'static str> = match alone {
            None => vec![DetectionsTopic::NAME],
            Some(stage) => {
                let row = STAGES.iter().find(|(of, ..)| *of == stage);
                row.map(|(_, reads, writes)| reads.iter().copied().chain([*writes]).collect())
                    .unwrap_or_default()
            }
        };
        // The tracker reuses the controls of its forecasts.
        let needs_whole = |topic: &str| alone == Some(StageId::Tracker) && topic == ForecastsTopic::NAME;
        let has = |topic: &str| {
            if needs_whole(topic) { recording.has_whole(topic) } else { recording.has_topic(topic) }
        };
        let missing = wanted.into_iter().find(|topic| !has(topic));
        if let Some(topic) = missing {
            let wanted = alone.map_or_else(|| "a replay".to_owned(), |stage| format!("the {}", stage.name()));
            return Err(ReplayError::Missing { path, topic, wanted, advice: "all" });
        }
        let stages = Stages::new(&recording.about().run, weights)?;
        Ok(Self {
            recording,
            stages,
            alone,
            incarnations: BTreeMap::new(),
            forecasts: VecDeque::new(),
            prior: None,
            pace: None,
            found: Replayed::default(),
        })
    }

    /// The same replay, with its ticks in the rhythm of their stamps. The ticks before the file follow one
    /// another at once.
    pub fn in_own_time(self) -> Self {
        Self { pace: Some(Pace::new()), ..self }
    }

    /// Replays all ticks; `each` is called with every frame of a replayed stage. Damaged parts of the file
    /// are skipped; [`Recording::damages`] returns them.
    ///
    /// # Errors
    /// [`ReplayError`] if a stage can't be set up again.
    pub fn run(mut self, mut each: impl FnMut(&Frame)) -> Result<Replayed, ReplayError> {
        let mut ticks: BTreeMap<u64, Tick> = BTreeMap::new();
        // The ticks in the order in which the tracker answered them.
        let mut order: VecDeque<u64> = VecDeque::new();
        // A replay of one stage needs only the topics around it.
        let inputs = STAGES.iter().flat_map(|(_, reads, _)| reads.iter().copied());
        let leads =
            [TracksTopic::NAME].into_iter().chain(inputs).find(|topic| self.recording.has_topic(topic));
        for message in self.recording.messages() {
            let (frame, is_before) = match message {
                Ok(Message::Frame(frame)) => (frame, false),
                Ok(Message::Before(frame)) => (frame, true),
                Ok(Message::Event(_) | Message::Line(_)) | Err(_) => continue,
            };
            let (seq, name) = (frame.header().seq, frame.topic().name);
            // Heartbeats have their own sequence numbers.
            if !frame.header().is_tick() || name == HeartbeatsTopic::NAME {
                continue;
            }
            if Some(name) == leads && !order.contains(&seq) {
                order.push_back(seq);
            }
            ticks.entry(seq).or_default().add(frame, is_before);
            if order.len() > LATER
                && let Some(seq) = order.pop_front()
                && let Some(tick) = ticks.remove(&seq)
            {
                self.timed_tick(seq, &tick, &mut each)?;
                // These came before the first tick of the file, or were never answered.
                ticks.retain(|older, _| *older + (2 * LATER as u64) > seq);
            }
        }
        for seq in order {
            if let Some(tick) = ticks.remove(&seq) {
                self.timed_tick(seq, &tick, &mut each)?;
            }
        }
        Ok(Replayed { own_time: self.pace.map(Pace::finish), ..self.found })
    }

    fn timed_tick(
        &mut self,
        seq: u64,
        tick: &Tick,
        each: &mut impl FnMut(&Frame),
    ) -> Result<(), ReplayError> {
        if let Some(pace) = self.pace.as_mut().filter(|_| !tick.is_before()) {
            pace.wait(tick.stamp_ns());
        }
        let began = Instant::now();
        self.tick(seq, tick, each)?;
        if let Some(pace) = self.pace.as_mut().filter(|_| !tick.is_before()) {
            pace.computed(began);
        }
        Ok(())
    }

    fn tick(&mut self, seq: u64, tick: &Tick, each: &mut impl FnMut(&Frame)) -> Result<(), ReplayError> {
        if self.found.newest.is_none() && seq > 0 {
            self.found.missing_before = Some(seq);
        }
        self.found.newest = Some(seq);
        *if tick.is_before() { &mut self.found.ticks_before } else { &mut self.found.ticks } += 1;
        let impossible = &mut self.found.impossible;
        let recorded_tracks = tick.own::<TracksTopic>(impossible);
        let recorded_controls = tick.own::<ControlsTopic>(impossible);
        let recorded_forecasts = tick.own::<ForecastsTopic>(impossible);
        let does = |stage| self.alone.is_none_or(|alone| alone == stage);
        let [tracks_here, samples_here] = [StageId::Tracker, StageId::Sampler].map(does);
        // A replay of one stage reads its input from the file.
        let mut tracks = recorded_tracks.clone();
        let begins_late = self.alone.is_none() && self.found.missing_before.is_some();
        self.found.tracks_are_recorded = begins_late && self.recording.has_topic(TracksTopic::NAME);
        if tracks_here && !self.found.tracks_are_recorded {
            tracks = self.track(seq, tick, recorded_tracks.as_ref())?;
            self.compare(tick, tracks.as_ref(), each);
        }
        let controls = match (self.alone, &tracks) {
            (Some(alone), _) => {
                self.one(alone, tick, each)?;
                recorded_controls
            }
            (None, Some(tracks)) => self.network(tick, tracks, each)?,
            (None, None) => None,
        };
        let sampled = match (&tracks, &recorded_forecasts) {
            // The run's sampler did not answer this tick.
            (_, None) if self.recording.has_topic(ForecastsTopic::NAME) => None,
            (Some(tracks), recorded) if samples_here => {
                // A frame that is passed on as VOID leaves no trace in the sampler, and does not show the
                // sampler's initial state.
                if let Some(recorded) = recorded.as_ref().filter(|f| !f.header.has(flags::VOID)) {
                    self.renew_sampler(seq, &recorded.header)?;
                }
                // The hops show whether the controls had arrived.
                let came = recorded.as_ref().is_none_or(|f| f.header.hop(StageId::Decoder).is_some());
                Some(self.stages.sample(tracks, controls.as_ref().filter(|_| came)))
            }
            _ => None,
        };
        if samples_here {
            self.compare(tick, sampled.as_ref(), each);
        }
        let sent_ns = recorded_forecasts.as_ref().and_then(|f| Some(f.header.hop(StageId::Sampler)?.sent_ns));
        // The tracker reports the cost of the forecasts from the run's own hops.
        let with_hops = |mut frame: OwnFrame<ForecastsTopic>| {
            if let Some(recorded) = &recorded_forecasts {
                frame.header = frame.header.with_hops_of(&recorded.header);
            }
            frame
        };
        let forecasts = sampled.map(with_hops).or_else(|| recorded_forecasts.clone());
        if let Some(forecasts) = forecasts.filter(|f| !f.header.has(flags::VOID)) {
            self.forecasts.push_back((sent_ns.unwrap_or(0), forecasts));
            if self.forecasts.len() > PRIORS_MAX {
                self.forecasts.pop_front();
            }
        }
        Ok(())
    }

    /// The tracker's answer; `None` if the run's tracker had not answered the tick.
    fn track(
        &mut self,
        seq: u64,
        tick: &Tick,
        recorded: Option<&OwnFrame<TracksTopic>>,
    ) -> Result<Option<OwnFrame<TracksTopic>>, ReplayError> {
        if recorded.is_none() && self.recording.has_topic(TracksTopic::NAME) {
            return Ok(None);
        }
        if let Some(incarnation) = tick.incarnation(StageId::Tracker, TracksTopic::NAME) {
            self.renew(StageId::Tracker, incarnation)?;
        }
        let (header, detections) = match tick.own::<DetectionsTopic>(&mut self.found.impossible) {
            Some(detections) if !recorded.is_some_and(|tracks| tracks.header.has(flags::PREDICTED)) => {
                (detections.header, detections.elements)
            }
            _ => match recorded {
                // The tick was predicted, or its detections are missing in the file.
                Some(tracks) => {
                    if !tracks.header.has(flags::PREDICTED) {
                        self.found.without_detections.push(seq);
                    }
                    (predicted(&tracks.header), Vec::new())
                }
                None => return Ok(None),
            },
        };
        // An earlier stage refused the tick.
        if header.has(flags::VOID) {
            return Ok(None);
        }
        self.choose_prior(seq, &header, recorded.map(|tracks| &tracks.header));
        Ok(Some(self.stages.track(&header, &detections, self.prior.as_ref())))
    }

    /// Chooses the forecasts that were available to the tracker. In lockstep they belong to the previous
    /// tick. Otherwise the recorded age identifies them. Without a recorded age, the newest forecasts sent
    /// before the tracker started are chosen.
    fn choose_prior(&mut self, seq: u64, header: &Header, tracks: Option<&Header>) {
        if header.has(flags::LOCKSTEP) {
            let before = self.forecasts.iter().find(|(_, forecasts)| forecasts.header.seq + 1 == seq);
            if let Some((_, forecasts)) = before {
                self.prior = Some(forecasts.clone());
            }
            return;
        }
        // The tracker has reported their age.
        if let Some(tracks) = tracks.filter(|tracks| tracks.feedback_age_ns > 0) {
            let stamp_ns = tracks.stamp_ns.saturating_sub_unsigned(tracks.feedback_age_ns);
            let told = self.forecasts.iter().rfind(|(_, forecasts)| forecasts.header.stamp_ns == stamp_ns);
            if let Some((_, forecasts)) = told {
                self.prior = Some(forecasts.clone());
            }
            return;
        }
        let Some(hop) = tracks.and_then(|tracks| tracks.hop(StageId::Tracker)) else {
            self.prior = self.forecasts.back().map(|(_, forecasts)| forecasts.clone());
            return;
        };
        /// Forecasts sent this close to the tracker's check may or may not have been available.
        const CLOSE_NS: u64 = 1_000_000;
        if self.forecasts.iter().any(|(sent_ns, _)| sent_ns.abs_diff(hop.started_ns) < CLOSE_NS) {
            self.found.close_priors.push(seq);
        }
        let sent_before = self.forecasts.iter().filter(|(sent_ns, _)| *sent_ns < hop.started_ns);
        if let Some((_, forecasts)) = sent_before.max_by_key(|(sent_ns, _)| *sent_ns) {
            self.prior = Some(forecasts.clone());
        }
    }

    /// Runs localiser to decoder, as far as the run's stages had the tick. Returns the controls if the tick
    /// came that far.
    fn network(
        &mut self,
        tick: &Tick,
        tracks: &OwnFrame<TracksTopic>,
        each: &mut impl FnMut(&Frame),
    ) -> Result<Option<OwnFrame<ControlsTopic>>, ReplayError> {
        if !self.has_passed(StageId::Localiser, tick, ContextTopic::NAME)? {
            return Ok(None);
        }
        let context = self.stages.locate(tracks);
        self.compare(tick, Some(&context), each);
        if !self.has_passed(StageId::Extractor, tick, FeaturesTopic::NAME)? {
            return Ok(None);
        }
        let features = self.stages.extract(&context, tick.extracted());
        self.compare(tick, Some(&features), each);
        if !self.has_passed(StageId::Encoder, tick, EncodingsTopic::NAME)? {
            return Ok(None);
        }
        let encodings = self.stages.encode(&features, tick.encoded());
        self.compare(tick, Some(&encodings), each);
        if !self.has_passed(StageId::Decoder, tick, ControlsTopic::NAME)? {
            return Ok(None);
        }
        let controls = self.stages.decode(&encodings, tick.decoded());
        self.compare(tick, Some(&controls), each);
        Ok(Some(controls))
    }

    /// Replays a single stage of the network with its input from the file.
    fn one(&mut self, stage: StageId, tick: &Tick, each: &mut impl FnMut(&Frame)) -> Result<(), ReplayError> {
        let Some((_, _, writes)) = STAGES.iter().find(|(of, ..)| *of == stage) else { return Ok(()) };
        if matches!(stage, StageId::Tracker | StageId::Sampler) || !self.has_passed(stage, tick, writes)? {
            return Ok(());
        }
        let impossible = &mut self.found.impossible;
        match stage {
            StageId::Localiser => {
                let made = tick.own(impossible).map(|input| self.stages.locate(&input));
                self.compare(tick, made.as_ref(), each);
            }
            StageId::Extractor => {
                let made = tick.own(impossible).map(|input| self.stages.extract(&input, tick.extracted()));
                self.compare(tick, made.as_ref(), each);
            }
            StageId::Encoder => {
                let made = tick.own(impossible).map(|input| self.stages.encode(&input, tick.encoded()));
                self.compare(tick, made.as_ref(), each);
            }
            _ => {
                let made = tick.own(impossible).map(|input| self.stages.decode(&input, tick.decoded()));
                self.compare(tick, made.as_ref(), each);
            }
        }
        Ok(())
    }

    /// Whether a stage of the run had the tick. Its output or the hops of the forecasts show it. Without
    /// either, the stage is assumed to have had the tick.
    fn has_passed(&mut self, stage: StageId, tick: &Tick, writes: &str) -> Result<bool, ReplayError> {
        if let Some(incarnation) = tick.incarnation(stage, writes) {
            self.renew(stage, incarnation)?;
            return Ok(true);
        }
        // For ticks before the file, the outputs of intermediate stages are not kept.
        if self.recording.has_topic(writes) && !tick.is_before() {
            return Ok(false);
        }
        self.found.guessed += u64::from(stage == StageId::Localiser);
        Ok(true)
    }

    fn renew(&mut self, stage: StageId, incarnation: u32) -> Result<(), ReplayError> {
        let before = self.incarnations.insert(stage, incarnation).unwrap_or(0);
        if before != incarnation {
            self.stages.renew(stage, incarnation)?;
        }
        Ok(())
    }

    /// Restarts the sampler if its incarnation has changed. The new sampler resumes with the state after the
    /// number of ticks that the recorded header contains.
    fn renew_sampler(&mut self, seq: u64, header: &Header) -> Result<(), ReplayError> {
        let before = self.incarnations.get(&StageId::Sampler).copied().unwrap_or(0);
        self.renew(StageId::Sampler, header.incarnation)?;
        if before != header.incarnation && !self.stages.resume_sampler(header.resumed_ticks) {
            self.found.not_resumed.push(seq);
        }
        Ok(())
    }

    /// Compares a replayed frame with the recorded frame, if its topic was recorded.
    fn compare<T: Topic>(&mut self, tick: &Tick, made: Option<&OwnFrame<T>>, each: &mut impl FnMut(&Frame)) {
        let recorded = tick.frame(T::NAME);
        match (recorded, made) {
            (Some(recorded), Some(made)) => {
                let made = Frame::of::<T>(&made.header, &made.elements, recorded.received_ns());
                if tick.is_recorded(T::NAME) {
                    self.found.comparison.pair(recorded, &made);
                    each(&made);
                } else {
                    self.found.before.pair(recorded, &made);
                }
            }
            (Some(recorded), None) if !tick.is_recorded(T::NAME) => {
                self.found.before.alone(T::NAME, recorded.header().seq, true);
            }
            (None, _) if tick.is_before() => {}
            (Some(recorded), None) => self.found.comparison.alone(T::NAME, recorded.header().seq, true),
            (None, Some(made)) if self.recording.has_topic(T::NAME) => {
                self.found.comparison.alone(T::NAME, made.header.seq, false);
            }
            (None, Some(made)) => each(&Frame::of::<T>(&made.header, &made.elements, tick.received_ns())),
            (None, None) => {}
        }
    }
}

/// Returns the header with which the tracker predicted a tick, from the header of its tracks.
fn predicted(tracks: &Header) -> Header {
    Header { step_ns: 0, left_out_len: 0, counts: wire::Counts::default(), ..*tracks }
}
