//! The figures of the last ten seconds.

use wire::{Heartbeat, StageId};

use super::Recorder;
use crate::passage::Phases;
use crate::report::Percentiles;
use crate::tick::Tick;

impl Recorder {
    /// Number of ticks whose forecasts were received.
    #[must_use]
    pub const fn ticks(&self) -> u64 {
        self.sums.ticks
    }

    /// The ticks of the window, oldest first.
    pub(crate) fn recent(&self) -> impl DoubleEndedIterator<Item = &Tick> + ExactSizeIterator {
        self.recent.ticks.iter()
    }

    /// A stage's newest heartbeat.
    pub(crate) const fn beat(&self, stage: StageId) -> Option<&Heartbeat> {
        self.recent.beats[stage.place()].as_ref()
    }

    /// The stages that have a budget, sent a heartbeat or passed the last tick, in the order of the chain.
    pub(crate) fn live_stages(&self) -> impl Iterator<Item = StageId> {
        self.options.stages.iter().copied().filter(|stage| {
            self.options.budgets_ms.contains_key(stage)
                || self.beat(*stage).is_some()
                || self.recent().next_back().is_some_and(|tick| tick.passage.phases(*stage).is_some())
        })
    }

    /// A stage's share of the tick limit.
    pub(crate) fn budget_ms(&self, stage: StageId) -> Option<f64> {
        self.options.budgets_ms.get(&stage).copied()
    }

    /// Time since the release of the first tick, in s.
    pub(crate) fn elapsed_s(&self, now_ns: u64) -> f64 {
        self.sums.span.map_or(0.0, |span| now_ns.saturating_sub(span.released_ns[0]) as f64 / 1e9)
    }

    /// End-to-end latency of the newest ticks.
    pub(crate) fn recent_end_to_end_ms(&self) -> Percentiles {
        percentiles(self.recent().filter_map(|tick| tick.passage.end_to_end_ns))
    }

    /// A stage's times in the newest ticks, in the order of [`Phases::NAMES`].
    pub(crate) fn recent_ms(&self, stage: StageId) -> [Percentiles; 4] {
        let phases: Vec<Phases> = self.recent().filter_map(|tick| tick.passage.phases(stage)).collect();
        [0, 1, 2, 3].map(|phase| percentiles(phases.iter().map(|phases| phases.each_ns()[phase])))
    }
}

/// Median, 99th percentile and maximum of a few values, in ms to a microsecond.
fn percentiles(times_ns: impl Iterator<Item = u64>) -> Percentiles {
    let mut sorted_ns: Vec<u64> = times_ns.collect();
    sorted_ns.sort_unstable();
    let rounded = |time_ns: &u64| (*time_ns as f64 / 1e6 * 1e3).round() / 1e3;
    let [p50, p99, max] = [0.5, 0.99, 1.0].map(|quantile| {
        let rank = (quantile * sorted_ns.len() as f64).ceil() as usize;
        sorted_ns.get(rank.saturating_sub(1)).map(rounded)
    });
    Percentiles { p50, p99, p999: None, max }
}
