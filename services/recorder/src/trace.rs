//! A run as a Perfetto trace, from the hops of its forecasts' headers and from heartbeats.
//!
//! One process writes the trace of all stages:
//!
//! * Every stage is a process with its own number. It has a track of its work (*wake-up*, *compute*,
//!   *publish*, and *waiting* for a second input), tracks of frames that wait while it is busy, and a counter
//!   of these frames.
//! * A flow connects the compute of all stages for each tick.
//! * The process `pipeline` has a span for every tick from its release to its forecasts. It also has counters
//!   of agents, qualities, age and latency, and instants for late ticks and for forecasts that are not
//!   learned.
//! * Restarts, refused frames and missing frames are instants of their stage.
//!
//! [`Tracer`] converts each frame to packets, which the caller takes. It keeps only the newest ticks.

use perfetto::{Clocks, Details, Trace, Value};
use wire::{Header, Heartbeat, Hop, Quality, REFUSALS_MAX, RefusalCause, Refusals, StageId, flags};

use crate::distribution::ms;
use crate::passage::{Passage, Timestamps};
use crate::tick::Tick;

/// Number of parallel tracks of frames that wait for one stage, or of ticks in progress. Further ones
/// overlap.
const LANES: usize = 4;
/// Shortest wait for a second input that has a span.
const SHORT_NS: u64 = 20_000;
/// Start of the process numbers for unknown processes, beyond any number that Linux assigns.
const UNKNOWN_PID: u32 = 1_000_000_000;
/// Largest number of queue changes that wait to be sorted by time.
const CHANGES_MAX: usize = 64;

/// Tracks within a process. They are added to the number of the process.
mod lane {
    pub const WORK: u64 = 1;
    pub const QUEUE: u64 = 2;
    pub const WAITING: u64 = 3;
    pub const TICKS: u64 = 16;
    pub const COUNTERS: u64 = 32;
}

/// The data of a stage.
#[derive(Clone, Debug, Default)]
struct StageTracks {
    /// The newest incarnation and its process number.
    pid: Option<(u32, u32)>,
    /// The newest incarnation that has tracks.
    declared: Option<u32>,
    work_end_ns: u64,
    waiting_end_ns: [u64; LANES],
    /// Changes of the queue's length, by time. Earlier changes may still arrive.
    changes: Vec<(u64, i64)>,
    queued_count: i64,
    /// The newest heartbeat.
    beat: Option<Heartbeat>,
}

/// Writes the trace of a run.
#[derive(Clone, Debug)]
pub struct Tracer {
    trace: Trace,
    stages: [StageTracks; StageId::PLACES_LEN],
    tick_end_ns: [u64; LANES],
    /// Values of the pipeline's counters.
    counters: [f64; COUNTERS.len()],
}

/// Names and units of the pipeline's counters.
const COUNTERS: [(&str, &str); 3 + Quality::ALL.len()] = {
    let mut all = [("", "forecasts"); 3 + Quality::ALL.len()];
    all[0] = ("agents", "agents");
    all[1] = ("end to end", "ms");
    all[2] = ("oldest forecast", "ms");
    let mut nth = 0;
    while nth < Quality::ALL.len() {
        all[3 + nth].0 = Quality::ALL[nth].name();
        nth += 1;
    }
    all
};

impl Tracer {
    /// The trace of a run supervised by the process `pid`.
    #[must_use]
    pub fn new(clocks: Clocks, pid: Option<u32>) -> Self {
        let mut trace = Trace::with_room(1 << 16);
        trace.clocks(clocks);
        trace.process(0, pid.unwrap_or(UNKNOWN_PID), "pipeline", 0);
        trace.track(lane::TICKS, 0, "ticks", 0);
        for nth in 1..LANES as u64 {
            trace.track(lane::TICKS + nth, 0, "ticks that overlap", nth);
        }
        for ((name, unit), nth) in COUNTERS.into_iter().zip(lane::COUNTERS..) {
            trace.counter(nth, 0, name, unit, nth);
        }
        Self {
            trace,
            stages: Default::default(),
            tick_end_ns: [0; LANES],
            counters: [f64::NAN; COUNTERS.len()],
        }
    }

    /// Returns the complete packets.
    pub fn take(&mut self) -> Vec<u8> {
        self.trace.take()
    }

    /// Returns the last packets.
    pub fn finish(mut self) -> Vec<u8> {
        for stage in StageId::known() {
            self.count_queue(stage, u64::MAX);
        }
        self.trace.take()
    }

    /// Adds a tick with its figures.
    pub fn tick(&mut self, header: &Header, tick: &Tick) {
        let last = header.hops().len().saturating_sub(1);
        for (hop, nth) in header.hops().iter().zip(0..) {
            self.hop(hop, &tick.passage, &Flow { tick: header.seq, ends: nth == last });
        }
        self.whole(header, tick);
    }

    /// Adds the passage of a frame from an added stage outside the tick's path.
    pub fn added_stage(&mut self, header: &Header, stage: StageId, times: Timestamps) {
        if let Some(hop) = header.hop(stage) {
            let mut passage = Passage::default();
            passage.add(stage, times);
            self.hop(hop, &passage, &Flow { tick: header.seq, ends: false });
        }
    }

    /// Adds a stage's heartbeat: its process number, and its refused and missed frames since the previous
    /// one.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        let Some(stage) = StageId::from_number(heartbeat.stage) else { return };
        let known = &mut self.stages[stage.place()];
        if known.pid.is_none_or(|(incarnation, _)| heartbeat.incarnation >= incarnation) {
            known.pid = Some((heartbeat.incarnation, heartbeat.pid));
        }
        let before = known.beat.replace(*heartbeat);
        let before = before.filter(|before| before.incarnation == heartbeat.incarnation);
        let missing_before = before.map_or(0, |before| before.dropped_len);
        let missing = u64::from(heartbeat.dropped_len.saturating_sub(missing_before));
        let old = before.map_or([Refusals::default(); REFUSALS_MAX], |before| before.refusals);
        for refused in heartbeat.refusals.iter().filter(|entry| entry.link().is_none()) {
            let same = old.iter().find(|old| (old.sender, old.cause) == (refused.sender, refused.cause));
            let frames = refused.frames_len.saturating_sub(same.map_or(0, |same| same.frames_len));
            if frames > 0 {
                let sender = StageId::from_number(refused.sender.into()).map_or("unknown", StageId::name);
                let cause = RefusalCause::from_number(refused.cause.into());
                let cause = cause.map_or("unknown", RefusalCause::name);
                let values = [
                    ("frames", Value::Count(frames.into())),
                    ("sender", Value::Text(sender)),
                    ("cause", Value::Text(cause)),
                ];
                self.mark(stage, heartbeat.incarnation, heartbeat.sent_ns, "refused", &values);
            }
        }
        if missing > 0 {
            let values = [("frames", Value::Count(missing))];
            self.mark(stage, heartbeat.incarnation, heartbeat.sent_ns, "frames missing", &values);
        }
    }

    /// Marks an event of a stage, such as its death.
    pub fn event(&mut self, stage: StageId, at_ns: u64, name: &str, why: &str) {
        let incarnation = self.stages[stage.place()].declared.unwrap_or(0);
        self.mark(stage, incarnation, at_ns, name, &[("why", Value::Text(why))]);
    }

    /// Marks an event of the run.
    pub fn note(&mut self, at_ns: u64, name: &str, why: &str) {
        let values = [("why", Value::Text(why))];
        let values = if why.is_empty() { &values[..0] } else { &values[..] };
        let details = Details { category: Some("event"), values, ..Details::default() };
        self.trace.instant(lane::TICKS, at_ns, name, details);
    }

    fn mark(
        &mut self,
        stage: StageId,
        incarnation: u32,
        at_ns: u64,
        name: &str,
        values: &[(&str, Value<'_>)],
    ) {
        let process = self.process(stage, incarnation);
        let details = Details { category: Some("event"), values, ..Details::default() };
        self.trace.instant(process + lane::WORK, at_ns, name, details);
    }

    /// Writes the tracks of one stage's passage.
    fn hop(&mut self, hop: &Hop, passage: &Passage, flow: &Flow) {
        let Some(stage) = StageId::from_number(hop.stage) else { return };
        let Some(times) = passage.times(stage) else { return };
        let restarted = self.stages[stage.place()].declared.is_some_and(|newest| hop.incarnation > newest);
        let process = self.process(stage, hop.incarnation);
        if restarted {
            self.mark(stage, hop.incarnation, times.taken_ns, "restarted", &[]);
        }
        let known = &mut self.stages[stage.place()];
        let values = [("tick", Value::Count(flow.tick))];
        let phase = Details { category: Some("phase"), values: &values, ..Details::default() };
        if times.free_ns > times.ready_ns {
            let nth = free_lane(&mut known.waiting_end_ns, [times.ready_ns, times.free_ns]);
            let track = process + lane::WAITING + nth;
            self.trace.span(track, [times.ready_ns, times.free_ns], "waiting", phase);
            known.changes.extend([(times.ready_ns, 1), (times.free_ns, -1)]);
            known.changes.sort_unstable();
        }
        // The spans of a stage do not overlap, regardless of the clocks in its header.
        let mut span = |[begin_ns, end_ns]: [u64; 2], name, details: Details<'_>, least_ns| {
            let begin_ns = begin_ns.max(known.work_end_ns);
            let end_ns = end_ns.max(begin_ns);
            if end_ns - begin_ns >= least_ns {
                self.trace.span(process + lane::WORK, [begin_ns, end_ns], name, details);
                known.work_end_ns = end_ns;
            }
        };
        let Timestamps { ready_ns, free_ns, taken_ns, started_ns, finished_ns, sent_ns } = times;
        span([free_ns, taken_ns], "wake-up", phase, 1);
        span([taken_ns, started_ns], "waiting", phase, SHORT_NS);
        let computes = Details { flow: Some(flow.tick + 1), ends_flow: flow.ends, ..phase };
        span([started_ns, finished_ns], "compute", computes, 0);
        span([finished_ns, sent_ns], "publish", phase, 1);
        // Later input cannot have been ready before this one.
        self.count_queue(stage, ready_ns);
    }

    /// Writes the length of a stage's queue up to a time.
    fn count_queue(&mut self, stage: StageId, until_ns: u64) {
        let known = &mut self.stages[stage.place()];
        let Some(incarnation) = known.declared else { return };
        let excess = known.changes.len().saturating_sub(CHANGES_MAX);
        let due = known.changes.partition_point(|&(at_ns, _)| at_ns <= until_ns).max(excess);
        for (at_ns, change) in known.changes.drain(..due) {
            known.queued_count += change;
            self.trace.count(number_of(stage, incarnation) + lane::QUEUE, at_ns, known.queued_count as f64);
        }
    }

    /// The number of a stage's process. Names its tracks if they are new.
    fn process(&mut self, stage: StageId, incarnation: u32) -> u64 {
        let known = &mut self.stages[stage.place()];
        let process = number_of(stage, incarnation);
        if known.declared.is_some_and(|newest| incarnation <= newest) {
            return process;
        }
        self.count_queue(stage, u64::MAX);
        let known = &mut self.stages[stage.place()];
        known.declared = Some(incarnation);
        (known.work_end_ns, known.waiting_end_ns) = (0, [0; LANES]);
        let told = known.pid.filter(|&(of, _)| of == incarnation).map(|(_, pid)| pid);
        let made_up = UNKNOWN_PID + stage.number() * 1_000_000 + incarnation.min(999_999);
        let name = match incarnation {
            0 => stage.name().to_owned(),
            n => format!("{} (restart {n})", stage.name()),
        };
        let rank = u64::from(stage.number()) * 1_000 + u64::from(incarnation.min(999));
        self.trace.process(process, told.unwrap_or(made_up), &name, rank);
        self.trace.track(process + lane::WORK, process, "work", 0);
        for nth in 0..LANES as u64 {
            self.trace.track(process + lane::WAITING + nth, process, "frames that wait", 1 + nth);
        }
        self.trace.counter(process + lane::QUEUE, process, "queue", "frames", 9);
        process
    }

    /// Writes the span of a whole tick, and the counters.
    fn whole(&mut self, header: &Header, tick: &Tick) {
        let Some(latency_ns) = tick.passage.end_to_end_ns else { return };
        let span_ns = [header.released_ns, header.released_ns + latency_ns];
        let mut values = vec![
            ("tick", Value::Count(header.seq)),
            ("stamp_s", Value::Number(header.stamp_ns as f64 / 1e9)),
            ("agents", Value::Count(tick.agents)),
        ];
        let named = Quality::ALL.map(Quality::name).into_iter().zip(tick.qualities);
        values.extend(named.clone().map(|(name, count)| (name, Value::Count(count))));
        let marks = [("predicted", flags::PREDICTED), ("void", flags::VOID)];
        values.extend(marks.iter().filter(|mark| header.has(mark.1)).map(|mark| (mark.0, Value::Count(1))));
        let details = Details { category: Some("tick"), values: &values, ..Details::default() };
        let track = lane::TICKS + free_lane(&mut self.tick_end_ns, span_ns);
        self.trace.span(track, span_ns, &format!("tick {}", header.seq), details);

        let at_ns = span_ns[1];
        if tick.is_late() {
            self.trace.instant(lane::TICKS, at_ns, "late", details);
        }
        for (cause, count) in tick.faults() {
            let values = [("forecasts", Value::Count(count)), ("tick", Value::Count(header.seq))];
            let details = Details { category: Some("quality"), values: &values, ..Details::default() };
            self.trace.instant(lane::TICKS, at_ns, &format!("not learned: {}", cause.name()), details);
        }
        let measured = [tick.agents as f64, ms(latency_ns), ms(tick.age_ns)];
        let all = measured.into_iter().chain(named.map(|(_, count)| count as f64));
        for ((value, known), track) in all.zip(&mut self.counters).zip(lane::COUNTERS..) {
            if value.to_bits() != known.to_bits() {
                *known = value;
                self.trace.count(track, at_ns, value);
            }
        }
    }
}

/// The flow of a tick at one of its stages.
struct Flow {
    tick: u64,
    ends: bool,
}

/// The number of a stage's process track.
const fn number_of(stage: StageId, incarnation: u32) -> u64 {
    (stage.number() as u64) << 48 | (incarnation as u64) << 8
}

/// A free lane for a span. If no lane is free, the one that becomes free first.
fn free_lane(ends_ns: &mut [u64; LANES], [begin_ns, end_ns]: [u64; 2]) -> u64 {
    let free = ends_ns.iter().position(|&end| end <= begin_ns);
    let soonest = || (0..LANES).min_by_key(|&nth| ends_ns[nth]).unwrap_or(0);
    let nth = free.unwrap_or_else(soonest);
    ends_ns[nth] = ends_ns[nth].max(end_ns);
    nth as u64
}

#[cfg(test)]
mod tests;
