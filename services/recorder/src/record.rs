mod checkpoint;
mod shed;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wire::{Cause, Forecast, Header, Heartbeat, Quality, Rejected, StageId, Truth, flags};

use crate::accuracy::Scorer;
use crate::distribution::{Distribution, ms};
use crate::input::{InputReport, InputTally};
use crate::lanes::LaneCounts;
use crate::losses::Losses;
use crate::passage::{Passage, Phases, Timeline};
use crate::report::{
    Accuracy, Agents, ForecastCounts, OutOfDistribution, Percentiles, PriorCounts, REPORT_VERSION, Report,
    RunInfo, StageDrops, StageReport, Supervision, Verdict, WorstTick, restarts,
};
use crate::worst::{Usual, Worst};

pub use checkpoint::Checkpoint;
use shed::ShedCounts;
pub(crate) use shed::is_shed;

/// The time that a tick may take from release to forecast at 12.5 Hz.
pub const TICK_LIMIT_NS: u64 = wire::TICK_NS;

/// The recorder's information about the run in addition to its topics.
#[derive(Clone, Debug)]
pub struct RecorderOptions {
    /// Copied to the report. Interval, durations and lockstep are measured if they are `None`.
    pub run: RunInfo,
    /// The stages, in the order in which a tick passes them.
    pub stages: Vec<StageId>,
    /// Each stage's share of the tick limit.
    pub budgets_ms: BTreeMap<StageId, f64>,
    /// Limit above which a tick is late: this or the frame interval, whichever is smaller.
    pub tick_limit_ns: u64,
    /// Whether forecasts are kept and scored when truth arrives. Otherwise only times and counts are
    /// recorded, and the forecasts' numbers are not checked.
    pub scores: bool,
    /// Information about the recording's input.
    pub input: InputReport,
    /// A tick whose cause [`Recorder::explained`] returns.
    pub explain: Option<u64>,
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self {
            run: RunInfo::default(),
            stages: StageId::ALL.to_vec(),
            budgets_ms: BTreeMap::new(),
            tick_limit_ns: TICK_LIMIT_NS,
            scores: true,
            input: InputReport::default(),
            explain: None,
        }
    }
}

/// Durations of one stage's phases.
#[derive(Clone, Debug, Default)]
struct StageTimes {
    waiting: Distribution,
    wake_up: Distribution,
    compute: Distribution,
    publish: Distribution,
    late_ticks: u64,
}

impl StageTimes {
    fn record(&mut self, phases: &Phases, budget_ms: Option<f64>) {
        self.waiting.record(phases.waiting_ns);
        self.wake_up.record(phases.wake_up_ns);
        self.compute.record(phases.compute_ns);
        self.publish.record(phases.publish_ns);
        let late = budget_ms.is_some_and(|budget_ms| phases.compute_ns as f64 > budget_ms * 1e6);
        self.late_ticks += u64::from(late);
    }
}

/// First and last value of increasing clocks.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Span {
    stamp_ns: [i64; 2],
    released_ns: [u64; 2],
}

/// Measures a run and reports the results.
#[derive(Clone, Debug)]
pub struct Recorder {
    options: RecorderOptions,
    timeline: Timeline,
    end_to_end: Distribution,
    overhead: Distribution,
    stages: BTreeMap<StageId, StageTimes>,
    losses: Losses,
    scorer: Scorer,
    span: Option<Span>,
    /// Number of the next tick, if it is known.
    next_seq: Option<u64>,
    interval_ns: u64,
    lockstep: bool,
    ticks: u64,
    late_ticks: u64,
    agents_left_out: u64,
    hops_missing: u64,
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
    /// Whether the recorder continues from a previous recorder's checkpoint and has not received a tick yet.
    resumed: bool,
}

/// Measure from which the network adds less than half of its normal residual.
const OUTSIDE: f32 = 0.25;

/// Whether the forecast's agent is out of distribution.
pub(crate) fn is_outside(forecast: &Forecast) -> bool {
    forecast.out_of_distribution >= OUTSIDE
}

impl OutOfDistribution {
    fn add(&mut self, forecast: &Forecast) {
        let rounded = |value: f32| (f64::from(value) * 1e2).round() / 1e2;
        let raise =
            |most: &mut Option<f64>, value: f64| *most = Some(most.map_or(value, |most| most.max(value)));
        if is_outside(forecast) {
            self.forecasts += 1;
            raise(&mut self.measure_max, rounded(forecast.out_of_distribution));
            raise(&mut self.speed_mps_max, rounded(forecast.vx_mps.hypot(forecast.vy_mps)));
        }
    }
}

impl Recorder {
    /// A recorder before the first frame.
    #[must_use]
    pub fn new(options: RecorderOptions) -> Self {
        Self {
            options,
            timeline: Timeline::default(),
            end_to_end: Distribution::default(),
            overhead: Distribution::default(),
            stages: BTreeMap::new(),
            losses: Losses::default(),
            scorer: Scorer::default(),
            span: None,
            next_seq: None,
            interval_ns: 0,
            lockstep: false,
            ticks: 0,
            late_ticks: 0,
            agents_left_out: 0,
            hops_missing: 0,
            input: InputTally::default(),
            agents_max: 0,
            forecasts_by_quality: [0; Quality::ALL.len()],
            fallbacks_by_cause: [0; Cause::ALL.len()],
            states_by_prior: [0; Quality::ALL.len()],
            degraded_ticks: 0,
            predicted_ticks: 0,
            silent: 0,
            age_ns_max: None,
            shed: ShedCounts::default(),
            out_of_distribution: OutOfDistribution::default(),
            lanes: LaneCounts::default(),
            worst: Worst::default(),
            resumed: false,
        }
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
    /// the tracker. It is not lost, and is not counted in any other way.
    ///
    /// # Errors
    /// [`Rejected`] if the frame is invalid or has forecasts that are not newer than the last. The frame is
    /// counted as refused.
    pub fn forecasts(&mut self, header: &Header, forecasts: &[Forecast]) -> Result<(), Rejected> {
        if header.has(flags::WARM_UP) {
            self.next_seq.get_or_insert(0);
            return Ok(());
        }
        if let Err(rejected) = self.check(header, forecasts) {
            self.losses.forecast_refused();
            return Err(rejected);
        }
        let mut gap = self.next_seq.map_or(0, |expected| header.seq.saturating_sub(expected));
        if std::mem::take(&mut self.resumed) {
            self.losses.forecast_gap(header, 0);
            self.losses.unrecorded(gap);
            gap = 0;
        } else {
            self.losses.forecast_gap(header, gap);
        }
        self.next_seq = Some(header.seq.saturating_add(1));
        if header.is_tick() && self.newer_ns(header).is_none() {
            let passage = self.latency(header);
            self.worst.take(header, forecasts, &passage, gap, self.options.explain);
            self.qualities(forecasts);
            if self.options.scores {
                self.scorer.forecasts(header, forecasts);
            }
        }
        Ok(())
    }

    /// Whether the previous recorder has recorded the tick. A topic keeps such ticks for new readers.
    #[must_use]
    pub fn is_recorded(&self, header: &Header) -> bool {
        self.resumed && self.newer_ns(header).is_some()
    }

    /// Adds the header of a frame from an added stage for which no forecast waits. An invalid header is
    /// ignored, because the frame's readers refuse it.
    pub fn beside(&mut self, header: &Header) {
        if header.check().is_err() || !header.is_tick() {
            return;
        }
        if let Some((stage, times)) = self.timeline.beside(header).filter(|(stage, _)| stage.is_added()) {
            let budget_ms = self.options.budgets_ms.get(&stage).copied();
            self.stages.entry(stage).or_default().record(&times.into(), budget_ms);
        }
    }

    /// Adds a stage's heartbeat.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        self.losses.heartbeat(heartbeat);
    }

    fn check(&self, header: &Header, forecasts: &[Forecast]) -> Result<(), Rejected> {
        header.check()?;
        let expected = header.counts.agents_len as usize;
        if forecasts.len() != expected {
            return Err(Rejected::Length { found: forecasts.len(), expected });
        }
        if let Some(last_ns) = self.newer_ns(header).filter(|_| !header.has(flags::VOID)) {
            return Err(Rejected::NotNewer { stamp_ns: header.stamp_ns, last_ns });
        }
        if self.options.scores { forecasts.iter().try_for_each(Forecast::check) } else { Ok(()) }
    }

    /// Stamp of the newest tick so far, if this tick is not newer.
    fn newer_ns(&self, header: &Header) -> Option<i64> {
        let last_ns = self.span?.stamp_ns[1];
        (header.is_tick() && header.stamp_ns <= last_ns).then_some(last_ns)
    }

    fn latency(&mut self, header: &Header) -> Passage {
        self.ticks += 1;
        self.interval_ns = header.interval_ns;
        self.lockstep |= header.has(flags::LOCKSTEP);
        let span = self
            .span
            .get_or_insert(Span { stamp_ns: [header.stamp_ns; 2], released_ns: [header.released_ns; 2] });
        span.stamp_ns[1] = header.stamp_ns;
        span.released_ns[1] = header.released_ns;

        let limit_ns = self.late_limit_ns();
        let passage = self.timeline.pass(header);
        if let Some(end_to_end_ns) = passage.end_to_end_ns {
            self.end_to_end.record(end_to_end_ns);
            self.late_ticks += u64::from(end_to_end_ns > limit_ns);
        }
        if let Some(overhead_ns) = passage.overhead_ns() {
            self.overhead.record(overhead_ns);
        }
        for &stage in &self.options.stages {
            if let Some(phases) = passage.phases(stage) {
                let budget_ms = self.options.budgets_ms.get(&stage).copied();
                self.stages.entry(stage).or_default().record(phases, budget_ms);
            }
        }
        self.agents_left_out += u64::from(header.left_out_len);
        self.hops_missing += u64::from(header.hops_missing_len);
        self.predicted_ticks += u64::from(header.has(flags::PREDICTED));
        self.silent += u64::from(header.silent_len);
        self.input.tick(header);
        passage
    }

    fn qualities(&mut self, forecasts: &[Forecast]) {
        self.agents_max = self.agents_max.max(forecasts.len() as u64);
        self.shed.add(forecasts);
        self.lanes.add(forecasts);
        let mut degraded = false;
        for forecast in forecasts {
            if let Some(count) = self.forecasts_by_quality.get_mut(forecast.quality as usize) {
                *count += 1;
            }
            self.out_of_distribution.add(forecast);
            if let Some(count) = self.states_by_prior.get_mut(forecast.prior as usize) {
                *count += 1;
            }
            if forecast.quality == Quality::Learned as u32 {
                continue;
            }
            if let Some(count) = self.fallbacks_by_cause.get_mut(forecast.cause as usize) {
                *count += 1;
            }
            degraded |= Cause::from_number(forecast.cause).is_none_or(is_fault);
            if forecast.quality == Quality::Held as u32 {
                self.age_ns_max = self.age_ns_max.max(Some(forecast.age_ns));
            }
        }
        self.degraded_ticks += u64::from(degraded);
    }

    fn late_limit_ns(&self) -> u64 {
        match self.interval_ns {
            0 => self.options.tick_limit_ns,
            interval_ns => interval_ns.min(self.options.tick_limit_ns),
        }
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
            ticks: self.ticks,
            late_ticks: self.late_ticks,
            late_limit_ms: (self.ticks > 0).then(|| ms(self.late_limit_ns())),
            drops: stages.iter().map(|stage| stage.drops.total()).sum(),
            refusals: self.losses.refusals(),
            agents_left_out: self.agents_left_out,
            hops_missing: self.hops_missing,
            input: self.input.report(&self.options.input),
            agents: self.agents(),
            forecasts: self.forecast_counts(),
            out_of_distribution: self.out_of_distribution,
            lanes: self.lanes,
            priors: self.prior_counts(),
            end_to_end_ms: self.end_to_end.percentiles_ms(),
            overhead_ms: self.overhead.percentiles_ms(),
            stages,
            accuracy: self.scorer.accuracy(),
            worst_ticks: self.worst.list(&self.usual()),
            supervision: Supervision::default(),
        };
        report.verdict = verdict(&report);
        report
    }

    fn run(&self) -> RunInfo {
        let mut run = self.options.run.clone();
        if let Some(span) = self.span {
            let [first, last] = span.stamp_ns;
            run.played_s.get_or_insert(ms(last.abs_diff(first)) / 1e3);
            let [first, last] = span.released_ns;
            run.elapsed_s.get_or_insert(ms(last.abs_diff(first)) / 1e3);
            run.lockstep.get_or_insert(self.lockstep);
            if self.interval_ns > 0 {
                run.interval_ms.get_or_insert(ms(self.interval_ns));
            }
        }
        run
    }

    /// The requested tick, with the phase that took longest; `None` if the tick has not arrived.
    #[must_use]
    pub fn explained(&self) -> Option<WorstTick> {
        self.worst.explained(&self.usual())
    }

    /// Errors of the forecasts so far.
    #[must_use]
    pub fn accuracy(&self) -> Accuracy {
        self.scorer.accuracy()
    }

    /// The latency from release to forecasts, and this latency minus the compute of all stages.
    pub(crate) const fn latencies(&self) -> [&Distribution; 2] {
        [&self.end_to_end, &self.overhead]
    }

    /// A stage's times of waiting, wake-up, compute and publish; `None` if no tick has passed the stage.
    pub(crate) fn phases(&self, stage: StageId) -> Option<[&Distribution; 4]> {
        let times = self.stages.get(&stage)?;
        Some([&times.waiting, &times.wake_up, &times.compute, &times.publish])
    }

    /// The usual values in this run.
    fn usual(&self) -> Usual {
        let median = |times: &StageTimes| {
            [&times.waiting, &times.wake_up, &times.compute, &times.publish].map(Distribution::median_ns)
        };
        let mut usual = Usual { agents: self.agents().mean.unwrap_or(0.0), ..Usual::default() };
        for (&stage, times) in &self.stages {
            usual.phases_ns[stage.place()] = median(times);
        }
        usual
    }

    fn agents(&self) -> Agents {
        if self.ticks == 0 {
            return Agents::default();
        }
        let total: u64 = self.forecasts_by_quality.iter().sum();
        let mean = (total as f64 / self.ticks as f64 * 1e2).round() / 1e2;
        Agents { mean: Some(mean), max: Some(self.agents_max) }
    }

    fn forecast_counts(&self) -> ForecastCounts {
        let [learned, held, kinematic] = self.forecasts_by_quality;
        let total = learned + held + kinematic;
        let by_cause = |cause: Cause| self.fallbacks_by_cause[cause as usize];
        let constant_velocity = by_cause(Cause::Outdone) as f64 / total as f64;
        let causes = Cause::ALL
            .iter()
            .zip(self.fallbacks_by_cause)
            .filter(|&(&cause, count)| cause != Cause::None || count > 0)
            .map(|(cause, count)| (cause.name().to_owned(), count))
            .collect();
        let age_ms_max = self.age_ns_max.map(ms);
        let Self { degraded_ticks, predicted_ticks, silent, .. } = *self;
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
            shed: self.shed.report(total),
        }
    }

    fn prior_counts(&self) -> PriorCounts {
        let [learned, held, kinematic] = self.states_by_prior;
        PriorCounts { learned, held, kinematic }
    }

    fn stage_reports(&self) -> Vec<StageReport> {
        let drops = self.losses.by_stage(&self.options.stages);
        self.options
            .stages
            .iter()
            .map(|&stage| self.stage_report(stage, drops[stage.place()]))
            .filter(|report| report.ticks > 0 || report.budget_ms.is_some() || report.drops.total() > 0)
            .collect()
    }

    fn stage_report(&self, stage: StageId, drops: StageDrops) -> StageReport {
        let times = self.stages.get(&stage);
        let percentiles = |of: fn(&StageTimes) -> &Distribution| {
            times.map_or_else(Percentiles::default, |times| of(times).percentiles_ms())
        };
        let compute_ms = percentiles(|times| &times.compute);
        let budget_ms = self.options.budgets_ms.get(&stage).copied();
        let share = |value_ms: Option<f64>| Some((value_ms? / budget_ms? * 1e4).round() / 1e4);
        StageReport {
            name: stage.name().to_owned(),
            budget_ms,
            budget_share_p50: share(compute_ms.p50),
            budget_share_p99: share(compute_ms.p99),
            waiting_ms: percentiles(|times| &times.waiting),
            wake_up_ms: percentiles(|times| &times.wake_up),
            compute_ms,
            publish_ms: percentiles(|times| &times.publish),
            ticks: times.map_or(0, |times| times.compute.len()),
            late_ticks: times.map_or(0, |times| times.late_ticks),
            drops,
            restarts: self.losses.restarts(stage),
            replacements: 0,
        }
    }
}

/// The verdict on a report. Every fact that a user of the forecasts should know is a reason.
fn verdict(report: &Report) -> Verdict {
    let mut reasons = Vec::new();
    let by_stage = |count: fn(&StageReport) -> u64| {
        let named = report.stages.iter().map(|stage| (stage.name.as_str(), count(stage)));
        list(named)
    };
    if report.drops > 0 {
        reasons.push(format!("frames lost: {} ({})", report.drops, by_stage(|stage| stage.drops.total())));
    }
    reasons.extend(restarts(&report.stages));
    // In lockstep the source waits for every tick, so there is no deadline.
    if let Some(limit_ms) = report.late_limit_ms
        && report.late_ticks > 0
        && report.run.lockstep != Some(true)
    {
        reasons.push(format!("late ticks: {} of {} (over {limit_ms} ms)", report.late_ticks, report.ticks));
    }
    let not_learned = report.forecasts.not_learned;
    if not_learned > 0 {
        let by_cause = |name| report.forecasts.causes.get(name).copied().unwrap_or(0);
        let faults = Cause::ALL.into_iter().filter(|cause| is_fault(*cause)).map(Cause::name);
        let faults = faults.map(|name| (name, by_cause(name)));
        let ticks = format!("in {} of {} ticks", report.forecasts.degraded_ticks, report.ticks);
        reasons.push(format!("forecasts not learned: {not_learned} {ticks} ({})", list(faults)));
    }
    if report.forecasts.predicted_ticks > 0 {
        let (ticks, all) = (report.forecasts.predicted_ticks, report.ticks);
        reasons.push(format!("detections missing: tracks predicted in {ticks} of {all} ticks"));
    }
    if report.forecasts.silent > 0 {
        reasons.push(format!("nothing said by policy: {} forecasts", report.forecasts.silent));
    }
    if report.hops_missing > 0 {
        let most = wire::HOPS_MAX;
        reasons
            .push(format!("passages without times: {} (a header has room for {most})", report.hops_missing));
    }
    if report.agents_left_out > 0 {
        reasons.push(format!("agents left out of full frames: {}", report.agents_left_out));
    }
    let has_agents = report.agents.max.is_some_and(|most| most > 0) || report.forecasts.silent > 0;
    if !has_agents && report.ticks > 0 {
        reasons.push(nothing_tracked(report));
    }
    reasons.extend(report.doubts());
    Verdict::new(!has_agents, reasons)
}

/// Whether a held or kinematic forecast with this cause is a fault. It is not a fault if the track is young
/// or if constant velocity proved better. "Not learned" counts faults in the verdict, the report and the
/// worst ticks.
pub(crate) const fn is_fault(cause: Cause) -> bool {
    !matches!(cause, Cause::Young | Cause::Outdone)
}

/// Why a run with ticks is empty.
fn nothing_tracked(report: &Report) -> String {
    let (ticks, detections) = (report.ticks, report.input.detections);
    match detections {
        0 => format!("no agent was tracked in any of {ticks} ticks"),
        _ => format!("no agent was tracked in any of {ticks} ticks, of {detections} detections"),
    }
}

/// `name count` of all counts other than 0.
fn list<'a>(counts: impl Iterator<Item = (&'a str, u64)>) -> String {
    counts.filter(|&(_, n)| n > 0).map(|(name, n)| format!("{name} {n}")).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
pub(crate) mod tests;
