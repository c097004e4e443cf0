//! What was seen of a run with faults, and what the faults cost.

use std::collections::{BTreeMap, BTreeSet};

use recorder::{Outage, ReplacementOutcome, Report};
use serde::Serialize;

use crate::checker::{Facts, Finding, Line, Output, Promise};
use crate::spec::Spec;

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
    pub off_path_topics: Vec<String>,
    /// Ticks at which faults without own frames were over.
    pub over: Vec<u64>,
    /// Files left in shared memory and the run's folder.
    pub leftovers: u64,
    /// Stages that were running 2 s after the launcher's end.
    pub survivors: u64,
    /// Number of times that a consumer ended by itself before it was killed.
    pub failed_consumers: u64,
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
pub(super) const EXPLANATIONS: [Promise; 3] =
    [Promise::MissingTicksExplained, Promise::CausesNamed, Promise::CausesCounted];

/// The outputs by tick.
pub(super) struct Outputs<'a>(pub BTreeMap<u64, &'a Output>);

impl Observation {
    /// Returns the observation with the run's own report as its last line.
    pub fn concluded(mut self, spec: &Spec) -> Self {
        let facts = self.facts(spec);
        self.lines.push(Line::Facts(Box::new(facts)));
        self
    }

    pub(super) fn outputs(&self) -> Outputs<'_> {
        Outputs(self.lines.iter().filter_map(Line::output).map(|output| (output.tick, output)).collect())
    }

    /// Returns the ticks on which a kind of fault acted on a topic. `None` means any kind or any topic.
    pub(super) fn injected(&self, kind: Option<&str>, topic: Option<&str>) -> BTreeSet<u64> {
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
    pub(super) fn outages(&self) -> impl Iterator<Item = &Outage> {
        let supervision = || self.report.iter().map(|report| &report.supervision);
        let replacements = supervision().flat_map(|of| &of.replacements);
        let handed_over = replacements.filter(|of| of.outcome != ReplacementOutcome::NotUsed);
        supervision().flat_map(|of| &of.outages).chain(handed_over.map(|of| &of.outage))
    }

    /// Returns the checker's findings in the history; empty until the run's end is known.
    pub(super) fn findings(&self) -> Vec<Finding> {
        crate::checker::check(&self.lines)
    }

    /// Counts missing ticks that no outage, fault or stage counter explains. Also counts forecasts without a
    /// cause, or with a cause that no stage counted.
    fn unexplained(&self) -> u64 {
        let findings = self.findings().into_iter();
        findings.filter(|found| EXPLANATIONS.contains(&found.promise)).map(|found| found.count).sum()
    }

    /// Returns the facts that the checker needs in addition to the history: the run's report and the expected
    /// events.
    pub fn facts(&self, spec: &Spec) -> Facts {
        let expect = &spec.expect;
        let seen = self.outputs();
        let mut facts = Facts {
            ticks: (expect.exit_code == 0).then_some(spec.run.ticks),
            held_max_ns: spec.held_max_ns(),
            targets: spec.faults.targets.iter().map(|stage| stage.name().to_owned()).collect(),
            restarts_of_others: expect.restarts_of_others,
            leftovers: expect.leftovers,
            reported: self.report.is_some(),
            recorded_alone: self.recorded.iter().copied().filter(|tick| !seen.0.contains_key(tick)).collect(),
            off_path_topics: self.off_path_topics.clone(),
            files_left: self.leftovers,
            stages_left: self.survivors,
            ..Facts::default()
        };
        let Some(report) = &self.report else { return facts };
        facts.lockstep = report.run.lockstep.unwrap_or(false);
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
        facts.outages = report.supervision.outages.iter().chain(replaced).map(outage).collect();
        facts.outages_unlisted = report.supervision.outages_unlisted;
        let lost = |stage: &recorder::report::StageReport| {
            (stage.name.clone(), stage.drops.gap + stage.drops.refused)
        };
        facts.lost = report.stages.iter().map(lost).collect();
        let unanswered = report.stages.iter().map(|stage| (stage.name.clone(), stage.drops.unanswered));
        facts.unanswered = unanswered.collect();
        facts.causes.clone_from(&report.forecasts.causes);
        facts.late_ticks = report.late_ticks;
        facts
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
