//! Decides whether a run met its expectations, from its history, its report and the injected faults.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;

use crate::checker::{Finding, Line, Output, Promise, Told};
use recorder::{Outage, ReplacementOutcome, Report};
use serde::Serialize;
use wire::StageId;

use crate::faults::spec::{Counted, Expect, Fault, Spec};

/// The observation of a run.
#[derive(Clone, Debug, Default)]
pub struct Observation {
    /// The exit code; the negated signal number if a signal ended the run.
    pub exit: i32,
    /// The history, in order.
    pub lines: Vec<Line>,
    /// Ticks whose forecasts the recorder has written.
    pub recorded: BTreeSet<u64>,
    /// The report, if there is one.
    pub report: Option<Report>,
    /// Topics with an injector on which no forecast depends.
    pub beside: Vec<String>,
    /// Ticks at which faults without own frames were over.
    pub over: Vec<u64>,
    /// Files left in shared memory and the run's folder.
    pub leftovers: u64,
    /// Stages that were running 2 s after the launcher's end.
    pub survivors: u64,
    /// Number of times that a consumer ended by itself before it was killed.
    pub failed_consumers: u64,
}

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
    /// The finding.
    pub found: String,
    /// The outcome.
    pub outcome: Outcome,
}

/// The cost of the faults, in numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Cost {
    /// Ticks with forecasts.
    pub ticks: u64,
    /// Ticks without forecasts.
    pub lost: u64,
    /// The longest gap.
    pub hole: u64,
    /// Ticks with forecasts that are not learned for a reason other than a young track.
    pub not_learned: u64,
    /// Maximum number of ticks from the end of a fault until forecasts were learned again; `None` if they
    /// never were.
    pub to_learned: Option<u64>,
    /// Number of affected frames, by topic and kind.
    pub injected: BTreeMap<String, u64>,
    /// Median and maximum delay that each injector added to a frame, in µs, by topic.
    pub injector_us: BTreeMap<String, [u64; 2]>,
    /// Missing ticks and forecasts that are not learned, without a counted cause.
    pub unexplained: u64,
    /// Resources of the run's processes at its beginning and end; `None` for a short run.
    pub resources: Option<[Resources; 2]>,
}

/// Resources of a run's processes, as medians of several measurements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Resources {
    /// Resident memory of the launcher, in KiB.
    pub launcher_kib: u64,
    /// Resident memory of all stages, in KiB. Shared memory counts in each stage.
    pub stages_kib: u64,
    /// Open descriptors of the launcher.
    pub descriptors: u64,
    /// The run's files in shared memory and in its folder.
    pub files: u64,
    /// Shared memory, in KiB.
    pub shared_kib: u64,
}

/// Promises that every missing tick and every cause is explained.
const EXPLANATIONS: [Promise; 3] =
    [Promise::MissingTicksExplained, Promise::CausesSaid, Promise::CausesCounted];

/// The outputs by tick.
struct Outputs<'a>(BTreeMap<u64, &'a Output>);

impl Observation {
    /// Returns the observation with the run's own report as its last line.
    pub fn concluded(mut self, spec: &Spec) -> Self {
        let told = self.told(spec);
        self.lines.push(Line::Told(Box::new(told)));
        self
    }

    fn outputs(&self) -> Outputs<'_> {
        Outputs(self.lines.iter().filter_map(Line::output).map(|output| (output.tick, output)).collect())
    }

    /// Returns the ticks on which a kind of fault acted on a topic. `None` means any kind or any topic.
    fn injected(&self, kind: Option<&str>, topic: Option<&str>) -> BTreeSet<u64> {
        let acted = |line: &Line| {
            let Line::Injected { tick, kinds, topic: on } = line else { return None };
            let is_kind = kind.is_none_or(|kind| kinds.iter().any(|acted| acted == kind));
            (is_kind && topic.is_none_or(|topic| topic == on)).then_some(*tick)
        };
        self.lines.iter().filter_map(acted).collect()
    }

    /// Returns the cost of the faults.
    pub fn cost(&self, spec: &Spec) -> Cost {
        let outputs = self.outputs();
        let missing = self.missing_of(spec, &outputs);
        let mut cost = Cost {
            ticks: outputs.0.len() as u64,
            lost: missing.len() as u64,
            hole: longest_run(&missing),
            not_learned: outputs.0.values().filter(|output| output.degraded() > 0 || output.void).count()
                as u64,
            to_learned: self.to_learned(&outputs),
            unexplained: self.unexplained(),
            resources: self.resources(),
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

    /// Returns the ticks without forecasts, which neither the follower nor the recorder has seen. A run that
    /// is meant to end early is checked up to its newest tick.
    fn missing_of(&self, spec: &Spec, outputs: &Outputs<'_>) -> Vec<u64> {
        let newest = outputs.0.keys().chain(&self.recorded).max().map_or(0, |newest| newest + 1);
        let end = if spec.expect.exit_code == 0 { spec.run.ticks } else { newest };
        (0..end).filter(|tick| !outputs.0.contains_key(tick) && !self.recorded.contains(tick)).collect()
    }

    /// Ticks without forecasts.
    pub fn missing(&self, spec: &Spec) -> BTreeSet<u64> {
        self.missing_of(spec, &self.outputs()).into_iter().collect()
    }

    /// Returns the ticks with a forecast that is not learned for a reason other than a young track.
    pub fn degraded(&self) -> BTreeSet<u64> {
        let outputs = self.lines.iter().filter_map(Line::output);
        outputs.filter(|output| output.void || output.degraded() > 0).map(|output| output.tick).collect()
    }

    /// Returns the ticks with predicted tracks.
    pub fn predicted(&self) -> BTreeSet<u64> {
        let outputs = self.lines.iter().filter_map(Line::output);
        outputs.filter(|output| output.predicted).map(|output| output.tick).collect()
    }

    /// Maximum number of ticks until forecasts were learned again, after outages, affected frames and other
    /// faults.
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

    /// Returns the outages of the report, including the outages of replacements.
    fn outages(&self) -> impl Iterator<Item = &Outage> {
        let supervision = || self.report.iter().map(|report| &report.supervision);
        let replacements = supervision().flat_map(|of| &of.replacements);
        let handed_over = replacements.filter(|of| of.outcome != ReplacementOutcome::NotUsed);
        supervision().flat_map(|of| &of.outages).chain(handed_over.map(|of| &of.outage))
    }

    /// Returns the checker's findings in the history; empty until the run's end is known.
    fn findings(&self) -> Vec<Finding> {
        crate::checker::check(&self.lines)
    }

    /// Counts missing ticks that no outage, fault or stage counter explains. Also counts forecasts without a
    /// cause, or with a cause that no stage counted.
    fn unexplained(&self) -> u64 {
        let findings = self.findings().into_iter();
        findings.filter(|found| EXPLANATIONS.contains(&found.promise)).map(|found| found.count).sum()
    }

    /// Checks the promises that every run must keep under any fault. A specification may relax some of them.
    fn promises(&self, expect: &Expect) -> Vec<Check> {
        let mut elsewhere = vec![Promise::OthersUntouched, Promise::NothingLeft];
        if expect.unexplained > 0 {
            elsewhere.extend(EXPLANATIONS);
        }
        let findings = self.findings().into_iter().filter(|found| !elsewhere.contains(&found.promise));
        let told = |found: Finding| match found.count {
            0 => equal(found.promise.broken_by(), &0, &0),
            count => {
                let found_text = format!("{count}, first {}", found.first);
                check(found.promise.broken_by(), &0, &found_text, false)
            }
        };
        findings.map(told).collect()
    }

    /// Returns the facts that the checker needs in addition to the history: the run's report and the expected
    /// events.
    pub fn told(&self, spec: &Spec) -> Told {
        let expect = &spec.expect;
        let seen = self.outputs();
        let mut told = Told {
            ticks: (expect.exit_code == 0).then_some(spec.run.ticks),
            held_max_ns: spec.held_max_ns(),
            targets: spec.targets().into_iter().map(|stage| stage.name().to_owned()).collect(),
            restarts_of_others: expect.restarts_of_others,
            leftovers: expect.leftovers,
            reported: self.report.is_some(),
            recorded_alone: self.recorded.iter().copied().filter(|tick| !seen.0.contains_key(tick)).collect(),
            beside: self.beside.clone(),
            files_left: self.leftovers,
            stages_left: self.survivors,
            ..Told::default()
        };
        let Some(report) = &self.report else { return told };
        told.lockstep = report.run.lockstep.unwrap_or(false);
        let outage = |outage: &recorder::Outage| crate::checker::Outage {
            stage: outage.stage.clone(),
            tick: outage.tick,
            ticks_to_learned: outage.ticks_to_learned,
        };
        let replaced = report
            .supervision
            .replacements
            .iter()
            .flat_map(|of| std::iter::repeat_n(&of.outage, of.outcome.incarnations() as usize));
        told.outages = report.supervision.outages.iter().chain(replaced).map(outage).collect();
        told.outages_unlisted = report.supervision.outages_unlisted;
        let lost = |stage: &recorder::report::StageReport| {
            (stage.name.clone(), stage.drops.gap + stage.drops.refused)
        };
        told.lost = report.stages.iter().map(lost).collect();
        let unanswered = report.stages.iter().map(|stage| (stage.name.clone(), stage.drops.unanswered));
        told.unanswered = unanswered.collect();
        told.causes.clone_from(&report.forecasts.causes);
        told.late_ticks = report.late_ticks;
        told
    }

    /// Returns the resources at the beginning and at the end. Medians are used because stages come and go.
    fn resources(&self) -> Option<[Resources; 2]> {
        let looks: Vec<Resources> = self.lines.iter().filter_map(look).collect();
        if looks.len() < 2 * LOOKS {
            return None;
        }
        Some([median(&looks[..LOOKS]), median(&looks[looks.len() - LOOKS..])])
    }
}

/// Number of resource measurements per median.
const LOOKS: usize = 9;

fn look(line: &Line) -> Option<Resources> {
    let Line::Resources { launcher_bytes, descriptors, stages_bytes, files, shared_bytes, .. } = *line else {
        return None;
    };
    Some(Resources {
        launcher_kib: launcher_bytes / 1024,
        stages_kib: stages_bytes / 1024,
        descriptors,
        files,
        shared_kib: shared_bytes / 1024,
    })
}

fn median(looks: &[Resources]) -> Resources {
    let of = |value: fn(&Resources) -> u64| {
        let mut values: Vec<u64> = looks.iter().map(value).collect();
        values.sort_unstable();
        values.get(values.len() / 2).copied().unwrap_or(0)
    };
    Resources {
        launcher_kib: of(|look| look.launcher_kib),
        stages_kib: of(|look| look.stages_kib),
        descriptors: of(|look| look.descriptors),
        files: of(|look| look.files),
        shared_kib: of(|look| look.shared_kib),
    }
}

/// Returns the length of the longest series of consecutive ticks.
pub fn longest_run(ticks: &[u64]) -> u64 {
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
    checks.extend(seen.promises(expect));
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
    for kind in spec.topic_faults().map(|fault| fault.effect.name()) {
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
    let targets: Vec<&str> = spec.targets().into_iter().map(StageId::name).collect();
    let others = report.stages.iter().filter(|stage| !targets.contains(&stage.name.as_str()));
    let restarts: u64 = others.map(|stage| u64::from(stage.restarts)).sum();
    checks.push(equal("restarts of others", &expect.restarts_of_others, &restarts));
    // An external program may lack the fault points of the built-in stages.
    for fault in &spec.faults {
        if let Fault::KillAt { stage, point, .. } = fault
            && !supervision.outages.iter().any(|outage| outage.stage == stage.name())
        {
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

    use super::*;
    use crate::checker::ForecastSeen;
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
