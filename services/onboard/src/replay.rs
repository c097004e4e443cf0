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
use std::sync::Arc;
use std::time::Instant;

use nn::Weights;
use recording::{Comparison, Frame, FrameError, Message, Recording};
use run::is_feedback;
use thiserror::Error;
use wire::{
    ControlsTopic, DetectionsTopic, ForecastsTopic, Header, HeartbeatsTopic, StageId, Topic, TracksTopic,
    flags,
};

use crate::replay::{pace::Pace, tick::Tick};
use crate::{ChainError, OwnFrame, STAGES, Stages};

pub use self::pace::OwnTime;

/// A tick is replayed once this many later ticks have begun. Its last frame has arrived by then, or never
/// will.
const LATER: usize = 24;
/// Number of recent forecasts kept as candidates for the tracker's prior.
const PRIORS_MAX: usize = 24;

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
    forecasts: VecDeque<(u64, Arc<OwnFrame<ForecastsTopic>>)>,
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
        let stages = Stages::new(&recording.about().run, weights)?;
        Self::over(recording, stages, alone)
    }

    /// As [`Replay::new`], with these stages.
    ///
    /// # Errors
    /// [`ReplayError`] if the recording lacks a topic.
    pub fn over(
        recording: &'a Recording,
        stages: Stages,
        alone: Option<StageId>,
    ) -> Result<Self, ReplayError> {
        let path = recording.path().display().to_string();
        let declared = STAGES.iter().find(|stage| alone == Some(stage.id()));
        let wanted: Vec<&'static str> = match declared {
            None => vec![DetectionsTopic::NAME],
            Some(stage) => [stage.reads(), stage.writes()].concat(),
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
        Ok(Self {
            recording,
            stages,
            alone,
            incarnations: BTreeMap::new(),
            forecasts: VecDeque::new(),
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
        let inputs = STAGES.iter().flat_map(|stage| stage.reads().iter().copied());
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
        let begins_late = self.alone.is_none() && self.found.missing_before.is_some();
        self.found.tracks_are_recorded = begins_late && self.recording.has_topic(TracksTopic::NAME);
        let stages = self.stages.graph.stages();
        let is_replayed = |stage: StageId| match self.alone {
            Some(alone) => stage == alone,
            None => stage != StageId::Tracker || !self.found.tracks_are_recorded,
        };
        let replayed: Vec<_> = stages.into_iter().filter(|(stage, ..)| is_replayed(*stage)).collect();
        // Frames that no stage of the replay makes come from the file.
        let read =
            replayed.iter().flat_map(|(stage, reads, _)| reads.iter().map(move |topic| (*stage, *topic)));
        for topic in read.filter(|(stage, topic)| !is_feedback(*stage, topic)).map(|(_, topic)| topic) {
            if replayed.iter().all(|(_, _, writes)| *writes != topic)
                && let Err(error) = self.stages.graph.put_recorded(topic, tick.frame(topic))
            {
                self.found.impossible.get_or_insert(error);
            }
        }
        let impossible = &mut self.found.impossible;
        let (tracks, forecasts) =
            (tick.sound::<TracksTopic>(impossible), tick.sound::<ForecastsTopic>(impossible));
        tick.sound::<ControlsTopic>(impossible);
        for (stage, _, writes) in replayed {
            let is_answered = match stage {
                StageId::Tracker => self.begin_tracker(seq, tick, tracks)?,
                StageId::Sampler => self.begin_sampler(seq, forecasts)?,
                // Alone, the stage needs its input from the file.
                _ if self.alone.is_none() && !self.stages.graph.has_input(stage) => false,
                _ => self.has_passed(stage, tick, writes)?,
            };
            if is_answered {
                self.stages.graph.answer(stage, tick.allowance(stage));
            } else {
                self.stages.graph.clear(writes);
            }
            if is_answered || matches!(stage, StageId::Tracker | StageId::Sampler) {
                self.compare(tick, writes, each);
            }
        }
        self.keep_forecasts(tick, forecasts);
        Ok(())
    }

    /// Keeps the forecasts of a tick as a prior of later ticks.
    fn keep_forecasts(&mut self, tick: &Tick, recorded: Option<&Header>) {
        let sent_ns = recorded.and_then(|header| Some(header.hop(StageId::Sampler)?.sent_ns));
        let made =
            if self.does(StageId::Sampler) { self.stages.graph.shared::<ForecastsTopic>() } else { None };
        let forecasts = made.map(|made| match recorded {
            // The tracker reports the cost of the forecasts from the run's own hops.
            Some(recorded) => {
                let header = made.header.with_hops_of(recorded);
                Arc::new(OwnFrame { header, elements: made.elements.clone() })
            }
            None => made,
        });
        let forecasts = forecasts.or_else(|| tick.own(&mut self.found.impossible).map(Arc::new));
        if let Some(forecasts) = forecasts.filter(|forecasts| !forecasts.is_void()) {
            self.forecasts.push_back((sent_ns.unwrap_or(0), forecasts));
            if self.forecasts.len() > PRIORS_MAX {
                self.forecasts.pop_front();
            }
        }
    }

    fn does(&self, stage: StageId) -> bool {
        self.alone.is_none_or(|alone| alone == stage)
    }

    /// Puts the frames of a tick before the tracker. Returns `false` if the run's tracker has not answered the
    /// tick.
    fn begin_tracker(
        &mut self,
        seq: u64,
        tick: &Tick,
        recorded: Option<&Header>,
    ) -> Result<bool, ReplayError> {
        if recorded.is_none() && self.recording.has_topic(TracksTopic::NAME) {
            return Ok(false);
        }
        if let Some(incarnation) = tick.incarnation(StageId::Tracker, TracksTopic::NAME) {
            self.renew(StageId::Tracker, incarnation)?;
        }
        let is_predicted = recorded.is_some_and(|tracks| tracks.has(flags::PREDICTED));
        if let Some(tracks) =
            recorded.filter(|_| is_predicted || !self.stages.graph.has_input(StageId::Tracker))
        {
            // The tick was predicted, or its detections are missing in the file.
            if !is_predicted {
                self.found.without_detections.push(seq);
            }
            self.stages.graph.put::<DetectionsTopic>(&predicted(tracks), &[]);
        }
        let Some(detections) = self.stages.graph.shared::<DetectionsTopic>() else { return Ok(false) };
        match self.prior(seq, &detections.header, recorded) {
            Some(prior) => self.stages.graph.put_shared(prior),
            None => self.stages.graph.clear(ForecastsTopic::NAME),
        }
        Ok(true)
    }

    /// Chooses the forecasts that were available to the tracker; `None` if it kept the ones that it had. In
    /// lockstep they belong to the previous tick. Otherwise the recorded age identifies them. Without a recorded
    /// age, the newest forecasts sent before the tracker started are chosen.
    fn prior(
        &mut self,
        seq: u64,
        header: &Header,
        tracks: Option<&Header>,
    ) -> Option<Arc<OwnFrame<ForecastsTopic>>> {
        let mut forecasts = self.forecasts.iter().rev();
        if header.has(flags::LOCKSTEP) {
            return forecasts
                .find(|(_, forecasts)| forecasts.header.seq + 1 == seq)
                .map(|(_, found)| found.clone());
        }
        // The tracker has reported their age.
        if let Some(tracks) = tracks.filter(|tracks| tracks.feedback_age_ns > 0) {
            let stamp_ns = tracks.stamp_ns.saturating_sub_unsigned(tracks.feedback_age_ns);
            let told = forecasts.find(|(_, forecasts)| forecasts.header.stamp_ns == stamp_ns);
            return told.map(|(_, found)| found.clone());
        }
        let Some(hop) = tracks.and_then(|tracks| tracks.hop(StageId::Tracker)) else {
            return forecasts.next().map(|(_, newest)| newest.clone());
        };
        /// Forecasts sent this close to the tracker's check may or may not have been available.
        const CLOSE_NS: u64 = 1_000_000;
        if self.forecasts.iter().any(|(sent_ns, _)| sent_ns.abs_diff(hop.started_ns) < CLOSE_NS) {
            self.found.close_priors.push(seq);
        }
        let sent_before = self.forecasts.iter().filter(|(sent_ns, _)| *sent_ns < hop.started_ns);
        sent_before.max_by_key(|(sent_ns, _)| *sent_ns).map(|(_, found)| found.clone())
    }

    /// Puts the frames of a tick before the sampler. Returns `false` if the run's sampler has not answered the
    /// tick.
    fn begin_sampler(&mut self, seq: u64, recorded: Option<&Header>) -> Result<bool, ReplayError> {
        if !self.stages.graph.has_input(StageId::Sampler)
            || (recorded.is_none() && self.recording.has_topic(ForecastsTopic::NAME))
        {
            return Ok(false);
        }
        // A frame that is passed on as VOID leaves no trace in the sampler, and does not show the sampler's
        // initial state.
        if let Some(recorded) = recorded.filter(|recorded| !recorded.has(flags::VOID)) {
            self.renew_sampler(seq, recorded)?;
        }
        // The hops show whether the controls had arrived.
        if recorded.is_some_and(|recorded| recorded.hop(StageId::Decoder).is_none()) {
            self.stages.graph.clear(ControlsTopic::NAME);
        }
        Ok(true)
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
    fn compare(&mut self, tick: &Tick, topic: &'static str, each: &mut impl FnMut(&Frame)) {
        let recorded = tick.frame(topic);
        let received_ns = recorded.map_or_else(|| tick.received_ns(), Frame::received_ns);
        match (recorded, self.stages.graph.recorded(topic, received_ns)) {
            (Some(recorded), Some(made)) if tick.is_recorded(topic) => {
                self.found.comparison.pair(recorded, &made);
                each(&made);
            }
            (Some(recorded), Some(made)) => self.found.before.pair(recorded, &made),
            (Some(recorded), None) if !tick.is_recorded(topic) => {
                self.found.before.alone(topic, recorded.header().seq, true);
            }
            (None, _) if tick.is_before() => {}
            (Some(recorded), None) => self.found.comparison.alone(topic, recorded.header().seq, true),
            (None, Some(made)) if self.recording.has_topic(topic) => {
                self.found.comparison.alone(topic, made.header().seq, false);
            }
            (None, Some(made)) => each(&made),
            (None, None) => {}
        }
    }
}

/// Returns the header with which the tracker predicted a tick, from the header of its tracks.
fn predicted(tracks: &Header) -> Header {
    Header { step_ns: 0, left_out_len: 0, counts: wire::Counts::default(), ..*tracks }
}
