//! `stgdat stage replace`: stages are replaced in a running pipeline, and broken replacements are not used.

use serde_json::Value;
use testing::Scratch;

use crate::programs::example;
use crate::started::{Started, assert_nothing_left, run, stderr, stdout};

/// Replaces a stage of the run in this folder. Returns the verb's exit code and its output.
fn replace(root: &std::path::Path, stage: &str, arguments: &[&str]) -> (Option<i32>, String) {
    let root = root.display().to_string();
    let output = run(&[&["stage", "replace", stage, "--run", &root][..], arguments].concat());
    (output.status.code(), stdout(&output) + &stderr(&output))
}

#[test]
fn a_stage_is_replaced_by_another_program_and_back() {
    let scratch = Scratch::new("replace");
    let report = scratch.path("report.json");
    let run = Started::run(&["--ticks", "170", "--agents", "6", "--report", &report]);
    let root = run.wait_until_it_forecasts();

    let area = example("area_localiser");
    let (code, told) = replace(&root, "localiser", &["--set", "radius_m=40", "--exec", &area]);
    assert_eq!(code, Some(0), "{told}");
    let name = root.file_name().and_then(|name| name.to_str()).expect("a run has a name");
    assert!(told.starts_with(&format!("{name}: ")), "the run that was chosen: {told}");
    assert!(told.contains("the localiser is replaced by") && told.contains("handed over in"), "{told}");
    let is_there = run.stages().iter().any(|(_, line)| line.first() == Some(&area));
    assert!(is_there, "{:?}", run.stages());
    let (code, told) = replace(&root, "localiser", &["--set", "map=none"]);
    assert_eq!(code, Some(0), "{told}");
    assert!(told.contains("by the built-in one"), "{told}");

    for (stage, command, cause) in [
        ("encoder", &["sh", "-c", "exit 3"][..], "ended with exit code 3"),
        ("encoder", &["/dev/null"][..], "/dev/null"),
        ("recorder", &["sh", "-c", "echo why >&2; exit 78"][..], "ended with exit code 78"),
    ] {
        let (code, told) = replace(&root, stage, &[&["--exec"][..], command].concat());
        assert_ne!(code, Some(0), "{told}");
        assert!(told.contains(cause), "{told}");
    }
    let (code, told) = replace(&root, "localiser", &["--set", "radius_m=40"]);
    assert_eq!(code, Some(70), "{told}");
    assert!(told.contains("no option `radius_m`"), "{told}");

    let output = run.output();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stdout(&output).contains("REPLACED"), "{}", stdout(&output));
    let report: Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
    let replacements = report["supervision"]["replacements"].as_array().expect("a list");
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let outcomes: Vec<_> = replacements.iter().map(|of| [text(&of["stage"]), text(&of["outcome"])]).collect();
    let expected = [
        ["localiser", "replaced"],
        ["localiser", "replaced"],
        ["encoder", "not_used"],
        ["recorder", "not_used"],
    ];
    assert_eq!(outcomes, expected, "{replacements:#?}");
    assert_eq!(replacements[0]["command"][0], area.as_str());
    for stage in report["stages"].as_array().expect("stages") {
        let replaced = if stage["name"] == "localiser" { 2 } else { 0 };
        assert_eq!((&stage["restarts"], &stage["replacements"]), (&0.into(), &replaced.into()), "{stage:#}");
    }
    assert_eq!(report["ticks"], 170, "{:#}", report["supervision"]);
    assert_nothing_left(&root);
}

#[test]
fn what_can_not_be_replaced_is_refused_with_the_reason() {
    let output = run(&["stage", "replace", "encoder", "--run", "/nowhere/run"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let output = run(&["stage", "replace", "enkoder"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));

    let run = Started::run(&["--speed", "max", "--agents", "4"]);
    let root = run.wait_until_it_runs();
    let (code, told) = replace(&root, "encoder", &[]);
    assert!(code == Some(70) && told.contains("lockstep"), "{told}");
    run.signal(rustix::process::Signal::TERM);
    assert_eq!(run.output().status.code(), Some(143));
    assert_nothing_left(&root);
}
