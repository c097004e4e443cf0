//! The state of a running pipeline, for a table of stages or one line per second.
//!
//! [`LiveView`] keeps the last ten seconds and some counts. [`lines`] shows it on a terminal, and
//! [`LiveView::plain_line`] elsewhere. The caller reads the topics and the clock.

mod draw;

use std::collections::{BTreeMap, VecDeque};

use wire::{Cause, Forecast, Header, Heartbeat, Quality, StageId, flags};

pub use draw::lines;

use crate::losses::Losses;
use crate::passage::{Passage, Phases, Timeline};
use crate::record::{TICK_LIMIT_NS, is_outside, is_shed};
use crate::report::{Errors, Percentiles, RefusedFrames, ReplacementOutcome};
use crate::text::{count, number};

/// Number of ticks in the window of the view: ten seconds at 12.5 Hz.
const WINDOW_LEN: usize = 125;
/// Age of the last heartbeat from which a stage counts as silent: slightly more than two heartbeat intervals.
const SILENT_NS: u64 = 200_000_000;

/// The data that the view shows in addition to the topics of a run.
#[derive(Clone, Debug)]
pub struct LiveOptions {
    /// The title: the recording or scene.
    pub title: String,
    /// The stages, in the order in which a tick passes them.
    pub stages: Vec<StageId>,
    /// Each stage's share of the tick limit. These stages have a row from the start.
    pub budgets_ms: BTreeMap<StageId, f64>,
    /// Limit above which a tick is late: this or the frame interval, whichever is smaller.
    pub tick_limit_ns: u64,
    /// Number of ticks after which the run ends, if it is known.
    pub ticks_limit: Option<u64>,
}

impl Default for LiveOptions {
    fn default() -> Self {
        Self {
            title: String::new(),
            stages: StageId::ALL.to_vec(),
            budgets_ms: BTreeMap::new(),
            tick_limit_ns: TICK_LIMIT_NS,
            ticks_limit: None,
        }
    }
}

/// The row of a stage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiveStage {
    /// Median of compute within the window.
    pub compute_ms_p50: Option<f64>,
    /// 99th percentile of compute within the window.
    pub compute_ms_p99: Option<f64>,
    /// The stage's share of the tick limit.
    pub budget_ms: Option<f64>,
    /// Number of frames that the stage finished.
    pub frames: u64,
    /// Number of ticks whose compute exceeded the budget.
    pub late: u64,
    /// Number of frames lost in the stage.
    pub lost: u64,
    /// The most frequent refusal: sender and cause.
    pub refused: Option<RefusedFrames>,
    /// Number of restarts.
    pub restarts: u32,
    /// Number of replacements.
    pub replaced: u32,
    /// State of the spare, and the number of times that a spare took over; `None` if there is no spare.
    pub spare: Option<(&'static str, u32)>,
    /// Whether the stage's last heartbeat is recent; `None` before the first.
    pub alive: Option<bool>,
}

/// The last seconds of a run.
#[derive(Clone, Debug)]
pub struct LiveView {
    options: LiveOptions,
    timeline: Timeline,
    losses: Losses,
    window: VecDeque<Passage>,
    beats: [Option<Heartbeat>; StageId::PLACES_LEN],
    late_by_stage: [u64; StageId::PLACES_LEN],
    /// Number of replacements of each stage, and number of incarnations that were not restarts.
    replaced: [(u32, u32); StageId::PLACES_LEN],
    spares: [Option<(&'static str, u32)>; StageId::PLACES_LEN],
    first_released_ns: Option<u64>,
    now_ns: u64,
    limit_ns: u64,
    /// Number of the next tick, if it is known.
    next_seq: Option<u64>,
    ticks: u64,
    late_ticks: u64,
    /// Forecasts of the newest tick by quality.
    newest: [u64; Quality::ALL.len()],
    /// Number of forecasts of the newest tick whose agents are out of distribution.
    newest_outside: u64,
    /// Number of agents that the newest tick left out to save time. `total_shed` counts all ticks.
    newest_shed: u64,
    total_shed: u64,
    /// Forecasts of the newest tick that are held or kinematic, by cause.
    newest_causes: [u64; Cause::ALL.len()],
    /// Forecasts of all ticks by quality.
    total: [u64; Quality::ALL.len()],
    /// Number of forecasts that are constant velocity because it proved better.
    total_outdone: u64,
    /// Errors of the forecasts whose horizon has passed, as last reported by the recorder.
    errors: Option<Errors>,
}

impl LiveView {
    /// A view of a run that has not begun.
    #[must_use]
    pub fn new(options: LiveOptions) -> Self {
        Self {
            limit_ns: options.tick_limit_ns,
            options,
            timeline: Timeline::default(),
            losses: Losses::default(),
            window: VecDeque::with_capacity(WINDOW_LEN),
            beats: [None; StageId::PLACES_LEN],
            late_by_stage: [0; StageId::PLACES_LEN],
            replaced: [(0, 0); StageId::PLACES_LEN],
            spares: [None; StageId::PLACES_LEN],
            first_released_ns: None,
            now_ns: 0,
            next_seq: None,
            ticks: 0,
            late_ticks: 0,
            newest: [0; Quality::ALL.len()],
            newest_outside: 0,
            newest_shed: 0,
            total_shed: 0,
            newest_causes: [0; Cause::ALL.len()],
            total: [0; Quality::ALL.len()],
            total_outdone: 0,
            errors: None,
        }
    }

    /// Sets the errors of the forecasts whose horizon has passed, as last reported by the recorder.
    pub fn errors(&mut self, errors: Option<Errors>) {
        self.errors = errors;
    }

    /// Adds the forecasts of a tick. Losses are counted as in [`crate::Recorder::forecasts`].
    pub fn forecasts(&mut self, header: &Header, forecasts: &[Forecast]) {
        if header.has(flags::WARM_UP) {
            self.next_seq.get_or_insert(0);
        }
        if !header.is_tick() {
            return;
        }
        let gap = self.next_seq.map_or(0, |expected| header.seq.saturating_sub(expected));
        self.losses.forecast_gap(header, gap);
        self.next_seq = Some(header.seq.saturating_add(1));
        self.ticks += 1;
        self.first_released_ns.get_or_insert(header.released_ns);
        if header.interval_ns > 0 {
            self.limit_ns = header.interval_ns.min(self.options.tick_limit_ns);
        }
        let passage = self.timeline.pass(header);
        self.late_ticks += u64::from(passage.end_to_end_ns.is_some_and(|t| t > self.limit_ns));
        for (&stage, &budget_ms) in &self.options.budgets_ms {
            let late = passage.phases(stage).is_some_and(|p| p.compute_ns as f64 > budget_ms * 1e6);
            self.late_by_stage[stage.place()] += u64::from(late);
        }
        if self.window.len() == WINDOW_LEN {
            self.window.pop_front();
        }
        self.window.push_back(passage);
        self.newest = [0; Quality::ALL.len()];
        self.newest_causes = [0; Cause::ALL.len()];
        self.newest_outside = forecasts.iter().filter(|forecast| is_outside(forecast)).count() as u64;
        self.newest_shed = forecasts.iter().filter(|forecast| is_shed(forecast)).count() as u64;
        self.total_shed += self.newest_shed;
        for forecast in forecasts {
            let quality = forecast.quality as usize;
            if quality < Quality::ALL.len() {
                self.newest[quality] += 1;
                self.total[quality] += 1;
            }
            if let Some(count) = self.newest_causes.get_mut(forecast.cause as usize) {
                *count += u64::from(forecast.quality != Quality::Learned as u32);
            }
        }
        self.total_outdone += self.newest_causes[Cause::Outdone as usize];
    }

    /// Adds the header of a frame from an added stage for which no forecast waits.
    pub fn beside(&mut self, header: &Header) {
        if header.check().is_err() || !header.is_tick() {
            return;
        }
        let Some((stage, times)) = self.timeline.beside(header).filter(|(stage, _)| stage.is_added()) else {
            return;
        };
        let phases = Phases::from(times);
        let budget_ms = self.options.budgets_ms.get(&stage);
        let late = budget_ms.is_some_and(|budget_ms| phases.compute_ns as f64 > budget_ms * 1e6);
        self.late_by_stage[stage.place()] += u64::from(late);
        if let Some(tick) = self.window.back_mut() {
            tick.add(stage, phases);
        }
    }

    /// Adds a stage's heartbeat.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        self.losses.heartbeat(heartbeat);
        if let Some(stage) = StageId::from_number(heartbeat.stage) {
            self.beats[stage.place()] = Some(*heartbeat);
        }
    }

    /// Adds the outcome of a stage's replacement.
    pub fn replaced(&mut self, stage: StageId, outcome: ReplacementOutcome) {
        let (times, incarnations) = &mut self.replaced[stage.place()];
        *times += u32::from(outcome == ReplacementOutcome::Replaced);
        *incarnations += outcome.incarnations();
    }

    /// Sets the states of the spares: each with its stage, a word, and the number of times that it took over.
    pub fn spares(&mut self, spares: impl Iterator<Item = (StageId, &'static str, u32)>) {
        spares.for_each(|(stage, state, promotions)| self.spares[stage.place()] = Some((state, promotions)));
    }

    /// Sets the time (`CLOCK_MONOTONIC`), which determines the run's duration and the silent stages.
    pub const fn clock(&mut self, now_ns: u64) {
        self.now_ns = now_ns;
    }

    /// Number of ticks whose forecasts were received.
    #[must_use]
    pub const fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Time since the release of the first tick, in s.
    #[must_use]
    pub fn elapsed_s(&self) -> f64 {
        self.first_released_ns.map_or(0.0, |first| self.now_ns.saturating_sub(first) as f64 / 1e9)
    }

    /// The stages that have a budget, sent a heartbeat or processed the last tick, in the order of the chain.
    #[must_use]
    pub fn stages(&self) -> Vec<(StageId, LiveStage)> {
        let drops = self.losses.by_stage(&self.options.stages);
        let refusals = self.losses.refusals();
        self.options
            .stages
            .iter()
            .copied()
            .filter(|stage| {
                self.options.budgets_ms.contains_key(stage)
                    || self.beats[stage.place()].is_some()
                    || self.window.back().is_some_and(|tick| tick.phases(*stage).is_some())
            })
            .map(|stage| {
                let beat = self.beats[stage.place()];
                let [p50, p99] = percentiles(
                    self.window.iter().filter_map(|tick| tick.phases(stage)).map(|phases| phases.compute_ns),
                );
                let row = LiveStage {
                    compute_ms_p50: p50,
                    compute_ms_p99: p99,
                    budget_ms: self.options.budgets_ms.get(&stage).copied(),
                    frames: beat.map_or(0, |beat| beat.frames_len),
                    late: self.late_by_stage[stage.place()],
                    lost: drops[stage.place()].total(),
                    refused: refusals.iter().find(|refused| refused.reader == stage.name()).cloned(),
                    restarts: self.losses.restarts(stage).saturating_sub(self.replaced[stage.place()].1),
                    replaced: self.replaced[stage.place()].0,
                    spare: self.spares[stage.place()],
                    alive: beat.map(|beat| self.now_ns.saturating_sub(beat.sent_ns) <= SILENT_NS),
                };
                (stage, row)
            })
            .collect()
    }

    /// The recording or scene.
    #[must_use]
    pub fn title(&self) -> &str {
        &self.options.title
    }

    /// Number of ticks after which the run ends, if it is known.
    #[must_use]
    pub const fn ticks_limit(&self) -> Option<u64> {
        self.options.ticks_limit
    }

    /// Number of the newest tick with forecasts.
    #[must_use]
    pub fn newest_tick(&self) -> Option<u64> {
        self.next_seq.filter(|_| self.ticks > 0)?.checked_sub(1)
    }

    /// A stage's newest heartbeat.
    #[must_use]
    pub const fn beat(&self, stage: StageId) -> Option<&Heartbeat> {
        self.beats[stage.place()].as_ref()
    }

    /// Numbers of forecasts of the newest tick by quality.
    #[must_use]
    pub const fn newest_qualities(&self) -> &[u64] {
        &self.newest
    }

    /// Numbers of forecasts of the newest tick that are held or kinematic, by cause.
    #[must_use]
    pub const fn newest_causes(&self) -> &[u64] {
        &self.newest_causes
    }

    /// Number of forecasts of the newest tick whose agents are out of distribution.
    #[must_use]
    pub const fn newest_outside(&self) -> u64 {
        self.newest_outside
    }

    /// Number of ticks in the window of the last ten seconds.
    #[must_use]
    pub fn recent_ticks(&self) -> u64 {
        self.window.len() as u64
    }

    /// End-to-end latency within the window.
    #[must_use]
    pub fn recent_end_to_end_ms(&self) -> Percentiles {
        recent(self.window.iter().filter_map(|tick| tick.end_to_end_ns))
    }

    /// A stage's times of waiting, wake-up, compute and publish within the window.
    #[must_use]
    pub fn recent_ms(&self, stage: StageId) -> [Percentiles; 4] {
        [0, 1, 2, 3].map(|phase| {
            let phases = self.window.iter().filter_map(|tick| tick.phases(stage));
            recent(phases.map(|phases| phases.each_ns()[phase]))
        })
    }

    /// One line for outputs other than terminals: ticks, latency of the last ten seconds, late ticks and
    /// losses.
    #[must_use]
    pub fn plain_line(&self) -> String {
        let of = self.options.ticks_limit.map_or_else(String::new, |limit| format!("/{limit}"));
        let [p50, p99] = self.end_to_end_ms();
        let [learned, held, kinematic] = self.newest;
        let lost: u64 = self.losses.by_stage(&self.options.stages).iter().map(|drops| drops.total()).sum();
        let shed = match self.total_shed {
            0 => String::new(),
            total => format!(", shed {} ({} so far)", self.newest_shed, count(total)),
        };
        format!(
            "tick {}{of}  {:.1} s  end to end p50 {} ms, p99 {} ms  forecasts {learned} learned, {held} held, \
             {kinematic} kinematic{shed}  late {}, lost {lost}",
            self.ticks,
            self.elapsed_s(),
            number(p50),
            number(p99),
            count(self.late_ticks),
        )
    }

    /// Median and 99th percentile of the latency in the window.
    fn end_to_end_ms(&self) -> [Option<f64>; 2] {
        percentiles(self.window.iter().filter_map(|tick| tick.end_to_end_ns))
    }
}

/// Median, 99th percentile and maximum of a few values, in ms to a microsecond.
fn recent(times_ns: impl Iterator<Item = u64>) -> Percentiles {
    let (mut most_ns, mut any) = (0, false);
    let [p50, p99] = percentiles(times_ns.inspect(|&time_ns| {
        most_ns = most_ns.max(time_ns);
        any = true;
    }));
    let rounded = |value: f64| (value * 1e3).round() / 1e3;
    let max = any.then(|| rounded(most_ns as f64 / 1e6));
    Percentiles { p50: p50.map(rounded), p99: p99.map(rounded), p999: None, max }
}

/// Median and 99th percentile of a few values, in ms.
fn percentiles(times_ns: impl Iterator<Item = u64>) -> [Option<f64>; 2] {
    let mut sorted: Vec<u64> = times_ns.collect();
    sorted.sort_unstable();
    [0.5, 0.99].map(|quantile| {
        let rank = (quantile * sorted.len() as f64).ceil() as usize;
        sorted.get(rank.saturating_sub(1)).map(|&t| t as f64 / 1e6)
    })
}

#[cfg(test)]
mod tests;
