//! However a run ends, it ends all of itself and leaves nothing behind.

use std::os::unix::process::ExitStatusExt;
use std::time::Duration;

use rustix::process::{Pid, Signal};

use crate::scratch::Scratch;
use crate::started::{
    LeftoverWatch, Started, assert_nothing_left, run_well, shared_files, stderr, stdout, wait_for,
};

/// Whether a process still does anything. A zombie does not: its new parent has not looked yet.
fn lives(pid: Pid) -> bool {
    let state = std::fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_nonzero()));
    state.is_ok_and(|state| state.rsplit(") ").next().is_some_and(|rest| !rest.starts_with('Z')))
}

#[test]
fn a_signal_ends_all_stages_and_the_report_still_comes() {
    for (signal, code) in [(Signal::TERM, 143), (Signal::INT, 130)] {
        let scratch = Scratch::new(&format!("signal-{code}"));
        let (report, forecasts) = (scratch.path("report.json"), scratch.path("forecasts.jsonl"));
        let run = Started::run(&["--agents", "6", "--report", &report, "--forecasts", &forecasts]);
        let root = run.wait_until_it_runs();
        let stages = run.stages();
        let partial = format!("{forecasts}.partial");
        let begun = || std::fs::metadata(&partial).is_ok_and(|file| file.len() > 0).then_some(());
        wait_for("no forecasts come", begun);
        run.signal(signal);
        let output = run.output();
        assert_eq!(output.status.code(), Some(code), "{}", stderr(&output));
        assert!(stdout(&output).contains("LATENCY"), "{}", stdout(&output));
        let report: serde_json::Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
        let lines = String::from_utf8(scratch.read("forecasts.jsonl")).expect("JSON lines are UTF-8");
        assert!(lines.ends_with("}\n"), "the last line is whole");
        assert_eq!(report["ticks"], lines.lines().count(), "all that is reported is written");
        assert_nothing_left(&root);
        for (pid, line) in stages {
            assert!(!lives(pid), "{line:?} still runs");
        }
    }
}

#[test]
fn a_signal_while_the_stages_start_ends_the_run_too() {
    let watch = LeftoverWatch::begin();
    for delay_ms in [2, 5, 10, 20, 30, 50, 80, 120] {
        let run = Started::run(&["--agents", "6", "--quiet"]);
        std::thread::sleep(Duration::from_millis(delay_ms));
        run.signal(Signal::TERM);
        let output = run.output();
        // At first the signal is not yet taken over, and ends a process that has done nothing.
        let ended = output.status.code() == Some(143) || output.status.signal() == Some(15);
        assert!(ended, "after {delay_ms} ms: {:?}: {}", output.status, stderr(&output));
        // A stage may tell that it was interrupted; for the launcher an end that was asked for is no error.
        let told = stderr(&output);
        assert!(!told.lines().any(|line| line.starts_with("error")), "after {delay_ms} ms: {told}");
    }
    watch.assert_nothing_new();
}

#[test]
fn the_death_of_a_stage_ends_the_run_and_is_told() {
    for stage in ["tracker", "encoder", "recorder"] {
        let run = Started::run(&["--agents", "6"]);
        let root = run.wait_until_it_runs();
        run.signal_stage(stage, Signal::KILL);
        let output = run.output();
        assert_eq!(output.status.code(), Some(70));
        let told = format!("the {stage} was killed by signal 9");
        assert!(stderr(&output).contains(&told), "{}", stderr(&output));
        assert_nothing_left(&root);
    }
}

#[test]
fn a_stage_that_is_stopped_holds_nothing_up_and_is_ended() {
    let run = Started::run(&["--agents", "6"]);
    let root = run.wait_until_it_runs();
    run.signal_stage("decoder", Signal::STOP);
    std::thread::sleep(Duration::from_millis(500));
    run.signal(Signal::TERM);
    assert_eq!(run.output().status.code(), Some(143));
    assert_nothing_left(&root);
}

#[test]
fn after_the_launcher_is_killed_clean_removes_its_files_and_no_others() {
    let watch = LeftoverWatch::begin();
    let living = Started::run(&["--agents", "6"]);
    let dead = Started::run(&["--agents", "6"]);
    let (living_root, dead_root) = (living.wait_until_it_runs(), dead.wait_until_it_runs());
    let stages = dead.stages();
    dead.signal(Signal::KILL);
    drop(dead);
    wait_for("stages outlive their launcher", || (!stages.iter().any(|(pid, _)| lives(*pid))).then_some(()));
    assert!(!shared_files(&dead_root).is_empty(), "nobody was there to remove them");
    let name = dead_root.file_name().and_then(|name| name.to_str()).expect("a run's directory has a name");
    let told = stdout(&run_well(&["clean", "--dry-run"]));
    assert!(told.contains(&format!("would remove {name}")), "{told}");
    assert!(!shared_files(&dead_root).is_empty(), "a dry run removes nothing");
    run_well(&["clean"]);
    assert_nothing_left(&dead_root);
    watch.assert_nothing_new();
    assert!(!shared_files(&living_root).is_empty(), "the living run keeps its files");
    living.signal(Signal::TERM);
    assert_eq!(living.output().status.code(), Some(143));
    assert_nothing_left(&living_root);
}
