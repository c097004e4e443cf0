//! Decides whether a run met its expectations, from its history, its report and the injected faults.

use std::fmt::Display;

use crate::checker::{Finding, Line, Promise};
use recorder::ReplacementOutcome;
use serde::Serialize;

use crate::observation::EXPLANATIONS;
pub use crate::observation::{Cost, Observation, Resources, longest_run};
use crate::spec::{Counted, Expect, Spec};

/// The outcome of one expectation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The expectation is met.
    Ok,
    /// The expectation is not met.
    Failed,
    /// A tick count is outside the expectation, but tick counts are not asserted.
    NotAsserted,
}

/// An expectation with the finding.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Check {
    /// The subject of the check.
    pub what: String,
    /// The expected value.
    pub expected: String,
    pub found: String,
    pub outcome: Outcome,
}

fn check(what: &str, expected: &dyn Display, found: &dyn Display, met: bool) -> Check {
    let outcome = if met { Outcome::Ok } else { Outcome::Failed };
    Check { what: what.to_owned(), expected: expected.to_string(), found: found.to_string(), outcome }
}

fn equal<T: PartialEq + Display>(what: &str, expected: &T, found: &T) -> Check {
    check(what, expected, found, expected == found)
}

/// Checks the promises that every run must keep under any fault. A specification may relax some of them.
fn promises(seen: &Observation, expect: &Expect) -> Vec<Check> {
    let mut elsewhere = vec![Promise::OthersUntouched, Promise::NothingLeft];
    if expect.unexplained > 0 {
        elsewhere.extend(EXPLANATIONS);
    }
    let findings = seen.findings().into_iter().filter(|found| !elsewhere.contains(&found.promise));
    let to_check = |found: Finding| match found.count {
        0 => equal(found.promise.name(), &0, &0),
        count => {
            let found_text = format!("{count}, first {}", found.first);
            check(found.promise.name(), &0, &found_text, false)
        }
    };
    findings.map(to_check).collect()
}

/// Compares the observation with the specification's expectation. Without `timing`, tick counts outside the
/// expectation do not fail the check.
pub fn judge(spec: &Spec, seen: &Observation, timing: bool) -> Vec<Check> {
    let (expect, cost, outputs) = (&spec.expect, seen.cost(spec), seen.outputs());
    let mut checks = vec![equal("exit code", &expect.exit_code, &seen.exit)];
    let mut at_most = |what: &str, most: Option<u64>, found: u64| {
        if let Some(most) = most {
            let mut check = check(what, &format!("≤ {most}"), &found, found <= most);
            if !timing && check.outcome == Outcome::Failed {
                check.outcome = Outcome::NotAsserted;
            }
            checks.push(check);
        }
    };
    at_most("longest hole, ticks", expect.hole_max, cost.hole);
    at_most("ticks lost", expect.lost_max, cost.lost);
    at_most("ticks not learned", expect.not_learned_max, cost.not_learned);
    if let Some(to_learned) = cost.to_learned {
        at_most("ticks to learned again", expect.learned_within, to_learned);
    }
    let age_ms = outputs.0.values().map(|output| output.age_ms_max()).fold(0.0, f64::max);
    at_most("greatest age held, ms", expect.age_ms_max.map(|most| most as u64), age_ms.ceil() as u64);
    if expect.learned_within.is_some() && cost.to_learned.is_none() {
        checks.push(check("learned again", &"yes", &"no", false));
    }
    checks.push(equal("unexplained", &expect.unexplained, &cost.unexplained));
    checks.extend(promises(seen, expect));
    checks.extend(supervised(spec, seen));
    checks.extend(counted(expect, seen));
    for cause in &expect.causes {
        let found: u64 = outputs.0.values().filter_map(|output| output.causes().remove(cause.as_str())).sum();
        checks.push(check(&format!("forecasts with cause \"{cause}\""), &"≥ 1", &found, found > 0));
    }
    if let Some(least) = expect.predicted_min {
        let found = outputs.0.values().filter(|output| output.predicted).count() as u64;
        checks.push(check("ticks predicted", &format!("≥ {least}"), &found, found >= least));
    }
    for kind in spec.faults.topics.iter().map(|fault| fault.effect.name()) {
        let found = seen.injected(Some(kind), None).len();
        checks.push(check(&format!("frames with \"{kind}\""), &"≥ 1", &found, found > 0));
    }
    checks.extend(grown(expect, &cost));
    checks.push(equal("files left", &expect.leftovers, &seen.leftovers));
    checks.push(equal("stages left", &0, &seen.survivors));
    checks
}

/// One of the resources.
type Amount = fn(&Resources) -> u64;

/// Compares the run's resources at its end with those at its beginning.
fn grown(expect: &Expect, cost: &Cost) -> Vec<Check> {
    let limits: [(&str, Option<u64>, Amount); 4] = [
        ("growth of the launcher, KiB", expect.launcher_growth_kib_max, |r| r.launcher_kib),
        ("growth of all stages, KiB", expect.stages_growth_kib_max, |r| r.stages_kib),
        ("growth in open descriptors", expect.descriptors_growth_max, |r| r.descriptors),
        ("growth in files", expect.files_growth_max, |r| r.files),
    ];
    let limited = limits.into_iter().filter_map(|(what, most, of)| Some((what, most?, of)));
    let check_one = |(what, most, of): (&str, u64, Amount)| match &cost.resources {
        Some([begin, end]) => {
            let growth = of(end).saturating_sub(of(begin));
            check(what, &format!("≤ {most}"), &growth, growth <= most)
        }
        None => check(what, &format!("≤ {most}"), &"too few looks: a longer run", false),
    };
    limited.map(check_one).collect()
}

/// Checks the report's deaths and starvation of stages.
fn supervised(spec: &Spec, seen: &Observation) -> Vec<Check> {
    let (expect, mut checks) = (&spec.expect, Vec::new());
    let Some(report) = &seen.report else {
        if !spec.kills_launcher() && expect.exit_code != 78 {
            checks.push(check("a report", &"yes", &"no", false));
        }
        return checks;
    };
    let supervision = &report.supervision;
    let targets: Vec<&str> = spec.faults.targets.iter().map(|stage| stage.name()).collect();
    let others = report.stages.iter().filter(|stage| !targets.contains(&stage.name.as_str()));
    let restarts: u64 = others.map(|stage| u64::from(stage.restarts)).sum();
    checks.push(equal("restarts of others", &expect.restarts_of_others, &restarts));
    // An external program may lack the fault points of the built-in stages.
    for (stage, point, _) in &spec.faults.points {
        if !supervision.outages.iter().any(|outage| outage.stage == stage.name()) {
            let what = format!("the {} has the point {}", stage.name(), point.name());
            checks.push(check(&what, &"yes", &"no, it never died there", false));
        }
    }
    for expected in &expect.outages {
        let of = |outage: &&recorder::Outage| {
            outage.stage == expected.stage && outage.cause.contains(expected.cause.as_str())
        };
        let found = supervision.outages.iter().filter(of).count() as u64;
        let what = format!("outages of the {}, \"{}\"", expected.stage, expected.cause);
        checks.push(equal(&what, &expected.count, &found));
    }
    for expected in &expect.replacements {
        let of = |replacement: &&recorder::Replacement| {
            let outage = &replacement.outage;
            outage.stage == expected.stage
                && replacement.outcome == expected.outcome
                && outage.cause.contains(expected.cause.as_str())
        };
        let found = supervision.replacements.iter().filter(of).count() as u64;
        let what = format!("{} {}, \"{}\"", expected.stage, expected.outcome.name(), expected.cause);
        checks.push(equal(what.trim_end_matches(", \"\""), &expected.count, &found));
    }
    checks.extend(replaced(seen, &supervision.replacements));
    if let Some(least) = expect.dead_readers_min {
        let found = supervision.dead_readers;
        checks.push(check("dead readers", &format!("≥ {least}"), &found, found >= least));
        checks.push(equal("consumers that ended by themselves", &0, &seen.failed_consumers));
    }
    for (stage, expected) in &expect.promotions {
        let found = supervision.spares.get(stage).map_or(0, |spare| spare.promotions);
        checks.push(equal(&format!("promotions of the {stage}'s spare"), expected, &found));
    }
    let given_up: Vec<&str> = supervision.given_up.keys().map(String::as_str).collect();
    checks.push(equal("given up", &expect.given_up.join(", "), &given_up.join(", ")));
    for stage in &expect.starved {
        let found = if stage == "any" {
            !supervision.starved.is_empty()
        } else {
            supervision.starved.contains_key(stage)
        };
        let names: Vec<&str> = supervision.starved.keys().map(String::as_str).collect();
        checks.push(check("starved", stage, &names.join(", "), found));
    }
    if let Some(least) = expect.late_ticks_min {
        checks.push(check(
            "late ticks",
            &format!("≥ {least}"),
            &report.late_ticks,
            report.late_ticks >= least,
        ));
    }
    if let Some(text) = &expect.ended_by {
        let found = supervision.ended_by.clone().unwrap_or_else(|| "nothing".to_owned());
        let met = found.contains(text.as_str());
        checks.push(check("ended by", text, &found, met));
    }
    checks
}

/// Compares the exit codes of the `stage replace` commands with the report; `None` if there were no
/// replacements.
fn replaced(seen: &Observation, reported: &[recorder::Replacement]) -> Option<Check> {
    let by_verb = seen.lines.iter().filter_map(|line| match line {
        Line::Replaced { exit, .. } => Some(*exit == 0),
        _ => None,
    });
    let reported = reported.iter().map(|of| of.outcome == ReplacementOutcome::Replaced);
    let count = |outcomes: Vec<bool>| {
        let replaced = outcomes.iter().filter(|is_replaced| **is_replaced).count();
        format!("{replaced} replaced, {} not", outcomes.len() - replaced)
    };
    let (by_verb, reported): (Vec<bool>, Vec<bool>) = (by_verb.collect(), reported.collect());
    let any = !by_verb.is_empty() || !reported.is_empty();
    any.then(|| equal("replacements by the verb's exit codes", &count(reported), &count(by_verb)))
}

/// Checks the report's counters of lost frames.
fn counted(expect: &Expect, seen: &Observation) -> Vec<Check> {
    let mut checks = Vec::new();
    for Counted { stage, cause, as_injected, topic, min, max } in &expect.counted {
        let stages = seen.report.iter().flat_map(|report| &report.stages);
        let drops = || stages.clone().filter(|of| of.name == *stage).map(|of| of.drops);
        let refusals = seen.report.iter().flat_map(|report| &report.refusals);
        let found: u64 = match cause.as_str() {
            "gap" => drops().map(|drops| drops.gap).sum(),
            "refused" => drops().map(|drops| drops.refused).sum(),
            "restart" => drops().map(|drops| drops.restart).sum(),
            cause => refusals.filter(|r| r.reader == *stage && r.cause == cause).map(|r| r.frames).sum(),
        };
        let what = format!("{cause} counted by the {stage}");
        if let Some(kind) = as_injected {
            checks.push(equal(&what, &(seen.injected(Some(kind), topic.as_deref()).len() as u64), &found));
        }
        if let Some(least) = min {
            checks.push(check(&what, &format!("≥ {least}"), &found, found >= *least));
        }
        if let Some(most) = max {
            checks.push(check(&what, &format!("≤ {most}"), &found, found <= *most));
        }
    }
    checks
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use recorder::report::StageReport;
    use recorder::{Outage, Report, Supervision};

    use super::*;
    use crate::checker::{ForecastSeen, Output};

    fn spec(expect: &str) -> Spec {
        let text = format!(
            "shows = \"a test\"\n[run]\nticks = 20\n[[fault]]\nkind = \"kill\"\nstage = \"sampler\"\nat = 5\n{expect}"
        );
        Spec::parse(Path::new("a.toml"), &text).unwrap()
    }

    fn output(tick: u64) -> Line {
        let stamp_ns = tick as i64 * 80_000_000;
        let learned =
            |id| ForecastSeen { id, quality: "learned".into(), cause: "none".into(), ..Default::default() };
        let forecasts = (1..4).map(learned).collect();
        Line::Forecasts(Output { tick, stamp_ns, forecasts, ..Output::default() })
    }

    /// A run that misses ticks 6 to 8, with an explanation in the report.
    fn seen() -> Observation {
        let outage = Outage {
            stage: "sampler".into(),
            incarnation: 1,
            cause: "was killed by signal 9".into(),
            tick: 5,
            ticks_lost: 3,
            ticks_to_learned: Some(4),
            ..Outage::default()
        };
        let supervision = Supervision { outages: vec![outage], ..Supervision::default() };
        let stages = vec![StageReport { name: "sampler".into(), restarts: 1, ..StageReport::default() }];
        Observation {
            lines: (0..20).filter(|tick| !(6..9).contains(tick)).map(output).collect(),
            report: Some(Report { supervision, stages, ..Report::default() }),
            ..Observation::default()
        }
    }

    fn failed(expect: &str, seen: &Observation) -> Vec<String> {
        let spec = spec(expect);
        let checks = judge(&spec, &seen.clone().concluded(&spec), true).into_iter();
        checks.filter(|check| check.outcome == Outcome::Failed).map(|check| check.what).collect()
    }

    #[test]
    fn a_run_as_expected_passes_and_its_cost_is_told() {
        let expect = "[expect]\nhole_max = 3\nlearned_within = 4\nlost_max = 3\n\
                      outages = [{ stage = \"sampler\", cause = \"signal 9\", count = 1 }]";
        assert_eq!(failed(expect, &seen()), Vec::<String>::new());
        let cost = seen().concluded(&spec(expect)).cost(&spec(expect));
        assert_eq!((cost.lost, cost.hole, cost.to_learned, cost.unexplained), (3, 3, Some(4), 0));
    }

    #[test]
    fn each_broken_promise_is_found() {
        type Lie = fn(&mut Observation);
        let lies: [(Lie, &str); 12] = [
            (|seen| seen.lines.retain(|line| *line != output(15)), "unexplained"),
            (|seen| seen.lines.push(output(3)), "ticks that came twice or back in order"),
            (|seen| change(seen, 12, |o| o.stamp_ns = 0), "stamps that are not after the one before"),
            (|seen| change(seen, 12, |o| o.forecasts[0].age_ns = 1), "forecasts with a wrong age"),
            (|seen| change(seen, 12, |o| o.forecasts[0].quality = "kinematic".into()), "unexplained"),
            (|seen| change(seen, 12, |o| o.impossible = Some("NaN".into())), "impossible numbers"),
            (|seen| seen.leftovers = 1, "files left"),
            (|seen| seen.survivors = 1, "stages left"),
            (|seen| seen.exit = 70, "exit code"),
            (|seen| seen.report = None, "a report"),
            (
                |seen| {
                    let stage = StageReport { name: "decoder".into(), restarts: 1, ..StageReport::default() };
                    seen.report.as_mut().unwrap().stages.push(stage);
                },
                "restarts of others",
            ),
            (
                |seen| {
                    let given_up = &mut seen.report.as_mut().unwrap().supervision.given_up;
                    given_up.insert("sampler".into(), "too often".into());
                },
                "given up",
            ),
        ];
        for (lie, found) in lies {
            let mut seen = seen();
            lie(&mut seen);
            assert!(failed("", &seen).contains(&found.to_owned()), "{found}: {:?}", failed("", &seen));
        }
        assert_eq!(failed("[expect]\nhole_max = 2", &seen()), ["longest hole, ticks"]);
        let spec = spec("[expect]\nhole_max = 2");
        let lax = judge(&spec, &seen().concluded(&spec), false);
        assert!(lax.iter().all(|check| check.outcome != Outcome::Failed), "{lax:?}");
    }

    fn change(seen: &mut Observation, at: u64, change: impl FnOnce(&mut Output)) {
        for line in &mut seen.lines {
            if let Line::Forecasts(output) = line
                && output.tick == at
            {
                return change(output);
            }
        }
        panic!("no output of tick {at}");
    }
}
