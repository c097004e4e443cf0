//! `--fail-if`: conditions on the figures of a report. They make a user's script fail if a run was too slow
//! or too inaccurate.
//!
//! A condition is `FIGURE COMPARISON NUMBER UNIT`, such as `end_to_end_p99 > 75 ms`.

use std::fmt;
use std::str::FromStr;

use recorder::Report;
use thiserror::Error;
use wire::StageId;

use console::failure::Failure;

/// Why a text is not a valid condition.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ConditionError {
    /// The comparison is missing.
    #[error(
        "expected FIGURE COMPARISON NUMBER UNIT, such as `end_to_end_p99 > 75 ms`; comparisons are >, >=, < and <="
    )]
    NoComparison,
    /// The figure is unknown.
    #[error("there is no figure \"{name}\": expected {}", known())]
    UnknownFigure {
        /// The name as written.
        name: String,
    },
    /// The bound is not a number.
    #[error("\"{text}\" is no number")]
    NotANumber {
        /// The bound as written.
        text: String,
    },
    /// The unit is missing or does not fit the figure.
    #[error("{figure} is not measured in \"{unit}\": expected {}", expected.join(", "))]
    Unit {
        /// The figure.
        figure: String,
        /// The unit as written.
        unit: String,
        /// The valid units of the figure.
        expected: Vec<&'static str>,
    },
}

/// A condition under which a run has failed.
#[derive(Clone, Debug)]
pub struct Condition {
    figure: String,
    comparison: fn(&f64, &f64) -> bool,
    /// In the figure's first unit.
    bound: f64,
    /// The condition as written.
    text: String,
}

/// Units with their size relative to the first one. The report states the figure in the first unit.
type Units = &'static [(&'static str, f64)];

const TIMES: Units = &[("ms", 1.0), ("us", 1e-3), ("s", 1e3)];
const SHARES: Units = &[("%", 0.01)];
const LENGTHS: Units = &[("m", 1.0), ("cm", 0.01)];
const COUNTS: Units = &[("", 1.0)];

/// A figure's value in a report; `None` if the run was too short to measure it.
type Value = fn(&Report) -> Option<f64>;

/// The figures that are not times.
const PLAIN: [(&str, Units, Value); 12] = [
    ("late_ticks", COUNTS, |r| Some(r.late_ticks as f64)),
    ("late_share", SHARES, |r| share(r.late_ticks, r.ticks)),
    ("degraded_ticks", COUNTS, |r| Some(r.forecasts.degraded_ticks as f64)),
    ("held_share", SHARES, |r| share(r.forecasts.held, forecasts(r))),
    ("kinematic_share", SHARES, |r| share(r.forecasts.kinematic, forecasts(r))),
    ("lost_frames", COUNTS, |r| Some(r.drops as f64)),
    ("restarts", COUNTS, |r| Some(r.stages.iter().map(|stage| f64::from(stage.restarts)).sum())),
    ("page_faults", COUNTS, page_faults),
    ("min_ade", LENGTHS, |r| r.accuracy.errors.ade_m),
    ("min_fde", LENGTHS, |r| r.accuracy.errors.fde_m),
    ("ade", LENGTHS, |r| r.accuracy.errors.single_ade_m),
    ("fde", LENGTHS, |r| r.accuracy.errors.single_fde_m),
];

fn share(part: u64, whole: u64) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

fn forecasts(report: &Report) -> u64 {
    let counts = &report.forecasts;
    counts.learned + counts.held + counts.kinematic
}

/// Page faults of the stages on a tick's way to its forecast, without their first ticks.
fn page_faults(report: &Report) -> Option<f64> {
    let memory = &report.supervision.memory;
    let on_the_way = memory.iter().filter(|(name, _)| **name != StageId::Recorder.name());
    (!memory.is_empty())
        .then(|| on_the_way.map(|(_, stage)| (stage.minor_faults + stage.major_faults) as f64).sum())
}

/// Lists the names of all figures, as part of a sentence.
fn known() -> String {
    let stages = StageId::ALL.map(StageId::name).join(", ");
    let plain = PLAIN.map(|(name, ..)| name).join(", ");
    format!(
        "end_to_end_Q, overhead_Q, STAGE_Q (compute) with Q = p50, p99, p999 or max and STAGE = {stages}; {plain}"
    )
}

/// The units of the figure with this name, and its value in a report; `None` if there is no such figure.
fn figure(name: &str, report: &Report) -> Option<(Units, Option<f64>)> {
    if let Some((_, units, value)) = PLAIN.iter().find(|(plain, ..)| *plain == name) {
        return Some((units, value(report)));
    }
    let (of, quantile) = name.rsplit_once('_')?;
    let times_ms = match of {
        "end_to_end" => report.end_to_end_ms,
        "overhead" => report.overhead_ms,
        stage => {
            let name = StageId::from_name(stage)?.name();
            report
                .stages
                .iter()
                .find(|stage| stage.name == name)
                .map(|stage| stage.compute_ms)
                .unwrap_or_default()
        }
    };
    let value = match quantile {
        "p50" => times_ms.p50,
        "p99" => times_ms.p99,
        "p999" => times_ms.p999,
        "max" => times_ms.max,
        _ => return None,
    };
    Some((TIMES, value))
}

impl FromStr for Condition {
    type Err = ConditionError;

    fn from_str(text: &str) -> Result<Self, ConditionError> {
        let at = text.find(['>', '<']).ok_or(ConditionError::NoComparison)?;
        let (name, rest) = (text[..at].trim(), &text[at + 1..]);
        let (rest, or_equal) = rest.strip_prefix('=').map_or((rest, false), |rest| (rest, true));
        let comparison: fn(&f64, &f64) -> bool = match (text.as_bytes()[at], or_equal) {
            (b'>', false) => f64::gt,
            (b'>', true) => f64::ge,
            (_, false) => f64::lt,
            (_, true) => f64::le,
        };
        let (units, _) = figure(name, &Report::default())
            .ok_or_else(|| ConditionError::UnknownFigure { name: name.to_owned() })?;
        let rest = rest.trim();
        let number_len =
            rest.find(|c: char| !(c.is_ascii_digit() || ".-+".contains(c))).unwrap_or(rest.len());
        let (number, unit) = (&rest[..number_len], rest[number_len..].trim());
        let number: f64 = number.parse().map_err(|_| ConditionError::NotANumber { text: rest.to_owned() })?;
        let size = units.iter().find(|(name, _)| *name == unit).map(|(_, size)| *size);
        let size = size.ok_or_else(|| ConditionError::Unit {
            figure: name.to_owned(),
            unit: unit.to_owned(),
            expected: units.iter().map(|&(name, _)| if name.is_empty() { "no unit" } else { name }).collect(),
        })?;
        Ok(Self { figure: name.to_owned(), comparison, bound: number * size, text: text.trim().to_owned() })
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Condition {
    /// Describes why the report fails the check: the condition holds, or it can't be evaluated.
    fn verdict(&self, report: &Report) -> Option<String> {
        let (units, value) = figure(&self.figure, report)?;
        let Some(value) = value else {
            return Some(format!("--fail-if '{self}': the run was too short to measure it"));
        };
        let (unit, size) = units[0];
        let shown = format!("{:.3}", value / size);
        let shown = shown.trim_end_matches('0').trim_end_matches('.');
        let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
        (self.comparison)(&value, &self.bound).then(|| format!("--fail-if '{self}': it is {shown}{unit}"))
    }
}

/// Fails if a condition holds for the report or can't be evaluated.
///
/// # Errors
/// [`Failure::Failed`] lists all of these conditions.
pub fn check(conditions: &[Condition], report: &Report) -> Result<(), Failure> {
    let failed: Vec<String> = conditions.iter().filter_map(|condition| condition.verdict(report)).collect();
    if failed.is_empty() { Ok(()) } else { Err(Failure::Failed(failed.join("\n"))) }
}

#[cfg(test)]
mod tests {
    use recorder::StageMemory;
    use recorder::report::{Percentiles, StageReport};

    use super::*;

    fn report() -> Report {
        let times = |p50, p99| Percentiles { p50: Some(p50), p99: Some(p99), p999: None, max: Some(90.0) };
        let decoder =
            StageReport { name: "decoder".into(), compute_ms: times(9.0, 12.0), ..Default::default() };
        let mut report = Report {
            ticks: 200,
            late_ticks: 1,
            end_to_end_ms: times(14.0, 80.5),
            stages: vec![decoder],
            ..Report::default()
        };
        report.accuracy.errors.ade_m = Some(0.31);
        report
    }

    fn judged(text: &str) -> Option<String> {
        text.parse::<Condition>().unwrap_or_else(|error| panic!("{text}: {error}")).verdict(&report())
    }

    #[test]
    fn conditions_that_hold_are_told_with_the_figure() {
        let told = judged("end_to_end_p99 > 75 ms").unwrap();
        assert_eq!(told, "--fail-if 'end_to_end_p99 > 75 ms': it is 80.5 ms");
        assert_eq!(judged("late_share>=0.5%").unwrap(), "--fail-if 'late_share>=0.5%': it is 0.5 %");
        assert_eq!(judged("late_ticks > 0").unwrap(), "--fail-if 'late_ticks > 0': it is 1");
        assert_eq!(judged("min_ade >30cm").unwrap(), "--fail-if 'min_ade >30cm': it is 0.31 m");
        for passed in
            ["end_to_end_p99 > 0.0806 s", "decoder_p99 > 12 ms", "decoder_p50 < 9000us", "late_ticks <= 0"]
        {
            assert_eq!(judged(passed), None, "{passed}");
        }
    }

    #[test]
    fn what_was_not_measured_fails() {
        for text in ["end_to_end_p999 > 1 s", "encoder_p50 > 1 s", "page_faults > 0", "fde > 9 m"] {
            assert!(judged(text).unwrap().ends_with("the run was too short to measure it"), "{text}");
        }
    }

    #[test]
    fn faults_of_the_recorder_hold_up_no_forecast() {
        let mut report = report();
        let memory = |minor_faults| StageMemory { ticks: 50, minor_faults, ..StageMemory::default() };
        report.supervision.memory =
            [("recorder".to_owned(), memory(90)), ("sampler".to_owned(), memory(2))].into();
        let condition: Condition = "page_faults > 1".parse().unwrap();
        assert_eq!(condition.verdict(&report).unwrap(), "--fail-if 'page_faults > 1': it is 2");
    }

    #[test]
    fn wrong_conditions_are_refused() {
        let refused = |text: &str| text.parse::<Condition>().unwrap_err().to_string();
        for (text, message) in [
            ("p99", "expected FIGURE COMPARISON NUMBER UNIT"),
            ("end_to_end_p99 = 3 ms", "expected FIGURE COMPARISON NUMBER UNIT"),
            ("p99 > 75 ms", "there is no figure \"p99\": expected end_to_end_Q"),
            ("radar_p99 > 75 ms", "there is no figure \"radar_p99\""),
            ("end_to_end_p99 > fast", "\"fast\" is no number"),
            ("end_to_end_p99 >", "\"\" is no number"),
            ("end_to_end_p99 > 75", "end_to_end_p99 is not measured in \"\": expected ms, us, s"),
            ("late_ticks > 3 ms", "late_ticks is not measured in \"ms\": expected no unit"),
            ("late_share > 3", "late_share is not measured in \"\": expected %"),
            ("end_to_end_p99 > 1 ms > 2 ms", "is not measured in \"ms > 2 ms\""),
        ] {
            assert!(refused(text).contains(message), "{text}: {}", refused(text));
        }
    }
}
