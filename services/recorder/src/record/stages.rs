//! Times of the stages.

use serde::{Deserialize, Serialize};
use wire::StageId;

use super::Recorder;
use crate::distribution::Distribution;
use crate::passage::Phases;
use crate::report::{Percentiles, StageDrops, StageReport};

/// Durations of one stage's phases.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct StageTimes {
    /// In the order of [`Phases::NAMES`].
    pub(super) phases: [Distribution; 4],
    late_ticks: u64,
}

impl StageTimes {
    pub(super) fn record(&mut self, phases: &Phases, budget_ms: Option<f64>) {
        self.phases.iter_mut().zip(phases.each_ns()).for_each(|(times, time_ns)| times.record(time_ns));
        let late = budget_ms.is_some_and(|budget_ms| phases.compute_ns as f64 > budget_ms * 1e6);
        self.late_ticks += u64::from(late);
    }
}

impl Recorder {
    pub(super) fn stage_reports(&self) -> Vec<StageReport> {
        let drops = self.sums.losses.by_stage(&self.options.stages);
        self.options
            .stages
            .iter()
            .map(|&stage| self.stage_report(stage, drops[stage.place()]))
            .filter(|report| report.is_measured() || !report.program.is_empty())
            .collect()
    }

    fn stage_report(&self, stage: StageId, drops: StageDrops) -> StageReport {
        let times = self.sums.stages.get(&stage.number());
        let [waiting_ms, wake_up_ms, compute_ms, publish_ms] = match times {
            Some(times) => times.phases.each_ref().map(Distribution::percentiles_ms),
            None => [Percentiles::default(); 4],
        };
        let budget_ms = self.options.budgets_ms.get(&stage).copied();
        let share = |value_ms: Option<f64>| Some((value_ms? / budget_ms? * 1e4).round() / 1e4);
        let [reads, writes] = self.options.topics.get(&stage).cloned().unwrap_or_default();
        StageReport {
            name: stage.name().to_owned(),
            program: self.options.programs.get(&stage).cloned().unwrap_or_default(),
            reads,
            writes,
            budget_ms,
            budget_share_p50: share(compute_ms.p50),
            budget_share_p99: share(compute_ms.p99),
            waiting_ms,
            wake_up_ms,
            compute_ms,
            publish_ms,
            ticks: times.map_or(0, |times| times.phases[2].len()),
            late_ticks: times.map_or(0, |times| times.late_ticks),
            drops,
            restarts: self.sums.losses.restarts(stage),
            replacements: 0,
            since_stamp_ms: self.sums.losses.since_stamp_ms(stage),
        }
    }
}
