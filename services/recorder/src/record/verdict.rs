use wire::Cause;

use crate::report::{Report, StageReport, Verdict, restarts};
use crate::tick::is_fault;

pub(super) fn verdict(report: &Report) -> Verdict {
    let mut reasons = Vec::new();
    let by_stage = |count: fn(&StageReport) -> u64| {
        let named = report.stages.iter().map(|stage| (stage.name.as_str(), count(stage)));
        list(named)
    };
    reasons.extend(report.silences.reason());
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
        reasons.push(format!("omitted by policy: {} forecasts", report.forecasts.silent));
    }
    if report.files_unwritten > 0 {
        let times = report.files_unwritten;
        reasons.push(format!("the recorder could not save its state {times} times: is the disk full?"));
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
