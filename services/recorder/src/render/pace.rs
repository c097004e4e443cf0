//! How much a machine was too slow, and advice.

use wire::{Cause, StageId};

use crate::passage::Phases;
use crate::report::{Report, StageReport, WorstTick};

/// Share of the limit that the median tick may take so that the slowest percent of ticks keeps the limit.
/// Measured runs have a 99th percentile of 1.4 times the median.
const COMFORTABLE: f64 = 0.7;

/// Place of the wake-up among the phases of a stage.
const WAKE_UP: usize = 1;

impl Report {
    /// Two lines: how late the run was, and advice. Returns `None` if no forecast was late or shed, or if a
    /// stage had died.
    pub(super) fn too_slow(&self) -> Option<[String; 2]> {
        let late = self.forecasts.causes.get(Cause::Late.name()).copied().unwrap_or(0);
        let is_real_time = self.run.lockstep != Some(true);
        let died = !self.supervision.outages.is_empty() || self.stages.iter().any(|stage| stage.restarts > 0);
        let shed = self.forecasts.shed.share.unwrap_or(0.0);
        if !is_real_time || (self.late_ticks == 0 && late == 0 && shed == 0.0) || died {
            return None;
        }
        let (limit_ms, agents) = self.late_limit_ms.zip(self.agents.mean)?;
        let on_the_way = self.stages.iter().filter(|stage| stage.name != StageId::Recorder.name());
        let compute_ms: f64 = on_the_way.filter_map(|stage| stage.compute_ms.p50).sum();
        if compute_ms <= 0.0 {
            return None;
        }
        let took = format!("{agents:.0} agents take {compute_ms:.0} of {limit_ms:.0} ms");
        let over_ms = compute_ms - COMFORTABLE * limit_ms;
        if over_ms <= 0.0 {
            return Some(self.disturbed(&took));
        }
        let fit = |agents: f64| {
            let agents = agents.floor().max(1.0);
            format!("about {agents:.0} would fit, more on more cores: stgdat bench")
        };
        Some(if shed > 0.0 {
            [
                format!("too slow for {agents:.0} agents: {:.1} % of the forecasts were shed", 100.0 * shed),
                format!("{} --agents {agents:.0}", fit(agents * (1.0 - shed))),
            ]
        } else {
            [
                format!("too slow by {over_ms:.0} ms: {took} at the median"),
                format!("{} --agents {agents:.0}", fit(agents * COMFORTABLE * limit_ms / compute_ms)),
            ]
        })
    }

    /// The same for a machine that is fast enough: late ticks are caused by other programs. A stage that
    /// wakes up late had its input but no processor.
    fn disturbed(&self, took: &str) -> [String; 2] {
        let is_late = |tick: &&WorstTick| {
            tick.not_learned > 0
                || tick.end_to_end_ms.zip(self.late_limit_ms).is_some_and(|(ms, limit)| ms > limit)
        };
        let late: Vec<&WorstTick> = self.worst_ticks.iter().filter(is_late).collect();
        let woke = |tick: &&&WorstTick| tick.phase.as_deref() == Some(Phases::NAMES[WAKE_UP]);
        let woke_late = late.iter().filter(woke).count();
        let most = |stage: &&StageReport| stage.wake_up_ms.max.unwrap_or(0.0);
        let latest = self.stages.iter().max_by(|a, b| most(a).total_cmp(&most(b)));
        match latest.filter(|_| woke_late > 0 && 2 * woke_late >= late.len()) {
            Some(stage) => [
                format!(
                    "the {} woke up to {:.0} ms late: it had no processor; {took}",
                    stage.name,
                    most(&stage)
                ),
                "give the stages a priority or processors of their own: docs/real-time.md".to_owned(),
            ],
            None => [
                format!("slow at times when something else ran: {took}"),
                "stgdat doctor shows what fits; docs/real-time.md shows how to free processors".to_owned(),
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::report::{Outage, Percentiles, StageReport};

    use super::*;

    fn late(compute_ms: f64) -> Report {
        let compute_ms = Percentiles { p50: Some(compute_ms), ..Percentiles::default() };
        let decoder = StageReport { name: "decoder".into(), compute_ms, ..StageReport::default() };
        let recorder = StageReport { name: "recorder".into(), compute_ms, ..StageReport::default() };
        let mut report = Report {
            late_ticks: 3,
            late_limit_ms: Some(80.0),
            stages: vec![decoder, recorder],
            ..Report::default()
        };
        report.agents.mean = Some(100.0);
        report
    }

    #[test]
    fn a_slow_machine_is_told_how_many_agents_fit() {
        let [how_far, what] = late(112.0).too_slow().unwrap();
        assert_eq!(how_far, "too slow by 56 ms: 100 agents take 112 of 80 ms at the median");
        assert_eq!(what, "about 50 would fit, more on more cores: stgdat bench --agents 100");
    }

    #[test]
    fn a_machine_that_was_busy_is_not_called_slow() {
        let [how_far, _] = late(20.0).too_slow().unwrap();
        assert!(how_far.starts_with("slow at times when something else ran: 100 agents"), "{how_far}");
    }

    #[test]
    fn a_late_wake_up_is_not_called_slow_computation() {
        let mut woken = late(9.0);
        woken.agents.mean = Some(8.0);
        woken.forecasts.shed.share = Some(0.1);
        woken.stages[0].wake_up_ms.max = Some(57.2);
        let late =
            |phase: &str| WorstTick { not_learned: 3, phase: Some(phase.to_owned()), ..WorstTick::default() };
        woken.worst_ticks = vec![late("wake-up"), late("compute")];
        let [how_far, what] = woken.too_slow().unwrap();
        assert_eq!(
            how_far,
            "the decoder woke up to 57 ms late: it had no processor; 8 agents take 9 of 80 ms"
        );
        assert!(what.contains("docs/real-time.md") && !what.contains("would fit"), "{what}");
        woken.worst_ticks[0] = late("publish");
        let [how_far, _] = woken.too_slow().unwrap();
        assert!(how_far.starts_with("slow at times when something else ran"), "{how_far}");
    }

    #[test]
    fn shed_load_says_how_many_agents_were_served() {
        let mut shed = late(60.0);
        shed.forecasts.shed.share = Some(0.25);
        let [how_far, what] = shed.too_slow().unwrap();
        assert_eq!(how_far, "too slow for 100 agents: 25.0 % of the forecasts were shed");
        assert!(what.starts_with("about 75 would fit"), "{what}");
    }

    #[test]
    fn late_forecasts_of_other_causes_have_no_advice() {
        let mut died = late(112.0);
        died.supervision.outages.push(Outage::default());
        let in_time = Report { late_ticks: 0, ..late(112.0) };
        assert_eq!((died.too_slow(), in_time.too_slow()), (None, None));
    }
}
