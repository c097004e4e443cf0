//! By how much a machine was too slow, and what to do about it.

use wire::{Cause, StageId};

use crate::report::Report;

/// Share of the limit that the median of a tick may take so that its slowest percent keeps it: measured runs have a
/// 99th percentile of 1.4 times the median.
const COMFORTABLE: f64 = 0.7;

impl Report {
    /// Lines that say how far the run was from keeping its time, and what to do, where forecasts came late and no
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
        if shed > 0.0 {
            let served = (agents * (1.0 - shed)).floor().max(1.0);
            return Some([
                format!("too slow for {agents:.0} agents: {:.1} % of the forecasts were shed", 100.0 * shed),
                format!("about {served:.0} would fit, more on more cores: stgdat bench --agents {agents:.0}"),
            ]);
        }
        let on_the_way = self.stages.iter().filter(|stage| stage.name != StageId::Recorder.name());
        let compute_ms: f64 = on_the_way.filter_map(|stage| stage.compute_ms.p50).sum();
        if compute_ms <= 0.0 {
            return None;
        }
        let took = format!("{agents:.0} agents take {compute_ms:.0} of {limit_ms:.0} ms");
        let over_ms = compute_ms - COMFORTABLE * limit_ms;
        Some(if over_ms > 0.0 {
            let fewer = (agents * COMFORTABLE * limit_ms / compute_ms).floor().max(1.0);
            [
                format!("too slow by {over_ms:.0} ms: {took} at the median"),
                format!("about {fewer:.0} would fit, more on more cores: stgdat bench --agents {agents:.0}"),
            ]
        } else {
            [
                format!("slow at times when something else ran: {took}"),
                "stgdat doctor tells what fits; docs/real-time.md frees processors".to_owned(),
            ]
        })
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
    fn shed_load_says_how_many_agents_were_served() {
        let mut shed = late(20.0);
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
