//! The differences between the reports of two runs: figures, agents, and the worst forecast of each agent.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use recorder::Report;
use recorder::report::{AgentErrors, Errors};
use serde::Serialize;

use crate::differences::columns;

/// Maximum number of agents listed as text; JSON lists all.
const LISTED_MAX: usize = 12;
/// Errors are reported with a resolution of 0.1 mm.
const SAME_M: f64 = 1e-4;

/// Two reports compared.
#[derive(Debug, Serialize)]
pub struct ReportComparison {
    /// Differences in the runs' inputs: the name, and the values in A and in B.
    pub runs: Vec<(&'static str, String, String)>,
    /// Whether both runs played the same recording or generated scene. Otherwise agents of A and B do not
    /// correspond.
    pub same_scene: bool,
    /// All figures that A or B has.
    pub figures: Vec<FigureChange>,
    /// Agents in both reports whose errors differ, with the greatest change of minFDE first.
    pub agents: Vec<AgentChange>,
    /// Number of agents in both reports whose errors are equal.
    pub agents_alike: u64,
    /// Number of agents that only A or only B has, listed or not.
    pub agents_alone: [u64; 2],
}

/// A figure of two reports.
#[derive(Debug, PartialEq, Serialize)]
pub struct FigureChange {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: &'static str,
    /// In A.
    pub a: Option<f64>,
    /// In B.
    pub b: Option<f64>,
    /// Whether the figure depends on the clock, so that it differs between any two runs.
    pub of_the_clock: bool,
}

/// The errors of an agent in two reports.
#[derive(Debug, PartialEq, Serialize)]
pub struct AgentChange {
    /// In A.
    pub a: AgentErrors,
    /// In B.
    pub b: AgentErrors,
}

impl FigureChange {
    fn differs(&self) -> bool {
        self.a != self.b
    }
}

impl AgentChange {
    /// The change of minFDE from A to B.
    fn change_m(&self) -> f64 {
        self.b.fde_m.unwrap_or(0.0) - self.a.fde_m.unwrap_or(0.0)
    }

    fn differs(&self) -> bool {
        let apart = |a: Option<f64>, b: Option<f64>| (a.unwrap_or(0.0) - b.unwrap_or(0.0)).abs() >= SAME_M;
        let Self { a, b } = self;
        a.forecasts != b.forecasts || apart(a.fde_m, b.fde_m) || apart(a.ade_m, b.ade_m)
    }
}

impl ReportComparison {
    /// Compares two reports.
    pub fn of(a: &Report, b: &Report) -> Self {
        let same_scene = scene(a) == scene(b);
        let mut agents: Vec<AgentChange> = Vec::new();
        let (mut agents_alike, mut agents_alone) = (0, [0, 0]);
        if same_scene {
            let mut of_b: BTreeMap<u64, &AgentErrors> =
                b.accuracy.agents.iter().map(|agent| (agent.agent, agent)).collect();
            for a in &a.accuracy.agents {
                match of_b.remove(&a.agent).map(|b| AgentChange { a: a.clone(), b: b.clone() }) {
                    Some(change) if change.differs() => agents.push(change),
                    Some(_) => agents_alike += 1,
                    None => agents_alone[0] += 1,
                }
            }
            agents_alone[0] += a.accuracy.agents_unlisted;
            agents_alone[1] = of_b.len() as u64 + b.accuracy.agents_unlisted;
            agents.sort_by(|x, y| y.change_m().abs().total_cmp(&x.change_m().abs()));
        }
        Self { runs: runs(a, b), same_scene, figures: figures(a, b), agents, agents_alike, agents_alone }
    }

    /// Whether everything is equal except figures that depend on the clock.
    pub fn is_equal(&self) -> bool {
        let same = |figure: &FigureChange| figure.of_the_clock || !figure.differs();
        self.same_scene
            && self.figures.iter().all(same)
            && self.agents.is_empty()
            && self.agents_alone == [0, 0]
    }

    /// Formats the comparison as text.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for (what, a, b) in &self.runs {
            // Writing to a string does not fail.
            let _ = writeln!(text, "  the runs differ in {what}: {a} and {b}");
        }
        let differing: Vec<&FigureChange> = self.figures.iter().filter(|figure| figure.differs()).collect();
        let mut rows = vec![["figure", "A", "B", "change", ""].map(str::to_owned).to_vec()];
        rows.extend(differing.iter().map(|figure| figure_row(figure)));
        if rows.len() > 1 {
            text += &columns(&rows, &[0]);
        }
        let same = self.figures.len() - differing.len();
        let _ = writeln!(text, "{same} of {} figures are the same", self.figures.len());
        text + &self.agents_text()
    }

    fn agents_text(&self) -> String {
        if !self.same_scene {
            return "other scenes: no agent of one is that of the other\n".to_owned();
        }
        let [only_a, only_b] = self.agents_alone;
        let mut text = format!(
            "agents: {} with other errors, {} with the same, {only_a} in A alone, {only_b} in B alone\n",
            self.agents.len(),
            self.agents_alike
        );
        if self.agents.is_empty() {
            return text;
        }
        let head =
            ["agent", "type", "forecasts", "minFDE A", "B", "change m", "worst forecast of the worse run"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        rows.extend(self.agents.iter().take(LISTED_MAX).map(agent_row));
        text += &columns(&rows, &[1, 6]);
        if self.agents.len() > LISTED_MAX {
            let _ = writeln!(text, "  … and {} more: --json has all", self.agents.len() - LISTED_MAX);
        }
        text
    }
}

fn figure_row(figure: &FigureChange) -> Vec<String> {
    let shown = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| number(value, figure.unit));
    let (change, percent) = match (figure.a, figure.b) {
        (Some(a), Some(b)) => {
            let percent = if a == 0.0 { String::new() } else { format!("{:+.1} %", 100.0 * (b - a) / a) };
            let sign = if b > a { "+" } else { "" };
            (sign.to_owned() + &number(b - a, figure.unit), percent)
        }
        _ => (String::new(), String::new()),
    };
    let name = if figure.unit.is_empty() {
        figure.name.clone()
    } else {
        format!("{}, {}", figure.name, figure.unit)
    };
    vec![name, shown(figure.a), shown(figure.b), change, percent]
}

fn number(value: f64, unit: &str) -> String {
    match unit {
        "" => format!("{value:.0}"),
        "m" => format!("{value:.4}"),
        "%" => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

fn agent_row(change: &AgentChange) -> Vec<String> {
    let AgentChange { a, b } = change;
    let forecasts = if a.forecasts == b.forecasts {
        a.forecasts.to_string()
    } else {
        format!("{} / {}", a.forecasts, b.forecasts)
    };
    let (name, worst) = if change.change_m() > 0.0 { ("B", b.worst) } else { ("A", a.worst) };
    let metres = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| format!("{value:.3}"));
    vec![
        a.agent.to_string(),
        b.agent_type.clone(),
        forecasts,
        metres(a.fde_m),
        metres(b.fde_m),
        format!("{:+.3}", change.change_m()),
        format!(
            "{name}: tick {}, at {:.2} s, x {:.1} m, y {:.1} m: {:.2} m",
            worst.tick,
            worst.stamp_ns as f64 / 1e9,
            worst.x_m,
            worst.y_m,
            worst.fde_m
        ),
    ]
}

/// Returns the values that identify the scene of a run. Agents of the same scene have the same ids.
fn scene(report: &Report) -> [String; 5] {
    let run = &report.run;
    let seed = if run.recording_sha256.is_some() { None } else { run.seed };
    [
        format!("{:?}", run.recording),
        format!("{:?}", run.recording_sha256),
        format!("{:?}", run.thinned_by),
        format!("{seed:?}"),
        format!("{:?}", run.scene_agents),
    ]
}

fn runs(a: &Report, b: &Report) -> Vec<(&'static str, String, String)> {
    let inputs = |report: &Report| {
        let run = &report.run;
        let text = |value: &Option<String>| value.clone().unwrap_or_else(|| "unknown".to_owned());
        let seed = run.seed.map_or_else(|| "unknown".to_owned(), |seed| seed.to_string());
        let agents = run.scene_agents.map_or_else(|| "recorded".to_owned(), |agents| agents.to_string());
        let noise = run.scene_noise.map_or_else(|| "unknown".to_owned(), |noise| noise.line());
        let switch = |value: Option<bool>| {
            value.map_or("unknown", |value| if value { "yes" } else { "no" }).to_owned()
        };
        [
            ("recording", text(&run.recording)),
            ("the recording's SHA-256", text(&run.recording_sha256)),
            ("agents of the scene", agents),
            ("detector noise", noise),
            ("seed", seed),
            ("weights", text(&run.weights_sha256)),
            ("retrieval", switch(run.retrieval)),
            ("speed", text(&run.speed)),
            ("program", report.stgdat_version.clone()),
        ]
    };
    let pairs = inputs(a).into_iter().zip(inputs(b));
    pairs.filter(|((_, a), (_, b))| a != b).map(|((what, a), (_, b))| (what, a, b)).collect()
}

/// Returns the figures of both reports, in the order of the first report.
fn figures(a: &Report, b: &Report) -> Vec<FigureChange> {
    let (of_a, mut of_b) = (figures_of(a), figures_of(b));
    let mut all: Vec<FigureChange> = Vec::new();
    for (name, unit, of_the_clock, a) in of_a {
        let place = of_b.iter().position(|(other, ..)| *other == name);
        let b = place.and_then(|place| of_b.remove(place).3);
        all.push(FigureChange { name, unit, a, b, of_the_clock });
    }
    let alone = of_b.into_iter();
    all.extend(alone.map(|(name, unit, of_the_clock, b)| FigureChange {
        name,
        unit,
        a: None,
        b,
        of_the_clock,
    }));
    all
}

/// Name, unit, whether it depends on the clock, and value.
type Figure = (String, &'static str, bool, Option<f64>);

fn figures_of(report: &Report) -> Vec<Figure> {
    // In lockstep the clock affects only times.
    let by_clock = report.run.lockstep != Some(true);
    let count = |name: &str, value: u64| (name.to_owned(), "", by_clock, Some(value as f64));
    let forecasts = &report.forecasts;
    let accuracy = &report.accuracy;
    let draws = accuracy.draws.unwrap_or(0);
    let mut all = vec![
        count("ticks", report.ticks),
        ("late ticks".to_owned(), "", true, Some(report.late_ticks as f64)),
        count("frames lost", report.drops),
    ];
    all.extend(forecasts.by_quality().map(|(name, value)| count(&format!("forecasts, {name}"), value)));
    all.extend(
        forecasts.causes.iter().map(|(name, value)| count(&format!("held or kinematic: {name}"), *value)),
    );
    all.push(count("ticks, degraded", forecasts.degraded_ticks));
    all.push(count("forecasts outside of what was trained", report.out_of_distribution.forecasts));
    all.extend(errors("", draws, &accuracy.errors, by_clock));
    all.extend(errors(", learned", draws, &accuracy.learned, by_clock));
    for (name, of_type) in &accuracy.by_type {
        all.extend(errors(&format!(", {name}"), draws, of_type, by_clock));
    }
    for (name, times) in [("end to end", &report.end_to_end_ms), ("overhead", &report.overhead_ms)] {
        all.extend(
            [("p50", times.p50), ("p99", times.p99)]
                .map(|(quantile, value)| (format!("{name}, {quantile}"), "ms", true, value)),
        );
    }
    for stage in &report.stages {
        let times = [("p50", stage.compute_ms.p50), ("p99", stage.compute_ms.p99)];
        all.extend(
            times
                .map(|(quantile, value)| (format!("{} computes, {quantile}", stage.name), "ms", true, value)),
        );
    }
    all
}

/// Returns the error figures of a group.
fn errors(of: &str, draws: u32, errors: &Errors, by_clock: bool) -> [Figure; 8] {
    let percent = |share: Option<f64>| share.map(|share| 100.0 * share);
    [
        ("forecasts scored".to_owned(), "", Some(errors.forecasts as f64)),
        (format!("minADE (K = {draws})"), "m", errors.ade_m),
        (format!("minFDE (K = {draws})"), "m", errors.fde_m),
        ("miss rate".to_owned(), "%", percent(errors.miss_rate)),
        ("ADE (K = 1)".to_owned(), "m", errors.single_ade_m),
        ("FDE (K = 1)".to_owned(), "m", errors.single_fde_m),
        ("coverage of the 50 % region".to_owned(), "%", percent(errors.held_50)),
        ("coverage of the 90 % region".to_owned(), "%", percent(errors.held_90)),
    ]
    .map(|(name, unit, value)| (name + of, unit, by_clock, value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use recorder::report::{Accuracy, WorstForecast};

    fn report(weights: &str, agents: &[(u64, f64)]) -> Report {
        let mut report = Report::default();
        report.run.seed = Some(3);
        report.run.lockstep = Some(true);
        report.run.weights_sha256 = Some(weights.to_owned());
        let agents = agents.iter().map(|(agent, fde_m)| AgentErrors {
            agent: *agent,
            agent_type: "vehicle".to_owned(),
            forecasts: 40,
            ade_m: Some(fde_m / 2.0),
            fde_m: Some(*fde_m),
            worst: WorstForecast { tick: 7, stamp_ns: 560_000_000, x_m: 1.5, y_m: -2.0, fde_m: 2.0 * fde_m },
        });
        let errors = Errors { forecasts: 80, fde_m: Some(1.0), ..Errors::default() };
        report.accuracy =
            Accuracy { errors, agents: agents.collect(), draws: Some(20), ..Accuracy::default() };
        report
    }

    #[test]
    fn the_agent_whose_error_changes_most_is_named_first_with_its_place() {
        let a = report("aa", &[(1, 1.0), (2, 1.0), (5, 3.0), (6, 1.0)]);
        let mut b = report("bb", &[(1, 1.1), (2, 1.0), (5, 0.5), (9, 1.0)]);
        b.accuracy.errors.fde_m = Some(0.8);
        let compared = ReportComparison::of(&a, &b);
        assert!(!compared.is_equal());
        assert_eq!(compared.agents.iter().map(|change| change.a.agent).collect::<Vec<_>>(), [5, 1]);
        assert_eq!((compared.agents_alike, compared.agents_alone), (1, [1, 1]));
        let text = compared.text();
        let lines: Vec<String> =
            text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
        for line in [
            "the runs differ in weights: aa and bb",
            "minFDE (K = 20), m 1.0000 0.8000 -0.2000 -20.0 %",
            "5 vehicle 40 3.000 0.500 -2.500 A: tick 7, at 0.56 s, x 1.5 m, y -2.0 m: 6.00 m",
            "1 vehicle 40 1.000 1.100 +0.100 B: tick 7, at 0.56 s, x 1.5 m, y -2.0 m: 2.20 m",
        ] {
            assert!(lines.iter().any(|found| found == line), "no {line:?}:\n{text}");
        }
    }

    #[test]
    fn reports_of_one_run_are_equal_but_for_the_clock() {
        let a = report("aa", &[(1, 1.0)]);
        let mut b = a.clone();
        b.end_to_end_ms.p50 = Some(3.0);
        assert!(ReportComparison::of(&a, &b).is_equal());
        b.forecasts.held = 1;
        assert!(!ReportComparison::of(&a, &b).is_equal());
    }

    #[test]
    fn agents_of_other_scenes_are_not_paired() {
        let a = report("aa", &[(1, 1.0)]);
        let mut b = report("aa", &[(1, 2.0)]);
        b.run.seed = Some(4);
        let compared = ReportComparison::of(&a, &b);
        assert!(compared.agents.is_empty() && !compared.is_equal());
        assert!(compared.text().contains("no agent of one is that of the other"));
    }
}
