mod checkpoint;
mod options;
mod recent;
mod shed;
mod stages;
mod verdict;
mod window;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wire::{Cause, Forecast, Header, Heartbeat, Quality, Rejected, StageId, Truth, flags};

use crate::accuracy::Scorer;
use crate::arrivals::{Arrivals, InputStatus};
use crate::distribution::{Distribution, ms};
use crate::input::InputTally;
use crate::lanes::LaneCounts;
use crate::losses::Losses;
use crate::passage::{Timeline, Timestamps};
use crate::report::{
    Accuracy, Agents, ForecastCounts, OutOfDistribution, PriorCounts, REPORT_VERSION, Report, RunInfo,
    Supervision, Verdict, WorstTick,
};
use crate::sessions::Sessions;
use crate::tick::{Tick, is_fault, limit_ns};
use crate::worst::{Usual, Worst};

pub use checkpoint::Checkpoint;
pub use options::RecorderOptions;
use recent::Recent;
use shed::ShedCounts;
use stages::StageTimes;
use verdict::verdict;

/// Greatest time from a stamp to the publication of its forecasts. A greater one means another clock.
const SINCE_STAMP_MAX_NS: u64 = 10_000_000_000;

/// First and last value of increasing clocks.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Span {
    stamp_ns: [i64; 2],
    released_ns: [u64; 2],
}

/// The sums over all ticks.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Sums {
    end_to_end: Distribution,
    overhead: Distribution,
    #[serde(default)]
    since_stamp: Distribution,
    /// By the stage's number.
    stages: BTreeMap<u32, StageTimes>,
    losses: Losses,
    span: Option<Span>,
    #[serde(default)]
    sessions: Sessions,
    #[serde(default)]
    arrivals: Arrivals,
    /// Number of the next tick, if it is known.
    next_seq: Option<u64>,
    interval_ns: u64,
    lockstep: bool,
    ticks: u64,
    late_ticks: u64,
    agents_left_out: u64,
    hops_missing: u64,
    #[serde(default)]
    files_unwritten: u64,
    #[serde(default)]
    unpublished_ticks: u64,
    input: InputTally,
    agents_max: u64,
    forecasts_by_quality: [u64; Quality::ALL.len()],
    fallbacks_by_cause: [u64; Cause::ALL.len()],
    states_by_prior: [u64; Quality::ALL.len()],
    degraded_ticks: u64,
    predicted_ticks: u64,
    silent: u64,
    age_ns_max: Option<u64>,
    shed: ShedCounts,
    out_of_distribution: OutOfDistribution,
    lanes: LaneCounts,
    worst: Worst,
}

/// Measures a run and reports the results.
#[derive(Clone, Debug)]
pub struct Recorder {
    options: RecorderOptions,
    timeline: Timeline,
    sums: Sums,
    recent: Recent,
    scorer: Scorer,
    /// When the run ended, if a silence may have lasted until then.
    ended_ns: Option<u64>,
    /// Whether the recorder continues from a previous recorder's checkpoint and has not received a tick yet.
    resumed: bool,
    /// Unix time minus `CLOCK_MONOTONIC`, if it is known.
    clock_offset_ns: Option<i64>,
}

impl Recorder {
    /// A recorder before the first frame.
    #[must_use]
    pub fn new(options: RecorderOptions) -> Self {
        let arrivals = Arrivals::new(options.silence_ns);
        Self {
            options,
            timeline: Timeline::default(),
            sums: Sums { arrivals, ..Sums::default() },
            recent: Recent::default(),
            scorer: Scorer::default(),
            ended_ns: None,
            resumed: false,
            clock_offset_ns: None,
        }
    }

    /// Sets Unix time minus `CLOCK_MONOTONIC`. Then the time from the stamp to the publication is measured, if
    /// stamps are Unix time.
    pub const fn set_clock_offset(&mut self, offset_ns: i64) {
        self.clock_offset_ns = Some(offset_ns);
    }

    /// Counts a file about the run that could not be written.
    pub const fn count_unwritten(&mut self) {
        self.sums.files_unwritten += 1;
    }

    /// Adds the truth at the frame's stamp. Control frames are ignored.
    ///
    /// # Errors
    /// [`Rejected`] if a number is invalid or the frame is not newer than the last; nothing changes then.
    pub fn truth(&mut self, header: &Header, truths: &[Truth]) -> Result<(), Rejected> {
        header.check()?;
        if header.is_tick() { self.scorer.truth(header, truths) } else { Ok(()) }
    }

    /// Adds the forecasts of a tick and, from their header, its passage through the pipeline.
    ///
    /// Lost ticks are gaps in the sequence. After a warm-up frame the sequence starts at tick 0. Otherwise it
    /// starts at the first tick received, because the recorder may start during a run. The END frame of a
    /// recording reveals ticks lost before it. A VOID tick that is not newer than the last arrived late at
    /// the tracker. It is not lost, but unpublished. Another tick with an older stamp begins a session.
    ///
    /// Returns the figures of the tick; `None` if the frame is not a newer tick.
    ///
    /// # Errors
    /// [`Rejected`] if the frame is invalid or has forecasts that are not newer than the last. The frame is
    /// counted as refused.
    pub fn forecasts(&mut self, header: &Header, forecasts: &[Forecast]) -> Result<Option<Tick>, Rejected> {
        if header.has(flags::WARM_UP) {
            self.sums.next_seq.get_or_insert(0);
            return Ok(None);
        }
        if let Err(rejected) = self.check(header, forecasts) {
            self.sums.losses.forecast_refused();
            return Err(rejected);
        }
        let mut gap = self.sums.next_seq.map_or(0, |expected| header.seq.saturating_sub(expected));
        let restarted = self.sums.losses.restarted(header);
        if std::mem::take(&mut self.resumed) {
            self.sums.losses.unrecorded(gap);
            gap = 0;
        } else {
            self.sums.losses.forecast_gap(restarted, gap);
        }
        self.sums.next_seq = Some(header.seq.saturating_add(1));
        if !header.is_tick() {
            self.sums.arrivals.end();
            return Ok(None);
        }
        self.sums.arrivals.tick(header);
        if self.sums.sessions.is_old(header) {
            self.sums.unpublished_ticks += 1;
            return Ok(None);
        }
        let tick = Tick::new(&mut self.timeline, header, forecasts);
        self.header(header, forecasts);
        self.times(&tick);
        self.since_stamp(header);
        self.qualities(&tick);
        self.sums.lanes.add(forecasts);
        self.sums.worst.take(&tick, header.stamp_ns, restarted, gap, self.options.explain);
        self.recent.tick(&tick);
        if self.options.scores {
            self.scorer.forecasts(header, forecasts);
        }
        Ok(Some(tick))
    }

    /// Whether the previous recorder has recorded the tick. A topic keeps such ticks for new readers.
    #[must_use]
    pub fn is_recorded(&self, header: &Header) -> bool {
        self.resumed && header.is_tick() && self.sums.sessions.is_old(header)
    }

    /// Adds the header of a frame from an added stage outside the tick's path. Returns the stage and its times
    /// in the tick. An invalid header is ignored, because the frame's readers refuse it.
    pub fn added_stage(&mut self, header: &Header) -> Option<(StageId, Timestamps)> {
        if header.check().is_err() || !header.is_tick() {
            return None;
        }
        let (stage, times) = self.timeline.newest_times(header).filter(|(stage, _)| stage.is_added())?;
        let budget_ms = self.options.budgets_ms.get(&stage).copied();
        self.sums.stages.entry(stage.number()).or_default().record(&times.into(), budget_ms);
        self.recent.added_stage(stage, times);
        Some((stage, times))
    }

    /// Adds a stage's heartbeat.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        self.sums.losses.heartbeat(heartbeat);
        self.recent.heartbeat(heartbeat);
        if heartbeat.stage == StageId::Source.number() {
            self.sums.arrivals.source(heartbeat.seq, heartbeat.sent_ns);
        }
    }

    fn check(&self, header: &Header, forecasts: &[Forecast]) -> Result<(), Rejected> {
        header.check()?;
        let expected = header.counts.agents_len as usize;
        if forecasts.len() != expected {
            return Err(Rejected::Length { found: forecasts.len(), expected });
        }
        if let Some((_, last_ns)) = self.sums.sessions.newest
            && header.is_tick()
            && !header.has(flags::VOID)
            && self.sums.sessions.is_old(header)
        {
            return Err(Rejected::NotNewer { stamp_ns: header.stamp_ns, last_ns });
        }
        if self.options.scores { forecasts.iter().try_for_each(Forecast::check) } else { Ok(()) }
    }

    fn header(&mut self, header: &Header, forecasts: &[Forecast]) {
        let sums = &mut self.sums;
        sums.ticks += 1;
        sums.interval_ns = header.interval_ns;
        sums.lockstep |= header.has(flags::LOCKSTEP);
        let first = Span { stamp_ns: [header.stamp_ns; 2], released_ns: [header.released_ns; 2] };
        let span = sums.span.get_or_insert(first);
        if let Some(by_ns) = sums.sessions.tick(header) {
            // The played time has no step.
            span.stamp_ns[0] = span.stamp_ns[0].saturating_add(by_ns);
            self.scorer.end_session();
        }
        span.stamp_ns[1] = header.stamp_ns;
        span.released_ns[1] = header.released_ns;
        sums.agents_left_out += u64::from(header.left_out_len);
        sums.hops_missing += u64::from(header.hops_missing_len);
        sums.predicted_ticks += u64::from(header.has(flags::PREDICTED));
        sums.silent += u64::from(header.silent_len);
        sums.input.tick(header, forecasts.iter().map(|forecast| (forecast.agent_type, forecast.noise())));
    }

    fn times(&mut self, tick: &Tick) {
        let Self { sums, options, .. } = self;
        tick.passage.end_to_end_ns.into_iter().for_each(|time_ns| sums.end_to_end.record(time_ns));
        tick.passage.overhead_ns().into_iter().for_each(|time_ns| sums.overhead.record(time_ns));
        sums.late_ticks += u64::from(tick.is_over_limit());
        for &stage in &options.stages {
            if let Some(phases) = tick.passage.phases(stage) {
                let budget_ms = options.budgets_ms.get(&stage).copied();
                sums.stages.entry(stage.number()).or_default().record(&phases, budget_ms);
            }
        }
    }

    /// Measures the time from a sensor's stamp to the sending of the forecasts. A stamp of another clock is more
    /// than [`SINCE_STAMP_MAX_NS`] away, or in the future.
    fn since_stamp(&mut self, header: &Header) {
        let Some((offset_ns, hop)) = self.clock_offset_ns.zip(header.hop(StageId::Sampler)) else { return };
        if header.has(flags::PREDICTED) {
            return;
        }
        let published_ns = offset_ns.saturating_add_unsigned(hop.sent_ns);
        let since_ns = u64::try_from(published_ns.saturating_sub(header.stamp_ns)).unwrap_or(u64::MAX);
        if since_ns <= SINCE_STAMP_MAX_NS {
            self.sums.since_stamp.record(since_ns);
        }
    }

    fn qualities(&mut self, tick: &Tick) {
        let sums = &mut self.sums;
        sums.agents_max = sums.agents_max.max(tick.agents);
        sums.shed.add(tick);
        add(&mut sums.forecasts_by_quality, &tick.qualities);
        add(&mut sums.fallbacks_by_cause, &tick.causes);
        add(&mut sums.states_by_prior, &tick.priors);
        sums.out_of_distribution.merge(&tick.out_of_distribution);
        sums.age_ns_max = sums.age_ns_max.max(tick.held_age_ns[0]);
        sums.degraded_ticks += u64::from(tick.is_degraded);
    }

    /// States that the run ends at this time, on `CLOCK_MONOTONIC`. A silence counts until then.
    pub const fn end(&mut self, now_ns: u64) {
        self.ended_ns = Some(now_ns);
    }

    /// The state of the input at this time.
    #[must_use]
    pub fn input_status(&self, now_ns: u64) -> InputStatus {
        self.sums.arrivals.status(now_ns)
    }

    /// The report so far. It may be called at any time and changes nothing.
    #[must_use]
    pub fn report(&self) -> Report {
        let stages = self.stage_reports();
        let mut report = Report {
            version: REPORT_VERSION,
            stgdat_version: env!("CARGO_PKG_VERSION").to_owned(),
            verdict: Verdict::default(),
            run: self.run(),
            ticks: self.sums.ticks,
            late_ticks: self.sums.late_ticks,
            late_limit_ms: (self.sums.ticks > 0).then(|| ms(limit_ns(self.sums.interval_ns))),
            drops: stages.iter().map(|stage| stage.drops.total()).sum(),
            refusals: self.sums.losses.refusals(),
            links: self.sums.losses.links(),
            agents_left_out: self.sums.agents_left_out,
            hops_missing: self.sums.hops_missing,
            files_unwritten: self.sums.files_unwritten,
            unpublished_ticks: self.sums.unpublished_ticks,
            sessions: self.sums.sessions.report(),
            silences: self.sums.arrivals.report(self.ended_ns),
            input: self.sums.input.report(&self.options.input),
            agents: self.agents(),
            forecasts: self.forecast_counts(),
            out_of_distribution: self.sums.out_of_distribution,
            lanes: self.sums.lanes,
            priors: self.prior_counts(),
            end_to_end_ms: self.sums.end_to_end.percentiles_ms(),
            overhead_ms: self.sums.overhead.percentiles_ms(),
            since_stamp_ms: self.sums.since_stamp.percentiles_ms(),
            stages,
            accuracy: self.scorer.accuracy(),
            worst_ticks: self.sums.worst.list(&self.usual()),
            supervision: Supervision::default(),
        };
        self.sums.sessions.name_steps(&mut report.input);
        report.verdict = verdict(&report);
        report
    }

    fn run(&self) -> RunInfo {
        let mut run = self.options.run.clone();
        if let Some(span) = self.sums.span {
            let [first, last] = span.stamp_ns;
            run.played_s.get_or_insert(ms(last.abs_diff(first)) / 1e3);
            let [first, last] = span.released_ns;
            run.elapsed_s.get_or_insert(ms(last.abs_diff(first)) / 1e3);
            run.lockstep.get_or_insert(self.sums.lockstep);
            if self.sums.interval_ns > 0 {
                run.interval_ms.get_or_insert(ms(self.sums.interval_ns));
            }
        }
        run
    }

    /// The requested tick, with the phase that took longest; `None` if the tick has not arrived.
    #[must_use]
    pub fn explained(&self) -> Option<WorstTick> {
        self.sums.worst.explained(&self.usual())
    }

    /// Errors of the forecasts so far.
    #[must_use]
    pub fn accuracy(&self) -> Accuracy {
        self.scorer.accuracy()
    }

    /// The latency from release to forecasts, and the same without the computation of all stages.
    pub(crate) const fn latencies(&self) -> [&Distribution; 2] {
        [&self.sums.end_to_end, &self.sums.overhead]
    }

    /// A stage's times in the order of [`Phases::NAMES`]; `None` if no tick has passed the stage.
    pub(crate) fn phases(&self, stage: StageId) -> Option<&[Distribution; 4]> {
        Some(&self.sums.stages.get(&stage.number())?.phases)
    }

    /// The usual figures of this run.
    fn usual(&self) -> Usual {
        let mut usual = Usual { agents: self.agents().mean.unwrap_or(0.0), ..Usual::default() };
        for stage in StageId::known() {
            if let Some(times) = self.phases(stage) {
                usual.phases_ns[stage.place()] = times.each_ref().map(Distribution::median_ns);
            }
        }
        usual
    }

    fn agents(&self) -> Agents {
        if self.sums.ticks == 0 {
            return Agents::default();
        }
        let total: u64 = self.sums.forecasts_by_quality.iter().sum();
        let mean = (total as f64 / self.sums.ticks as f64 * 1e2).round() / 1e2;
        Agents { mean: Some(mean), max: Some(self.sums.agents_max) }
    }

    fn forecast_counts(&self) -> ForecastCounts {
        let [learned, held, kinematic] = self.sums.forecasts_by_quality;
        let total = learned + held + kinematic;
        let by_cause = |cause: Cause| self.sums.fallbacks_by_cause[cause as usize];
        let constant_velocity = by_cause(Cause::Outdone) as f64 / total as f64;
        let causes = Cause::ALL
            .iter()
            .zip(self.sums.fallbacks_by_cause)
            .filter(|&(&cause, count)| cause != Cause::None || count > 0)
            .map(|(cause, count)| (cause.name().to_owned(), count))
            .collect();
        let age_ms_max = self.sums.age_ns_max.map(ms);
        let Sums { degraded_ticks, predicted_ticks, silent, .. } = self.sums;
        ForecastCounts {
            learned,
            held,
            kinematic,
            causes,
            not_learned: Cause::ALL.into_iter().filter(|cause| is_fault(*cause)).map(by_cause).sum(),
            constant_velocity_share: (total > 0).then(|| (constant_velocity * 1e4).round() / 1e4),
            degraded_ticks,
            predicted_ticks,
            silent,
            age_ms_max,
            shed: self.sums.shed.report(total),
        }
    }

    fn prior_counts(&self) -> PriorCounts {
        let [learned, held, kinematic] = self.sums.states_by_prior;
        PriorCounts { learned, held, kinematic }
    }
}

/// Adds counts.
fn add<const N: usize>(sums: &mut [u64; N], counts: &[u64; N]) {
    sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
}

#[cfg(test)]
pub(crate) mod tests;
