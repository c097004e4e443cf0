//! Ticks without time for all agents: the agents that are left out are counted and explained. In lockstep
//! none are.

use serde_json::Value;
use testing::{SHIPPED_PIPELINE, Scratch};

use crate::started::{run, run_well, stderr, stdout};

/// The shipped pipeline with deadlines that have passed at every tick, so each stage serves its minimum.
fn hurried() -> String {
    let stages = ["source", "tracker", "localiser", "extractor", "encoder", "decoder"];
    let mut lines: Vec<String> = SHIPPED_PIPELINE.lines().map(str::to_owned).collect();
    let mut hurries = false;
    for line in &mut lines {
        if let Some(name) = line.strip_prefix("name = ") {
            hurries = stages.contains(&name.trim_matches('"'));
        } else if hurries && line.starts_with("budget_ms") {
            *line = "budget_ms = 0.001".to_owned();
        }
    }
    // A busy machine should lose no tick, because the test is about the share of the agents.
    lines.join("\n").replace("deadline_ms = 72", "deadline_ms = 80")
}

fn report(scratch: &Scratch, arguments: &[&str]) -> (Value, String) {
    let path = scratch.path("report.json");
    let scene = ["run", "--agents", "24", "--ticks", "60", "--seed", "3", "--report", &path];
    let output = run_well(&[&scene[..], arguments].concat());
    (serde_json::from_slice(&scratch.read("report.json")).expect("JSON"), stdout(&output))
}

fn causes(report: &Value) -> u64 {
    let causes = report["forecasts"]["causes"].as_object().expect("causes");
    causes.values().filter_map(Value::as_u64).sum()
}

#[test]
fn agents_without_time_are_shed_and_explained() {
    let scratch = Scratch::new("hurried");
    let (pipeline, history) = (scratch.file("hurried.toml", hurried()), scratch.path("forecasts.jsonl"));
    let (report, text) = report(&scratch, &["--pipeline", &pipeline, "--forecasts", &history]);
    let forecasts = &report["forecasts"];
    let of = |key: &str| forecasts[key].as_u64().expect("a count");
    let shed = &forecasts["shed"];
    assert!(shed["forecasts"].as_u64() > Some(0) && shed["ticks"].as_u64() > Some(0), "{forecasts:#}");
    assert!(of("learned") > 0, "the first of them are served: {forecasts:#}");
    assert_eq!(forecasts["causes"]["shed"], shed["forecasts"], "{forecasts:#}");
    assert_eq!(
        (&forecasts["causes"]["missing"], &forecasts["causes"]["none"]),
        (&Value::from(0), &Value::Null)
    );
    assert_eq!(causes(&report), of("held") + of("kinematic"), "each has a cause: {forecasts:#}");
    assert!(shed["agents_max"].as_u64() >= Some(8), "{shed:#}");
    assert!(text.contains(" shed ") && text.contains("no time: in "), "{text}");
    assert!(text.contains("not learned: left out to save time"), "{text}");
    let reasons = report["verdict"]["reasons"].to_string();
    assert!(reasons.contains("shed "), "{reasons}");
    // Each agent that was ever shed has a forecast, and held forecasts have their age.
    let lines = String::from_utf8(scratch.read("forecasts.jsonl")).expect("text");
    let agents = lines.lines().flat_map(|line| {
        let line: Value = serde_json::from_str(line).expect("JSON");
        line["agents"].as_array().expect("agents").clone()
    });
    let (mut held, mut learned_ids, mut shed_ids) = (0, Vec::new(), Vec::new());
    for agent in agents {
        let (quality, cause) = (agent["quality"].as_str(), agent["cause"].as_str());
        let id = agent["id"].as_u64().expect("an id");
        if quality == Some("learned") {
            learned_ids.push(id);
        }
        if cause == Some("shed") {
            shed_ids.push(id);
            held += u64::from(quality == Some("held"));
            assert!(quality != Some("held") || agent["age_s"].as_f64() >= Some(0.0799), "{agent:#}");
        }
    }
    assert!(held > 0, "learned forecasts are held");
    let never = shed_ids.iter().filter(|id| !learned_ids.contains(id)).count();
    assert!(never < shed_ids.len(), "turns go round");
}

#[test]
fn nothing_is_shed_in_lockstep_or_where_the_pipeline_forbids_it() {
    let scratch = Scratch::new("unhurried");
    let hurried = hurried();
    let pipeline = scratch.file("hurried.toml", &hurried);
    let forbidden = scratch.file("forbidden.toml", format!("shed = false\n{hurried}"));
    let (of_shipped, of_hurried) = (scratch.path("shipped.jsonl"), scratch.path("hurried.jsonl"));
    report(&scratch, &["--speed", "max", "--forecasts", &of_shipped]);
    let lockstep = ["--speed", "max", "--forecasts", &of_hurried, "--pipeline", &pipeline];
    let (report_of_lockstep, _) = report(&scratch, &lockstep);
    assert_eq!(report_of_lockstep["forecasts"]["shed"]["forecasts"], 0);
    assert!(scratch.read("shipped.jsonl") == scratch.read("hurried.jsonl"), "lockstep knows no deadline");
    let (report_of_forbidden, text) = report(&scratch, &["--pipeline", &forbidden]);
    assert_eq!(report_of_forbidden["forecasts"]["shed"]["forecasts"], 0);
    assert!(!text.contains(" shed "), "{text}");
}

/// Runs with deadlines that have passed at every tick, and replays the recording of these topics.
fn assert_replays_equal(topics: &str) {
    let scratch = Scratch::new(&format!("replayed-shedding-{}", topics.len()));
    let pipeline = scratch.file("hurried.toml", hurried());
    let (file, again) = (scratch.path("shed.mcap"), scratch.path("again.mcap"));
    let record = ["--pipeline", &pipeline, "--record", &file, "--record-topics", topics];
    let (report, _) = report(&scratch, &record);
    assert!(report["forecasts"]["shed"]["forecasts"].as_u64() > Some(100), "{report:#}");
    let replayed = run(&["replay", &file, "--out", &again]);
    let text = stdout(&replayed);
    assert!(text.contains("equal to the byte: 60 ticks"), "{text}{}", stderr(&replayed));
}

#[test]
fn a_recording_of_all_topics_replays_who_was_shed_to_the_byte() {
    assert_replays_equal("all");
}

#[test]
fn a_recording_without_features_replays_who_was_shed_to_the_byte() {
    assert_replays_equal("detections,tracks,forecasts,events");
}
