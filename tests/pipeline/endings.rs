//! Ends of a run: all its processes end, and none of its files are left.

use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::process::ExitStatusExt;
use std::time::Duration;

use rustix::process::{Pid, Signal};
use testing::Scratch;

use crate::started::{
    LeftoverWatch, Started, assert_nothing_left, piped, run_well, shared_files, stderr, stdout, stgdat,
    wait_for,
};

/// Whether a process still runs. A zombie does not run: its new parent has not waited for it yet.
fn lives(pid: Pid) -> bool {
    state(pid).is_some_and(|state| state != 'Z')
}

/// The letter of the kernel for a process's state.
fn state(pid: Pid) -> Option<char> {
    let line = std::fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_nonzero())).ok()?;
    line.rsplit(") ").next()?.chars().next()
}

/// Whether this process ignores a signal, such as SIGHUP under `nohup`, or SIGINT in the background of a script.
/// Programs that it starts then ignore the signal too.
pub fn ignores(signal: Signal) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).map(str::trim);
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask, 16).ok()).unwrap_or(0);
    let is_ignored = mask >> (signal.as_raw() - 1) & 1 == 1;
    if is_ignored {
        eprintln!("{signal:?} is skipped: this process ignores it");
    }
    is_ignored
}

#[test]
fn a_signal_ends_all_stages_after_the_report() {
    for (signal, code) in [(Signal::TERM, 143), (Signal::INT, 130), (Signal::HUP, 129), (Signal::QUIT, 131)] {
        if ignores(signal) {
            continue;
        }
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
fn a_run_whose_terminal_is_gone_ends_with_its_report() {
    if ignores(Signal::HUP) {
        return;
    }
    let scratch = Scratch::new("no-terminal");
    let report = scratch.path("report.json");
    // This file refuses every write, like a terminal that is gone.
    let refuses = || std::fs::File::options().write(true).open("/dev/full").expect("Linux has the file");
    let mut command = stgdat();
    command.args(["run", "--agents", "6", "--report", &report]).stdout(refuses()).stderr(refuses());
    let run = Started::spawn(&mut command);
    let root = run.wait_until_it_forecasts();
    run.signal(Signal::HUP);
    assert_eq!(run.output().status.code(), Some(129));
    let report: serde_json::Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
    assert!(report["ticks"].as_u64() > Some(0), "{report:#}");
    assert_nothing_left(&root);
}

#[test]
fn after_an_upgrade_in_place_restarts_run_the_old_version() {
    let scratch = Scratch::new("upgrade");
    let (program, report) = (scratch.path("stgdat"), scratch.path("report.json"));
    std::fs::copy(env!("CARGO_BIN_EXE_stgdat"), &program).expect("the program can be copied");
    let mut command = piped(&program);
    command.args(["run", "--agents", "6", "--ticks", "80", "--report", &report]);
    let run = Started::spawn(&mut command);
    let root = run.wait_until_it_runs();
    // As a package manager does: a new file takes the name of the old one.
    let new = scratch.file("new", "#!/bin/sh\nexit 78\n");
    std::fs::set_permissions(&new, std::fs::Permissions::from_mode(0o755)).expect("the file is ours");
    std::fs::rename(&new, &program).expect("both are in one folder");
    run.signal_stage("decoder", Signal::KILL);
    let output = run.output();
    assert!(output.status.success(), "{}", stderr(&output));
    let report: serde_json::Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
    assert_eq!(report["supervision"]["outages"].as_array().map(Vec::len), Some(1), "{report:#}");
    assert_eq!(report["supervision"]["given_up"], serde_json::json!({}), "{report:#}");
    assert_nothing_left(&root);
}

#[test]
fn a_signal_during_the_start_ends_the_run() {
    let watch = LeftoverWatch::begin();
    for delay_ms in [2, 5, 10, 20, 30, 50, 80, 120] {
        let run = Started::run(&["--agents", "6", "--quiet"]);
        std::thread::sleep(Duration::from_millis(delay_ms));
        run.signal(Signal::TERM);
        let output = run.output();
        // Before the handler is installed, the signal kills a process that has done nothing yet.
        let ended = output.status.code() == Some(143) || output.status.signal() == Some(15);
        assert!(ended, "after {delay_ms} ms: {:?}: {}", output.status, stderr(&output));
        // A stage may report that it was interrupted. For the launcher, a requested end is not an error.
        let printed = stderr(&output);
        assert!(!printed.lines().any(|line| line.starts_with("error")), "after {delay_ms} ms: {printed}");
    }
    watch.assert_nothing_new();
}

#[test]
fn a_stopped_stage_is_ended_with_the_run() {
    let scratch = Scratch::new("stopped-stage");
    let name = "name = \"decoder\"\n";
    let pipeline = scratch.pipeline("never.toml", name, &format!("{name}restart = \"never\"\n"));
    let run = Started::run(&["--agents", "6", "--pipeline", &pipeline]);
    let root = run.wait_until_it_runs();
    let stages = run.stages();
    let (decoder, _) =
        stages.iter().find(|(_, line)| line.iter().any(|word| word == "decoder")).expect("it runs");
    run.signal_stage("decoder", Signal::STOP);
    wait_for("the decoder does not stop", || (state(*decoder) == Some('T')).then_some(()));
    run.signal(Signal::TERM);
    assert_eq!(run.output().status.code(), Some(143));
    assert_nothing_left(&root);
}

#[test]
fn clean_removes_the_files_of_dead_runs_only() {
    let watch = LeftoverWatch::begin();
    let living = Started::run(&["--agents", "6"]);
    let dead = Started::run(&["--agents", "6"]);
    let (living_root, dead_root) = (living.wait_until_it_runs(), dead.wait_until_it_runs());
    let stages = dead.stages();
    dead.signal(Signal::KILL);
    drop(dead);
    wait_for("stages outlive their launcher", || (!stages.iter().any(|(pid, _)| lives(*pid))).then_some(()));
    assert!(!shared_files(&dead_root).is_empty(), "no process is left to remove them");
    let name = dead_root.file_name().and_then(|name| name.to_str()).expect("a run's directory has a name");
    let printed = stdout(&run_well(&["clean", "--dry-run"]));
    assert!(printed.contains(&format!("would remove {name}")), "{printed}");
    assert!(!shared_files(&dead_root).is_empty(), "a dry run removes nothing");
    run_well(&["clean"]);
    assert_nothing_left(&dead_root);
    watch.assert_nothing_new();
    assert!(!shared_files(&living_root).is_empty(), "the living run keeps its files");
    living.signal(Signal::TERM);
    assert_eq!(living.output().status.code(), Some(143));
    assert_nothing_left(&living_root);
}
