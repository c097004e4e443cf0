//! Deaths and stops of stages in a run: the output continues, and the report contains the cost of each.

use rustix::process::Signal;
use serde_json::Value;
use testing::Scratch;

use crate::started::{Started, assert_nothing_left, stderr, stdout};

const STAGES: [&str; 8] =
    ["source", "tracker", "localiser", "extractor", "encoder", "decoder", "sampler", "recorder"];

/// A run in which `disturb` is called once forecasts arrive. Returns its exit code and its report.
fn disturbed(name: &str, arguments: &[&str], disturb: impl FnOnce(&Started)) -> (Option<i32>, Value) {
    let scratch = Scratch::new(name);
    let (report, forecasts) = (scratch.path("report.json"), scratch.path("forecasts.jsonl"));
    let files = ["--report", &report, "--forecasts", &forecasts, "--agents", "6"];
    let run = Started::run(&[&files[..], arguments].concat());
    let root = run.wait_until_it_forecasts();
    disturb(&run);
    let output = run.output();
    assert!(stdout(&output).contains("LATENCY"), "a report is printed: {}", stderr(&output));
    assert_nothing_left(&root);
    (output.status.code(), serde_json::from_slice(&scratch.read("report.json")).expect("JSON"))
}

fn restarts(report: &Value) -> Vec<(String, u64)> {
    let stages = report["stages"].as_array().expect("stages");
    let of = |stage: &Value| Some((stage["name"].as_str()?.to_owned(), stage["restarts"].as_u64()?));
    stages.iter().filter_map(of).filter(|(_, restarts)| *restarts > 0).collect()
}

fn assert_recovered(stage: &str, (exit, report): &(Option<i32>, Value)) {
    assert_eq!(*exit, Some(0), "{stage}: {:#}", report["supervision"]);
    assert_eq!(restarts(report), [(stage.to_owned(), 1)], "{:#}", report["supervision"]);
    let outages = report["supervision"]["outages"].as_array().expect("outages");
    assert_eq!(outages.len(), 1, "{outages:?}");
    assert_eq!(outages[0]["stage"], stage);
    assert!(outages[0]["ticks_to_learned"].is_u64(), "{stage} is learned from again: {outages:?}");
}

#[test]
fn a_killed_stage_is_restarted_and_forecasts_are_learned_again() {
    for stage in STAGES {
        let run = disturbed(&format!("killed-{stage}"), &["--ticks", "110"], |run| {
            run.signal_stage(stage, Signal::KILL);
        });
        assert_recovered(stage, &run);
    }
}

#[test]
fn forecasts_fall_silent_by_policy_once_their_stage_is_given_up() {
    let scratch = Scratch::new("silent-pipeline");
    let policy = include_str!("../../launch/pipeline.toml")
        .replace("options = { deadline_ms = 72 }", "options = { held_s = 0.4, kinematic_s = 0.8 }")
        .replace("name = \"decoder\"\n", "name = \"decoder\"\nrestart = \"never\"\n");
    let pipeline = scratch.file("pipeline.toml", policy);
    let arguments = ["--ticks", "90", "--pipeline", &pipeline];
    let (_, report) = disturbed("silent", &arguments, |run| run.signal_stage("decoder", Signal::KILL));
    let forecasts = &report["forecasts"];
    for quality in ["learned", "held", "kinematic", "silent"] {
        assert!(forecasts[quality].as_u64() > Some(0), "{quality}: {forecasts:#}");
    }
    assert!(forecasts["age_ms_max"].as_f64() <= Some(400.0), "{forecasts:#}");
}

#[test]
fn a_stopped_stage_is_replaced() {
    let run = disturbed("stop", &["--ticks", "90"], |run| run.signal_stage("encoder", Signal::STOP));
    assert_recovered("encoder", &run);
}

/// A run of 60 ticks continues after a kill near the tenth. A busy machine loses some ticks.
fn assert_went_on(report: &serde_json::Value) {
    assert!((41..=60).contains(&report["ticks"].as_u64().unwrap_or_default()), "{report:#}");
}

#[test]
fn a_stage_that_may_not_be_restarted_is_given_up_and_the_run_goes_on() {
    let scratch = Scratch::new("never");
    let name = "name = \"encoder\"\n";
    let pipeline = scratch.pipeline("never.toml", name, &format!("{name}restart = \"never\"\n"));
    let arguments = ["--ticks", "60", "--pipeline", &pipeline];
    let (exit, report) = disturbed("never-run", &arguments, |run| run.signal_stage("encoder", Signal::KILL));
    assert_eq!(exit, Some(70), "{:#}", report["supervision"]);
    assert_went_on(&report);
    assert!(report["supervision"]["given_up"]["encoder"].is_string(), "{:#}", report["supervision"]);
}

#[test]
fn a_death_without_which_there_is_no_output_ends_the_run_with_a_report() {
    let scratch = Scratch::new("fatal");
    let name = "name = \"sampler\"\n";
    let pipeline = scratch.pipeline("fatal.toml", name, &format!("{name}restart = \"never\"\n"));
    let (exit, report) =
        disturbed("fatal-run", &["--pipeline", &pipeline], |run| run.signal_stage("sampler", Signal::KILL));
    assert_eq!(exit, Some(70));
    let ended_by = report["supervision"]["ended_by"].as_str().unwrap_or_default();
    assert!(ended_by.contains("the sampler was killed by signal 9"), "{ended_by}");
    assert!(report["ticks"].as_u64() > Some(0));
}

#[test]
fn the_restart_limit_and_exit_code_78_give_a_stage_up() {
    // The stage's first process runs. Later processes end with the code.
    for (code, restarts) in [(3, 2), (78, 1)] {
        let scratch = Scratch::new(&format!("limit-{code}"));
        let stgdat = env!("CARGO_BIN_EXE_stgdat");
        let words = format!("test $STGDAT_INCARNATION = 0 || exit {code}; exec {stgdat} stage encoder");
        let line = format!("name = \"encoder\"\ncommand = [\"sh\", \"-c\", {words:?}]\nrestarts_max = 2\n");
        let pipeline = scratch.pipeline("limit.toml", "name = \"encoder\"\n", &line);
        let (exit, report) =
            disturbed(&format!("limit-run-{code}"), &["--ticks", "60", "--pipeline", &pipeline], |run| {
                run.signal_stage("encoder", Signal::KILL);
            });
        assert_eq!(exit, Some(70), "{:#}", report["supervision"]);
        assert_went_on(&report);
        let outages = report["supervision"]["outages"].as_array().map_or(0, Vec::len);
        assert_eq!(outages, restarts, "{code}: {:#}", report["supervision"]);
        assert!(report["supervision"]["given_up"]["encoder"].is_string(), "{code}");
    }
}

/// The stage can't know that another program has removed the record that it lacks.
#[test]
fn a_stage_that_lacks_removed_files_is_started_again() {
    let scratch = Scratch::new("lacks");
    let stgdat = env!("CARGO_BIN_EXE_stgdat");
    let words = format!(
        "test $STGDAT_INCARNATION != 1 || {{ rm $STGDAT_RUN; exit 78; }}; exec {stgdat} stage encoder"
    );
    let line = format!("name = \"encoder\"\ncommand = [\"sh\", \"-c\", {words:?}]\n");
    let pipeline = scratch.pipeline("lacks.toml", "name = \"encoder\"\n", &line);
    let (exit, report) = disturbed("lacks-run", &["--ticks", "80", "--pipeline", &pipeline], |run| {
        run.signal_stage("encoder", Signal::KILL);
    });
    assert_eq!(exit, Some(0), "{:#}", report["supervision"]);
    assert_eq!(restarts(&report), [("encoder".to_owned(), 2)], "{:#}", report["supervision"]);
}

/// Removes the regular files in a folder and its subfolders, like programs that remove old files.
fn remove_files(folder: &std::path::Path) {
    for entry in std::fs::read_dir(folder).expect("the run's folder").filter_map(Result::ok) {
        match entry.file_type().expect("a type") {
            kind if kind.is_dir() => remove_files(&entry.path()),
            kind if kind.is_file() => {
                // The recorder may have just renamed the file.
                let _ = std::fs::remove_file(entry.path());
            }
            _ => {}
        }
    }
}

#[test]
fn a_run_whose_files_were_removed_restarts_a_stage() {
    for (name, whole) in [("files", false), ("folder", true)] {
        let run = disturbed(&format!("aged-{name}"), &["--ticks", "110"], |run| {
            let root = run.root();
            match whole {
                false => remove_files(&root),
                // Fails if the launcher restores files meanwhile.
                true => drop(std::fs::remove_dir_all(&root)),
            }
            run.signal_stage("decoder", Signal::KILL);
        });
        let (exit, report) = &run;
        assert_eq!(*exit, Some(0), "{name}: {:#}", report["supervision"]);
        // A decoder that starts before its files are restored ends and is started again.
        let restarts = restarts(report);
        assert!(matches!(&restarts[..], [(stage, 1 | 2)] if stage == "decoder"), "{name}: {restarts:?}");
        let outages = report["supervision"]["outages"].as_array().expect("outages");
        let last = outages.last().expect("the decoder died");
        assert!(last["ticks_to_learned"].is_u64(), "{name}: learned again: {outages:?}");
    }
}
