use std::path::Path;

use miette::{GraphicalReportHandler, GraphicalTheme};

use super::*;
use crate::{Association, Prior, View};

const FULL: &str = include_str!("../../../../launch/pipeline.toml");

fn error(text: &str) -> String {
    let error = Pipeline::parse("pipeline.toml", text).expect_err("the text is faulty");
    let mut rendered = String::new();
    GraphicalReportHandler::new_themed(GraphicalTheme::unicode_nocolor())
        .with_width(100)
        .render_report(&mut rendered, &error)
        .unwrap();
    rendered
}

/// The shipped file with one text replaced; the replaced text must be there.
fn with(from: &str, to: &str) -> String {
    assert!(FULL.contains(from), "the shipped pipeline.toml has no {from:?}");
    FULL.replacen(from, to, 1)
}

#[test]
fn the_shipped_file_is_accepted_and_wires_the_loop() {
    let pipeline = Pipeline::parse("pipeline.toml", FULL).unwrap();
    assert_eq!(pipeline.stages.iter().map(|s| s.id).collect::<Vec<_>>(), StageId::ALL);
    let edges = pipeline.edges();
    assert!(edges.contains(&(StageId::Sampler, "forecasts", StageId::Tracker)));
    assert_eq!(edges.len(), 10);
    for stage in &pipeline.stages {
        let (reads, writes) = built_in_topics(stage.id);
        assert!(stage.reads.iter().eq(reads) && stage.writes.iter().eq(writes), "{stage:?}");
    }
}

#[test]
fn one_line_swaps_a_stage() {
    let text = with("name = \"encoder\"", "name = \"encoder\"\ncommand = [\"./mine\", \"--fast\"]");
    let pipeline = Pipeline::parse("pipeline.toml", &text).unwrap();
    let encoder = pipeline.stages.iter().find(|s| s.id == StageId::Encoder).unwrap();
    assert_eq!(encoder.command.as_deref(), Some(&["./mine".to_owned(), "--fast".to_owned()][..]));
}

#[test]
fn unknown_key() {
    insta::assert_snapshot!(error(&with(
        "[[stage]]\nname = \"encoder\"",
        "[[stage]]\npriority = 3\nname = \"encoder\""
    )));
}

#[test]
fn syntax() {
    insta::assert_snapshot!(error("[[stage]\nname = 3"));
}

#[test]
fn unknown_stage() {
    insta::assert_snapshot!(error(&with("\"encoder\"", "\"enkoder\"")));
}

#[test]
fn unknown_topic() {
    insta::assert_snapshot!(error(&with("reads = [\"features\"]", "reads = [\"feature\"]")));
}

#[test]
fn duplicate_stage() {
    insta::assert_snapshot!(error(&format!(
        "{FULL}\n[[stage]]\nname = \"recorder\"\nreads = [\"forecasts\", \"truth\"]\n"
    )));
}

#[test]
fn two_producers() {
    let text = with("name = \"encoder\"", "name = \"encoder\"\ncommand = [\"./mine\"]");
    insta::assert_snapshot!(error(&text.replacen(
        "writes = [\"encodings\"]",
        "writes = [\"encodings\", \"tracks\"]",
        1
    )));
}

#[test]
fn missing_producer() {
    let start = FULL.find("[[stage]]\nname = \"encoder\"").unwrap();
    let end = FULL.find("[[stage]]\nname = \"decoder\"").unwrap();
    insta::assert_snapshot!(error(&format!("{}{}", &FULL[..start], &FULL[end..])));
}

#[test]
fn wrong_topics_of_a_built_in_stage() {
    insta::assert_snapshot!(error(&with("reads = [\"features\"]", "reads = [\"features\", \"tracks\"]")));
    insta::assert_snapshot!(error(&with("reads = [\"tracks\", \"controls\"]", "reads = [\"controls\"]")));
}

#[test]
fn cycle() {
    let text = with("name = \"localiser\"", "name = \"localiser\"\ncommand = [\"./mine\"]");
    insta::assert_snapshot!(error(&text.replacen(
        "reads = [\"tracks\"]",
        "reads = [\"tracks\", \"forecasts\"]",
        1
    )));
}

#[test]
fn budgets_over_a_tick() {
    insta::assert_snapshot!(error(&with(
        "writes = [\"encodings\"]\nbudget_ms = ",
        "writes = [\"encodings\"]\nbudget_ms = 7"
    )));
    insta::assert_snapshot!(error(&with(
        "writes = [\"encodings\"]\nbudget_ms = ",
        "writes = [\"encodings\"]\nbudget_ms = -"
    )));
}

#[test]
fn options_of_another_stage_or_out_of_range() {
    insta::assert_snapshot!(error(&with("deadline_ms = 72", "deadline_ms = 95")));
    insta::assert_snapshot!(error(&with("deadline_ms = 72", "workers = 2")));
    insta::assert_snapshot!(error(&with("deadline_ms = 72", "propagation = \"guess\"")));
}

#[test]
fn the_trackers_prior() {
    let tracker = |options: &str| with("budget_ms = 6", &format!("budget_ms = 6\noptions = {{ {options} }}"));
    let pipeline = Pipeline::parse("p.toml", &tracker("prior = \"learned\"")).unwrap();
    let stage = pipeline.stages.iter().find(|stage| stage.id == StageId::Tracker).unwrap();
    assert_eq!(stage.options.prior, Some(Prior::Learned));
    let wrong = error(&tracker("prior = \"guess\""));
    assert!(wrong.contains("expected kinematic or learned"), "{wrong}");
    let foreign = error(&with("deadline_ms = 72", "prior = \"learned\""));
    assert!(foreign.contains("the sampler has no option `prior`"), "{foreign}");
}

#[test]
fn the_samplers_memory_of_places() {
    let pipeline = Pipeline::parse(
        "p.toml",
        &with("deadline_ms = 72", "deadline_ms = 72, recall = true, memory = \"a.memory\""),
    )
    .unwrap();
    let stage = pipeline.stages.iter().find(|stage| stage.id == StageId::Sampler).unwrap();
    assert_eq!(stage.options.recall, Some(true));
    assert_eq!(stage.options.memory.as_deref(), Some(Path::new("a.memory")));
    let tracker = with("budget_ms = 6", "budget_ms = 6\noptions = { recall = true }");
    assert!(error(&tracker).contains("the tracker has no option `recall`"), "{}", error(&tracker));
    let tracker = with("budget_ms = 6", "budget_ms = 6\noptions = { memory = \"a.memory\" }");
    assert!(error(&tracker).contains("the tracker has no option `memory`"), "{}", error(&tracker));
    let neither = with("deadline_ms = 72", "deadline_ms = 72, recall = false, memory = \"a.memory\"");
    assert!(error(&neither).contains("a memory that is not to be recalled"), "{}", error(&neither));
}

#[test]
fn the_trackers_association() {
    let tracker = |options: &str| with("budget_ms = 6", &format!("budget_ms = 6\noptions = {{ {options} }}"));
    let pipeline = Pipeline::parse("p.toml", &tracker("association = \"jpda\"")).unwrap();
    let stage = pipeline.stages.iter().find(|stage| stage.id == StageId::Tracker).unwrap();
    assert_eq!(stage.options.association, Some(Association::Jpda));
    let wrong = error(&tracker("association = \"guess\""));
    assert!(wrong.contains("expected assignment or jpda"), "{wrong}");
    let foreign = error(&with("deadline_ms = 72", "association = \"jpda\""));
    assert!(foreign.contains("the sampler has no option `association`"), "{foreign}");
}

#[test]
fn the_trackers_view() {
    let tracker = |options: &str| with("budget_ms = 6", &format!("budget_ms = 6\noptions = {{ {options} }}"));
    let pipeline = Pipeline::parse("p.toml", &tracker("view = \"81, 70\"")).unwrap();
    let stage = pipeline.stages.iter().find(|stage| stage.id == StageId::Tracker).unwrap();
    assert_eq!(stage.options.view, Some(View { width_deg: 81.0, range_m: 70.0 }));
    for wrong in ["90", "0,80", "400,80", "90,nan", "90,-1", "90,80,2"] {
        let told = error(&tracker(&format!("view = \"{wrong}\"")));
        assert!(told.contains(&format!("unknown view \"{wrong}\": expected WIDTH,RANGE")), "{told}");
    }
    let foreign = error(&with("deadline_ms = 72", "view = \"90,80\""));
    assert!(foreign.contains("the sampler has no option `view`"), "{foreign}");
}

#[test]
fn no_recorder() {
    let start = FULL.find("[[stage]]\nname = \"recorder\"").unwrap();
    insta::assert_snapshot!(error(&FULL[..start]));
}

#[test]
fn empty_command() {
    insta::assert_snapshot!(error(&with("name = \"encoder\"", "name = \"encoder\"\ncommand = []")));
}
