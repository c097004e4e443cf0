//! Frames that arrive while a run is running, as ticks of the run.
//!
//! A tick is the newest frame. Frames that are too near to the previous tick wait:
//!
//! 1. The interval I of the frames is the mean difference of their last stamps, without gaps.
//! 2. With n = ⌈72 ms / I⌉, a frame is due if its stamp is at least n I − I / 2 after the previous tick's
//!    stamp.
//! 3. When a tick goes out, the detections of other sensors in the waiting frames are merged into it, each
//!    with its own time, by the rules for recordings ([`merge`]).
//! 4. If no frame is due for 80 ms after a frame arrived, the waiting frames go out.

use audit::{Clock, Stamped, StampedFrame};
use data::Frame;
use ports::{Stage, StageError, monotonic_ns};
use run::{Declaration, Run};
use wire::{
    Counts, DETECTIONS_MAX, Detection, Header, InputCounts, LinkCount, OFFSET_MAX_NS, StampSource, TICK_NS,
    flags,
};

use crate::stage::{ANSWER_LIMIT_NS, END_LIMIT_NS};
use crate::{Outputs, Tick, merge};

/// Numbers of stamps from which the interval of the frames is estimated.
const STAMPS_MIN: usize = 9;
const STAMPS_MAX: usize = 32;
/// A difference of this many times the median is a gap, not an interval.
const GAP: i64 = 4;
/// Frames wait if they are faster than the ticks by more than 1 / `TOLERANCE`. Stamps of
/// a live sensor vary, and a rate that is taken for a higher one costs every second frame.
const TOLERANCE: u64 = 10;
/// A stamp that is ahead by more, the horizon of the forecasts, begins a session.
const HORIZON_NS: u64 = 4_800_000_000;
/// Time without a tick that is silence, and a time between two ticks that is a gap.
const SILENCE_NS: u64 = 1_000_000_000;
const GAP_NS: u64 = 10_000_000_000;
/// Maximum number of frames that wait.
const WAITING_MAX: usize = 64;

/// A tick for the pipeline.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveTick {
    /// The detections.
    pub frame: Frame,
    /// The planned interval between ticks.
    pub interval_ns: u64,
    /// Detections that found no room in the frame.
    pub left_out: u32,
    /// Detections of frames that did not go out, since the start.
    pub input: InputCounts,
}

/// A frame that waits for its tick.
#[derive(Debug)]
struct Waiting {
    frame: Frame,
    arrived_ns: u64,
}

/// Makes ticks of frames.
#[derive(Debug)]
pub struct LiveTicks {
    /// Frames that wait for a tick, by stamp.
    frames: Vec<Waiting>,
    /// The newest stamps, sorted.
    stamps: Vec<i64>,
    last_ns: Option<i64>,
    clock: Clock,
    input: InputCounts,
    dropped: u64,
    restarts: u64,
}

impl Default for LiveTicks {
    fn default() -> Self {
        Self {
            frames: Vec::new(),
            stamps: Vec::new(),
            last_ns: None,
            clock: Clock::of_several(HORIZON_NS),
            input: InputCounts::default(),
            dropped: 0,
            restarts: 0,
        }
    }
}

impl LiveTicks {
    /// Number of frames that others pushed out of the queue.
    #[must_use]
    pub const fn dropped(&self) -> u64 {
        self.dropped
    }

    /// How often the stamps went back: a clock was set, or a recording begins again.
    #[must_use]
    pub const fn restarts(&self) -> u64 {
        self.restarts
    }

    /// Adds a frame that arrived at `arrived_ns` on `CLOCK_MONOTONIC`; the tick, if the frame is due.
    pub fn add(&mut self, frame: Frame, arrived_ns: u64) -> Option<LiveTick> {
        let stamp_ns = frame.stamp_ns;
        let is_repeated = self.frames.iter().any(|waiting| waiting.frame == frame);
        let stamped = StampedFrame { stamp_ns, interval_ns: 0, released_ns: Some(arrived_ns), is_repeated };
        if matches!(self.clock.add(stamped), Stamped::Set { by_ns } if by_ns < 0) {
            self.restarts += 1;
            self.stamps.clear();
            self.frames.clear();
            self.last_ns = None;
        }
        let place = self.stamps.partition_point(|stamp| *stamp < stamp_ns);
        if self.stamps.get(place) != Some(&stamp_ns) {
            self.stamps.insert(place, stamp_ns);
        }
        if self.stamps.len() > STAMPS_MAX {
            self.stamps.remove(0);
        }
        let place = self.frames.partition_point(|other| other.frame.stamp_ns <= stamp_ns);
        self.frames.insert(place, Waiting { frame, arrived_ns });
        if self.frames.len() > WAITING_MAX {
            self.frames.remove(0);
            self.dropped += 1;
        }
        self.is_due(stamp_ns).then(|| self.tick())?
    }

    /// The tick of frames that have waited too long at `now_ns`.
    pub fn overdue(&mut self, now_ns: u64) -> Option<LiveTick> {
        let oldest_ns = self.frames.iter().map(|waiting| waiting.arrived_ns).min()?;
        (now_ns.saturating_sub(oldest_ns) >= TICK_NS).then(|| self.tick())?
    }

    /// The mean interval of the frames. While few frames are known, it is the interval of the ticks.
    fn interval_ns(&self) -> u64 {
        if self.stamps.len() < STAMPS_MIN {
            return TICK_NS;
        }
        let mut differences: Vec<i64> = self.stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
        differences.sort_unstable();
        let Some(&median) = differences.get(differences.len() / 2) else { return TICK_NS };
        differences.retain(|difference| *difference <= median.saturating_mul(GAP));
        let mean_ns = differences.iter().sum::<i64>() / differences.len().max(1) as i64;
        u64::try_from(mean_ns).unwrap_or(TICK_NS).max(1)
    }

    /// Number of frames for each tick.
    fn thinning(&self) -> u64 {
        (TICK_NS - TICK_NS / TOLERANCE).div_ceil(self.interval_ns())
    }

    fn is_due(&self, stamp_ns: i64) -> bool {
        let Some(last_ns) = self.last_ns else { return true };
        let interval_ns = self.interval_ns();
        let apart_ns = self.thinning() * interval_ns - interval_ns / 2;
        stamp_ns.saturating_sub(last_ns) >= i64::try_from(apart_ns).unwrap_or(i64::MAX)
    }

    /// The newest frame with the others merged into it.
    fn tick(&mut self) -> Option<LiveTick> {
        let Waiting { mut frame, .. } = self.frames.pop()?;
        let oldest_ns = frame.stamp_ns.saturating_sub(OFFSET_MAX_NS as i64);
        let others: Vec<Frame> = self.frames.drain(..).map(|waiting| waiting.frame).collect();
        let waited: usize = others.iter().map(|other| other.detections.len()).sum();
        let others: Vec<Frame> = others.into_iter().filter(|other| other.stamp_ns >= oldest_ns).collect();
        let merged = merge(&others, &mut frame, self.interval_ns());
        self.input.merged = self.input.merged.wrapping_add(merged);
        self.input.unplayed = self.input.unplayed.wrapping_add(waited as u32 - merged);
        let left_out = frame.detections.len().saturating_sub(DETECTIONS_MAX) as u32;
        if left_out > 0 {
            let [x_m, y_m] = frame.ego.position_m;
            let distance_m = |d: &Detection| (d.x_m - x_m).hypot(d.y_m - y_m);
            let rank = |a: &Detection, b: &Detection| {
                b.score.total_cmp(&a.score).then(distance_m(a).total_cmp(&distance_m(b)))
            };
            frame.detections.sort_by(rank);
            frame.detections.truncate(DETECTIONS_MAX);
            frame.detections.sort_by_key(|detection| (detection.agent_type, detection.id));
        }
        self.last_ns = Some(frame.stamp_ns);
        let interval_ns = self.thinning() * self.interval_ns();
        Some(LiveTick { frame, interval_ns, left_out, input: self.input })
    }
}

/// A source whose ticks arrive from outside: the state between two ticks.
#[derive(Debug)]
pub struct LiveSource {
    stage: Stage,
    outputs: Outputs,
    /// What all headers have in common.
    base: Header,
    /// Number of the next tick.
    seq: u64,
    /// Stamp and interval of the previous tick.
    stamp_ns: i64,
    interval_ns: u64,
    ticks_max: Option<u64>,
    is_lockstep: bool,
    /// Whether the tracker has been asked to predict ticks since the last one.
    is_missing: bool,
    /// Whether the tracker predicts ticks during silence.
    predicts: bool,
    /// When the previous tick was sent on `CLOCK_MONOTONIC`, and the time between the previous two.
    sent_ns: u64,
    apart_ns: u64,
}

impl LiveSource {
    /// Joins the run. The source ends after `ticks_max` ticks.
    ///
    /// # Errors
    /// [`StageError`] if the run's shared memory can't be used.
    pub fn open<O>(
        run: &Run,
        declaration: &Declaration<O>,
        ticks_max: Option<u64>,
    ) -> Result<Self, StageError> {
        let mut stage = Stage::open(run, declaration)?;
        let outputs = Outputs::open(&mut stage, run)?;
        let lockstep = if run.lockstep { flags::LOCKSTEP } else { 0 };
        let stamp_source = StampSource::SensorClock as u32;
        let base = Header { flags: lockstep, stamp_source, ..Header::new(run.id, 0, 0) };
        let (interval_ns, is_lockstep) = (run.interval_ns, run.lockstep);
        Ok(Self {
            stage,
            outputs,
            base,
            seq: 0,
            stamp_ns: 0,
            interval_ns,
            ticks_max,
            is_lockstep,
            is_missing: false,
            predicts: true,
            sent_ns: 0,
            apart_ns: 0,
        })
    }

    /// States whether the tracker predicts ticks during silence, until the tracks end.
    pub const fn set_prediction(&mut self, predicts: bool) {
        self.predicts = predicts;
    }

    /// States whether the detections have identities that the tracker may trust.
    pub const fn set_identities(&mut self, has_identities: bool) {
        let others = self.base.flags & !flags::HAS_IDENTITIES;
        self.base.flags = others | if has_identities { flags::HAS_IDENTITIES } else { 0 };
    }

    /// As [`Stage::set_link`].
    pub fn set_link(&mut self, counts: impl IntoIterator<Item = (LinkCount, u64)>) {
        self.stage.set_link(counts);
    }

    /// Links the stages before the first tick, or takes over from a source that died or was replaced.
    ///
    /// # Errors
    /// [`StageError`] if the stages do not answer.
    pub fn link(&mut self) -> Result<(), StageError> {
        let warm_up = self.empty(flags::WARM_UP);
        if self.stage.incarnation() > 0 {
            self.seq = self.outputs.take_over(&mut self.stage, warm_up)?.map_or(0, |seq| seq + 1);
            return Ok(());
        }
        let is_linked = |peers: &ports::Peers| peers.unlinked().is_empty();
        self.outputs.repeat(&mut self.stage, warm_up, ANSWER_LIMIT_NS, is_linked)
    }

    /// Whether the last tick has been sent, or the process has been asked to end.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.stage.stop().requested() || self.ticks_max.is_some_and(|ticks| self.seq >= ticks)
    }

    /// Does the work between two ticks that is due. It does not wait. Silence begins a second after a tick, or
    /// 2.5 intervals after it if that is longer.
    ///
    /// # Errors
    /// [`StageError`] if the transport fails.
    pub fn tend(&mut self) -> Result<(), StageError> {
        let silence_ns = SILENCE_NS.max(self.apart_ns.saturating_mul(5) / 2);
        if self.predicts && monotonic_ns().saturating_sub(self.sent_ns) >= silence_ns {
            self.miss()?;
        }
        Ok(self.outputs.tend(&mut self.stage)?)
    }

    /// States that no tick arrives for now. Until the next one, the tracker predicts ticks, as if this
    /// process had died. A late tick is never missing in lockstep.
    ///
    /// # Errors
    /// [`StageError`] if the transport fails.
    pub fn miss(&mut self) -> Result<(), StageError> {
        if self.is_missing || self.is_lockstep || self.seq == 0 {
            return Ok(());
        }
        self.is_missing = true;
        let header = self.empty(flags::WARM_UP);
        Ok(self.outputs.send_empty(&mut self.stage, header)?)
    }

    /// Releases a tick.
    ///
    /// # Errors
    /// [`StageError`] if the transport fails; in lockstep, if the stages do not answer.
    pub fn send(&mut self, tick: &LiveTick) -> Result<(), StageError> {
        if std::mem::take(&mut self.is_missing) {
            // After the predicted ticks.
            let warm_up = self.empty(flags::WARM_UP);
            let answered = self.outputs.take_over(&mut self.stage, warm_up)?;
            self.seq = self.seq.max(answered.map_or(0, |seq| seq + 1));
        }
        let frame = &tick.frame;
        let from_ego = if frame.ego.is_sensor { flags::SEEN_FROM_EGO } else { 0 };
        let header = Header {
            flags: self.base.flags | from_ego,
            seq: self.seq,
            stamp_ns: frame.stamp_ns,
            interval_ns: tick.interval_ns,
            observed_types: frame.observed_types,
            ego_m: frame.ego.position_m,
            ego_heading_rad: frame.ego.heading_rad,
            left_out_len: tick.left_out,
            input: tick.input,
            counts: Counts { agents_len: frame.detections.len() as u32, ..Counts::default() },
            ..self.base
        };
        let tick = Tick { header, detections: &frame.detections, truth: &[], due_ns: 0 };
        self.outputs.send(&mut self.stage, &tick)?;
        if self.is_lockstep {
            self.outputs.wait_for_forecasts(&mut self.stage, self.seq, ANSWER_LIMIT_NS)?;
        }
        self.seq += 1;
        let before_ns = std::mem::replace(&mut self.sent_ns, monotonic_ns());
        let apart_ns = self.sent_ns - before_ns;
        if apart_ns <= GAP_NS {
            self.apart_ns = apart_ns;
        }
        (self.stamp_ns, self.interval_ns) = (header.stamp_ns, header.interval_ns);
        Ok(())
    }

    /// Ends the run after the last tick, unless the process has been asked to end.
    pub fn end(mut self) {
        if self.stage.stop().requested() {
            return;
        }
        // The end frame must not push the last tick out of a queue.
        let (end, last) = (self.empty(flags::END), self.seq.saturating_sub(1));
        let _ = self.outputs.wait_for_forecasts(&mut self.stage, last, END_LIMIT_NS);
        let _ = self.outputs.repeat(&mut self.stage, end, END_LIMIT_NS, |_| false);
    }

    /// The header of a frame without detections. The end follows the last tick by an interval.
    fn empty(&self, flags: u32) -> Header {
        Header {
            flags: self.base.flags | flags,
            seq: self.seq,
            stamp_ns: self.stamp_ns.saturating_add_unsigned(self.interval_ns),
            interval_ns: self.interval_ns,
            ..self.base
        }
    }
}
