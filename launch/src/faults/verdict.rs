//! Whether a run did what is expected of it, by its history, its report, and what was injected.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;

use recorder::{Outage, ReplacementOutcome, Report};
use serde::Serialize;
use wire::StageId;

use crate::faults::history::{Line, Output};
use crate::faults::spec::{Counted, Expect, Spec};

/// What was seen of a run.
#[derive(Debug, Default)]
pub struct Observation {
    /// Its exit code; the signal that ended it, negative.
    pub exit: i32,
    /// All that was seen, in order.
    pub lines: Vec<Line>,
    /// Ticks whose forecasts the recorder has written.
    pub recorded: BTreeSet<u64>,
    /// Its report, where there is one.
    pub report: Option<Report>,
    /// Ticks after which a fault without a frame of its own was over.
    pub over: Vec<u64>,
    /// Files left in shared memory and the run's folder.
    pub leftovers: u64,
    /// Stages that were there 2 s after the launcher.
    pub survivors: u64,
}

/// The outcome of one expectation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// It is met.
    Ok,
    /// It is not.
    Failed,
    /// A number of ticks that was not to be asserted, and is beyond what is expected.
    NotAsserted,
}

/// An expectation with what was found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What is checked.
    pub what: String,
    /// What is expected.
    pub expected: String,
    /// What was found.
    pub found: String,
    /// Whether it is met.
    pub outcome: Outcome,
}

/// What a fault cost, in numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Cost {
    /// Ticks with forecasts.
    pub ticks: u64,
    /// Ticks without.
    pub lost: u64,
    /// The longest run of them.
    pub hole: u64,
    /// Ticks with forecasts that are not learned, for another cause than a young track.
    pub not_learned: u64,
    /// The most ticks from the end of a fault until forecasts were learned again; none where they never were.
    pub to_learned: Option<u64>,
    /// Frames that faults acted on, by topic and kind.
    pub injected: BTreeMap<String, u64>,
    /// Median and maximum of what each injector cost a frame, in µs, by topic.
    pub injector_us: BTreeMap<String, [u64; 2]>,
    /// Missing ticks and not learned forecasts without a counted cause.
    pub unexplained: u64,
}

/// The outputs by their tick.
struct Outputs<'a>(BTreeMap<u64, &'a Output>);

impl Observation {
    fn outputs(&self) -> Outputs<'_> {
        Outputs(self.lines.iter().filter_map(Line::output).map(|output| (output.tick, output)).collect())
    }

    /// Ticks on which a kind of fault has acted on a topic; on which any has, and on any topic, where none is
    /// given.
    fn injected(&self, kind: Option<&str>, topic: Option<&str>) -> BTreeSet<u64> {
        let acted = |line: &Line| {
            let Line::Injected { tick, kinds, topic: on } = line else { return None };
            let is_kind = kind.is_none_or(|kind| kinds.iter().any(|acted| acted == kind));
            (is_kind && topic.is_none_or(|topic| topic == on)).then_some(*tick)
        };
        self.lines.iter().filter_map(acted).collect()
    }

    /// What the faults cost.
    pub fn cost(&self, spec: &Spec) -> Cost {
        let outputs = self.outputs();
        let missing = self.missing(spec, &outputs);
        let mut cost = Cost {
            ticks: outputs.0.len() as u64,
            lost: missing.len() as u64,
            hole: longest_run(&missing),
            not_learned: outputs.0.values().filter(|output| output.degraded > 0 || output.void).count()
                as u64,
            to_learned: self.to_learned(&outputs),
            unexplained: self.unexplained(&missing, &outputs),
            ..Cost::default()
        };
        for line in &self.lines {
            match line {
                Line::Injected { topic, kinds, .. } => {
                    for kind in kinds {
                        *cost.injected.entry(format!("{topic}: {kind}")).or_default() += 1;
                    }
                }
                Line::Cost { topic, us_p50, us_max, .. } => {
                    cost.injector_us.insert(topic.clone(), [*us_p50, *us_max]);
                }
                _ => {}
            }
        }
        cost
    }

    /// Ticks without forecasts: neither the follower nor the recorder has seen any. A run that was to end
    /// early is looked at up to its newest tick.
    fn missing(&self, spec: &Spec, outputs: &Outputs<'_>) -> Vec<u64> {
        let newest = outputs.0.keys().chain(&self.recorded).max().map_or(0, |newest| newest + 1);
        let end = if spec.expect.exit_code == 0 { spec.run.ticks } else { newest };
        (0..end).filter(|tick| !outputs.0.contains_key(tick) && !self.recorded.contains(tick)).collect()
    }

    /// The most ticks until forecasts were learned again: after outages, frames acted on and other faults.
    fn to_learned(&self, outputs: &Outputs<'_>) -> Option<u64> {
        let mut most = 0;
        for outage in self.outages() {
            most = most.max(outage.ticks_to_learned?);
        }
        for end in self.injected(None, None).last().into_iter().chain(&self.over) {
            let learned = outputs.0.range(end + 1..).find(|(_, output)| output.is_learned());
            most = most.max(learned?.0 - end);
        }
        Some(most)
    }

    /// Missing ticks that lie in no outage, that no fault acted on and that no stage has counted, and
    /// forecasts without a cause.
    fn unexplained(&self, missing: &[u64], outputs: &Outputs<'_>) -> u64 {
        let outages: Vec<&Outage> = self.outages().collect();
        let acted = self.injected(None, None);
        let is_explained = |tick: &u64| {
            let in_outage = outages.iter().any(|outage| {
                let end = outage.ticks_to_learned.map_or(u64::MAX, |ticks| outage.tick + ticks);
                (outage.tick..=end).contains(tick)
            });
            in_outage || acted.contains(tick)
        };
        let without = missing.iter().filter(|tick| !is_explained(tick)).count() as u64;
        let stages = self.report.iter().flat_map(|report| &report.stages);
        let counted: u64 = stages.map(|stage| stage.drops.gap + stage.drops.refused).sum();
        without.saturating_sub(counted) + outputs.0.values().map(|output| output.uncaused).sum::<u64>()
    }

    /// The outages of the report, those of replacements too.
    fn outages(&self) -> impl Iterator<Item = &Outage> {
        let supervision = || self.report.iter().map(|report| &report.supervision);
        let replacements = supervision().flat_map(|of| &of.replacements);
        let handed_over = replacements.filter(|of| of.outcome != ReplacementOutcome::NotUsed);
        supervision().flat_map(|of| &of.outages).chain(handed_over.map(|of| &of.outage))
    }

    /// What every run must keep, whatever is injected.
    fn promises(&self) -> Vec<Check> {
        let forecasts = || self.lines.iter().filter_map(Line::output);
        // A void frame says itself that it holds nothing of its tick.
        let valid = || forecasts().filter(|output| !output.void);
        let steps = || valid().zip(valid().skip(1));
        let backward = steps().filter(|(a, b)| b.tick <= a.tick).count() as u64;
        let older = steps().filter(|(a, b)| b.stamp_ns <= a.stamp_ns).count() as u64;
        let wrong_age: u64 = forecasts().map(|output| output.wrong_age).sum();
        let impossible = forecasts().find_map(|output| output.impossible.clone());
        vec![
            equal("ticks that came twice or back in order", &0, &backward),
            equal("stamps that are not after the one before", &0, &older),
            equal("forecasts with a wrong age", &0, &wrong_age),
            check(
                "impossible numbers",
                &"none",
                &impossible.as_deref().unwrap_or("none"),
                impossible.is_none(),
            ),
        ]
    }
}

fn longest_run(ticks: &[u64]) -> u64 {
    let (mut longest, mut run, mut before) = (0, 0, None);
    for &tick in ticks {
        run = if before.is_some_and(|before: u64| before + 1 == tick) { run + 1 } else { 1 };
        longest = longest.max(run);
        before = Some(tick);
    }
    longest
}

fn check(what: &str, expected: &dyn Display, found: &dyn Display, met: bool) -> Check {
    let outcome = if met { Outcome::Ok } else { Outcome::Failed };
    Check { what: what.to_owned(), expected: expected.to_string(), found: found.to_string(), outcome }
}

fn equal<T: PartialEq + Display>(what: &str, expected: &T, found: &T) -> Check {
    check(what, expected, found, expected == found)
}

/// Compares what was seen with what the specification expects. Without `timing`, numbers of ticks beyond what
/// is expected are no failure.
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
    let age_ms = outputs.0.values().map(|output| output.age_ms_max).fold(0.0, f64::max);
    at_most("greatest age held, ms", expect.age_ms_max.map(|most| most as u64), age_ms.ceil() as u64);
    if expect.learned_within.is_some() && cost.to_learned.is_none() {
        checks.push(check("learned again", &"yes", &"no", false));
    }
    checks.push(equal("unexplained", &expect.unexplained, &cost.unexplained));
    checks.extend(seen.promises());
    checks.extend(supervised(spec, seen));
    checks.extend(counted(expect, seen));
    for cause in &expect.causes {
        let found: u64 = outputs.0.values().filter_map(|output| output.causes.get(cause)).sum();
        checks.push(check(&format!("forecasts with cause \"{cause}\""), &"≥ 1", &found, found > 0));
    }
    if let Some(least) = expect.predicted_min {
        let found = outputs.0.values().filter(|output| output.predicted).count() as u64;
        checks.push(check("ticks predicted", &format!("≥ {least}"), &found, found >= least));
    }
    for kind in spec.topic_faults().map(|fault| fault.effect.name()) {
        let found = seen.injected(Some(kind), None).len();
        checks.push(check(&format!("frames with \"{kind}\""), &"≥ 1", &found, found > 0));
    }
    checks.push(equal("files left", &expect.leftovers, &seen.leftovers));
    checks.push(equal("stages left", &0, &seen.survivors));
    checks
}

/// What the report says of the stages' deaths and starvation.
fn supervised(spec: &Spec, seen: &Observation) -> Vec<Check> {
    let (expect, mut checks) = (&spec.expect, Vec::new());
    let Some(report) = &seen.report else {
        if !spec.kills_launcher() && expect.exit_code != 78 {
            checks.push(check("a report", &"yes", &"no", false));
        }
        return checks;
    };
    let supervision = &report.supervision;
    let targets: Vec<&str> = spec.targets().into_iter().map(StageId::name).collect();
    let others = report.stages.iter().filter(|stage| !targets.contains(&stage.name.as_str()));
    let restarts: u64 = others.map(|stage| u64::from(stage.restarts)).sum();
    checks.push(equal("restarts of others", &expect.restarts_of_others, &restarts));
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

/// What the verb has told of the replacements, beside the report; nothing where there were none.
fn replaced(seen: &Observation, reported: &[recorder::Replacement]) -> Option<Check> {
    let told = seen.lines.iter().filter_map(|line| match line {
        Line::Replaced { exit, .. } => Some(*exit == 0),
        _ => None,
    });
    let reported = reported.iter().map(|of| of.outcome == ReplacementOutcome::Replaced);
    let count = |outcomes: Vec<bool>| {
        let replaced = outcomes.iter().filter(|is_replaced| **is_replaced).count();
        format!("{replaced} replaced, {} not", outcomes.len() - replaced)
    };
    let (told, reported): (Vec<bool>, Vec<bool>) = (told.collect(), reported.collect());
    let any = !told.is_empty() || !reported.is_empty();
    any.then(|| equal("replacements by the verb's exit codes", &count(reported), &count(told)))
}

/// The report's counters of frames lost.
fn counted(expect: &Expect, seen: &Observation) -> Vec<Check> {
    let mut checks = Vec::new();
    for Counted { stage, cause, as_injected, topic, min, max } in &expect.counted {
        let stages = seen.report.iter().flat_map(|report| &report.stages);
        let drops = stages.filter(|of| of.name == *stage).map(|of| of.drops);
        let found: u64 = drops
            .map(|drops| match cause.as_str() {
                "gap" => drops.gap,
                "refused" => drops.refused,
                _ => drops.restart,
            })
            .sum();
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

    use super::*;
    use recorder::report::StageReport;
    use recorder::{Outage, Supervision};

    fn spec(expect: &str) -> Spec {
        let text = format!(
            "shows = \"a test\"\n[run]\nticks = 20\n[[fault]]\nkind = \"kill\"\nstage = \"sampler\"\nat = 5\n{expect}"
        );
        Spec::parse(Path::new("a.toml"), &text).unwrap()
    }

    fn output(tick: u64) -> Line {
        let stamp_ns = tick as i64 * 80_000_000;
        Line::Forecasts(Output { tick, stamp_ns, qualities: [3, 0, 0], ..Output::default() })
    }

    /// A run that misses the ticks 6 to 8, which the report explains.
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
        let checks = judge(&spec(expect), seen, true).into_iter();
        checks.filter(|check| check.outcome == Outcome::Failed).map(|check| check.what).collect()
    }

    #[test]
    fn a_run_as_expected_passes_and_its_cost_is_told() {
        let expect = "[expect]\nhole_max = 3\nlearned_within = 4\nlost_max = 3\n\
                      outages = [{ stage = \"sampler\", cause = \"signal 9\", count = 1 }]";
        assert_eq!(failed(expect, &seen()), Vec::<String>::new());
        let cost = seen().cost(&spec(expect));
        assert_eq!((cost.lost, cost.hole, cost.to_learned, cost.unexplained), (3, 3, Some(4), 0));
    }

    #[test]
    fn each_broken_promise_is_found() {
        type Lie = fn(&mut Observation);
        let lies: [(Lie, &str); 12] = [
            (|seen| seen.lines.retain(|line| *line != output(15)), "unexplained"),
            (|seen| seen.lines.push(output(3)), "ticks that came twice or back in order"),
            (|seen| change(seen, 12, |o| o.stamp_ns = 0), "stamps that are not after the one before"),
            (|seen| change(seen, 12, |o| o.wrong_age = 1), "forecasts with a wrong age"),
            (|seen| change(seen, 12, |o| o.uncaused = 1), "unexplained"),
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
        let lax = judge(&spec("[expect]\nhole_max = 2"), &seen(), false);
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
