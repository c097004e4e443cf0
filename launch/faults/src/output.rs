//! Verdicts as a table, as JUnit's XML and as JSON.

use std::fmt::Write as _;

use crate::runner::Verdict;
use crate::verdict::{Check, Outcome};

/// Formats the verdict for a terminal: one line per expectation, with the finding.
pub fn table(verdict: &Verdict) -> String {
    let word = if verdict.passed { "pass" } else { "FAIL" };
    let mut text = format!("{word}  {}: {}\n", verdict.name, verdict.shows);
    let width = verdict.checks.iter().map(|check| check.what.chars().count()).max().unwrap_or(0);
    for Check { what, expected, found, outcome } in &verdict.checks {
        let mark = match outcome {
            Outcome::Ok => "ok",
            Outcome::Failed => "FAILED",
            Outcome::NotAsserted => "not asserted",
        };
        let _ = writeln!(text, "      {what:width$}  {found}  (expected {expected})  {mark}");
    }
    let cost = &verdict.cost;
    let to_learned = cost.to_learned.map_or_else(|| "never".to_owned(), |ticks| ticks.to_string());
    let _ = writeln!(
        text,
        "      {} ticks, lost {}, longest hole {}, not learned {}, to learned again {to_learned}; {:.1} s",
        cost.ticks, cost.lost, cost.hole, cost.not_learned, verdict.seconds
    );
    for (kind, count) in &cost.injected {
        let _ = writeln!(text, "      injected into {kind}, {count} frames");
    }
    for (topic, [p50, max]) in &cost.injector_us {
        let _ = writeln!(text, "      injector on {topic}: {p50} µs a frame, at most {max} µs");
    }
    if let Some(kept) = &verdict.kept {
        let _ = writeln!(text, "      kept in {}", kept.display());
    }
    if !verdict.passed {
        let _ = writeln!(text, "      again: {}", verdict.repeat);
    }
    text
}

/// Verdicts as JUnit's XML.
pub fn junit(verdicts: &[Verdict]) -> String {
    let failures = verdicts.iter().filter(|verdict| !verdict.passed).count();
    let seconds: f64 = verdicts.iter().map(|verdict| verdict.seconds).sum();
    let mut text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuite name=\"faults\" tests=\"{}\" failures=\"{failures}\" \
         time=\"{seconds:.3}\">\n",
        verdicts.len()
    );
    for verdict in verdicts {
        let name = escaped(&verdict.name);
        let _ =
            write!(text, "  <testcase name=\"{name}\" classname=\"faults\" time=\"{:.3}\"", verdict.seconds);
        if verdict.passed {
            text += "/>\n";
            continue;
        }
        let failed = verdict.checks.iter().filter(|check| check.outcome == Outcome::Failed);
        let lines: Vec<String> = failed
            .map(|Check { what, expected, found, .. }| format!("{what}: {found}, expected {expected}"))
            .collect();
        let (first, all) = (lines.first().map_or("", String::as_str), lines.join("\n"));
        let _ = write!(
            text,
            ">\n    <failure message=\"{}\">{}\n{}</failure>\n  </testcase>\n",
            escaped(first),
            escaped(&all),
            escaped(&verdict.repeat)
        );
    }
    text + "</testsuite>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::Cost;

    fn verdict(passed: bool) -> Verdict {
        let outcome = if passed { Outcome::Ok } else { Outcome::Failed };
        let (what, expected, found) = ("ended by".to_owned(), "\"a\" & b".to_owned(), "<nothing>".to_owned());
        Verdict {
            name: "01-kill".into(),
            shows: "a stage is killed".into(),
            passed,
            checks: vec![Check { what, expected, found, outcome }],
            cost: Cost::default(),
            seconds: 1.5,
            repeat: "stgdat fault run a.toml --seed 3".into(),
            kept: None,
        }
    }

    #[test]
    fn junit_counts_failures_and_escapes_their_text() {
        let xml = junit(&[verdict(true), verdict(false)]);
        let tree = roxmltree::Document::parse(&xml).expect("well-formed XML");
        let suite = tree.root_element();
        assert_eq!((suite.attribute("tests"), suite.attribute("failures")), (Some("2"), Some("1")));
        let failure = tree.descendants().find(|node| node.has_tag_name("failure")).expect("a failure");
        assert_eq!(failure.attribute("message"), Some("ended by: <nothing>, expected \"a\" & b"));
        assert!(failure.text().is_some_and(|text| text.ends_with("--seed 3")), "{xml}");
    }

    #[test]
    fn a_failure_shows_how_to_repeat_it() {
        assert!(!table(&verdict(true)).contains("again:"));
        let text = table(&verdict(false));
        assert!(
            text.starts_with("FAIL  01-kill") && text.contains("again: stgdat fault run a.toml --seed 3"),
            "{text}"
        );
    }
}
