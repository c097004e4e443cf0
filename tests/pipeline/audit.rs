//! Inputs that look wrong: the findings of `inspect`, `predict`, `track` and `run`, and their exit codes.

use std::fmt::Write as _;
use testing::Scratch;

use crate::started::{run, run_well, stderr, stdout};

/// Two cars in two directions for 10 s. Headings are multiplied by `unit`, and stamps by `per_s`.
fn cars(scratch: &Scratch, name: &str, unit: f64, per_s: f64) -> String {
    let mut text = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n".to_owned();
    for step in 0..100 {
        let way_m = 0.8 * f64::from(step);
        let stamp = per_s * f64::from(step) / 10.0;
        let north = unit * std::f64::consts::FRAC_PI_2;
        let written =
            writeln!(text, "{stamp},1,vehicle,{way_m:.2},0,0,8\n{stamp},2,vehicle,5,{way_m:.2},{north:.4},8");
        written.expect("writing to a string does not fail");
    }
    scratch.file(name, text)
}

fn report(scratch: &Scratch, name: &str) -> serde_json::Value {
    serde_json::from_slice(&scratch.read(name)).expect("a report is JSON")
}

#[test]
fn headings_in_degrees_are_doubted_by_every_verb() {
    let scratch = Scratch::new("audit-degrees");
    let degrees = cars(&scratch, "degrees.csv", 57.29578, 1.0);
    let words = "headings look like degrees: divide them by 57.29578 (100 of 200 rows, 50.0 %; first: ";
    let inspected = stdout(&run_well(&["inspect", &degrees, "--out", &scratch.path("scene.svg")]));
    assert!(inspected.contains(&format!("{words}{degrees}:3)")), "{inspected}");
    assert!(inspected.ends_with(&format!("stgdat run --recording {degrees}\n")), "{inspected}");
    assert!(scratch.read("scene.svg").starts_with(b"<svg"));
    for verb in ["predict", "track"] {
        let file = scratch.path("report.json");
        let played = run_well(&[verb, &degrees, "--out", &scratch.path("out"), "--report", &file]);
        assert!(
            stderr(&played).contains(words) && stderr(&played).contains("DOUBTFUL"),
            "{}",
            stderr(&played)
        );
        let report = report(&scratch, "report.json");
        assert_eq!(report["verdict"]["status"], "doubtful");
        assert_eq!(report["input"]["findings"][0]["kind"], "headings_in_degrees");
        let strict = run(&[verb, &degrees, "--out", &scratch.path("out"), "--strict"]);
        assert_eq!(strict.status.code(), Some(65), "{}", stderr(&strict));
    }
    let file = scratch.path("run.json");
    let played = run(&["run", "--recording", &degrees, "--speed", "max", "--report", &file, "--strict"]);
    assert_eq!(played.status.code(), Some(65), "{}", stderr(&played));
    assert!(
        stdout(&played).contains(" DOUBTFUL    input: headings look like degrees"),
        "{}",
        stdout(&played)
    );
    let report = report(&scratch, "run.json");
    assert_eq!(report["verdict"]["status"], "doubtful");
    assert_eq!(report["input"]["findings"][0]["first"], format!("{degrees}:3"));
}

#[test]
fn a_clean_recording_is_ok_with_strict() {
    let scratch = Scratch::new("audit-clean");
    let clean = cars(&scratch, "clean.csv", 1.0, 1.0);
    let inspected = run_well(&["inspect", &clean, "--strict", "--json"]);
    let inspected: serde_json::Value = serde_json::from_str(&stdout(&inspected)).expect("JSON");
    assert_eq!(inspected["findings"], serde_json::json!([]));
    assert_eq!((&inspected["rows"], &inspected["types"][0]["agents"]), (&200.into(), &2.into()));
    let predicted = run_well(&["predict", &clean, "--out", &scratch.path("out"), "--strict"]);
    assert_eq!(stderr(&predicted), "");
}

#[test]
fn stamps_in_milliseconds_are_never_ok() {
    let scratch = Scratch::new("audit-ms");
    let milliseconds = cars(&scratch, "ms.csv", 1.0, 1e3);
    let file = scratch.path("report.json");
    let played = run_well(&["predict", &milliseconds, "--out", &scratch.path("out"), "--report", &file]);
    assert!(stderr(&played).contains("stamps look like milliseconds"), "{}", stderr(&played));
    let status = &report(&scratch, "report.json")["verdict"]["status"];
    assert!(["empty", "doubtful", "degraded"].contains(&status.as_str().expect("a word")), "{status}");
    assert_eq!(run(&["inspect", &milliseconds, "--strict"]).status.code(), Some(65));
}
