//! The status, the metrics and the trace of a run.

use std::net::TcpListener;

use rustix::process::Signal;
use serde_json::Value;
use testing::Scratch;

use crate::started::{Started, run, run_well, stderr, stdout, wait_for};

/// Number of times that a text occurs.
fn count(bytes: &[u8], text: &str) -> usize {
    bytes.windows(text.len()).filter(|window| *window == text.as_bytes()).count()
}

#[test]
fn a_run_is_told_while_it_goes_on_and_afterwards() {
    let scratch = Scratch::new("observing");
    let (metrics, trace, report) = (scratch.path("a.prom"), scratch.path("a.trace"), scratch.path("r.json"));
    let files = ["--metrics-file", &metrics, "--trace", &trace, "--report", &report];
    let started = Started::run(&[&["--agents", "4", "--ticks", "120", "--quiet"][..], &files].concat());
    let root = started.wait_until_it_runs();
    let name = root.file_name().and_then(|name| name.to_str()).expect("a run has a name").to_owned();
    let status = || -> Value {
        let told = run_well(&["top", "--run", &name, "--once", "--json"]);
        serde_json::from_slice(&told.stdout).expect("the status is JSON")
    };
    let begun = || Some(status()).filter(|status| status["report"]["ticks"].as_u64() > Some(20));
    let begun = wait_for("no ticks come", begun);
    assert_eq!(begun["stages"].as_array().map(Vec::len), Some(8));
    let decoder = &begun["stages"][5];
    assert_eq!((&decoder["name"], &decoder["process"]["state"]), (&"decoder".into(), &"running".into()));
    assert!(
        decoder["recent_compute_ms"]["p50"].is_number() && decoder["process"]["memory_bytes"].is_number()
    );
    let table = stdout(&run_well(&["top", "--run", &name, "--once", "--stage", "decoder"]));
    assert!(table.contains("compute") && table.contains("wake-up"), "{table}");
    let unknown = run(&["top", "--run", &name, "--once", "--stage", "planner"]);
    assert_eq!(unknown.status.code(), Some(2), "{}", stderr(&unknown));

    started.signal_stage("decoder", Signal::KILL);
    wait_for("its restart is not told", || {
        status()["events"].as_array().filter(|all| !all.is_empty()).map(drop)
    });
    let output = started.output();
    assert!(output.status.success(), "{}", stderr(&output));
    let text = String::from_utf8(scratch.read("a.prom")).expect("metrics are UTF-8");
    assert!(text.lines().any(|line| line == "stgdat_restarts_total{stage=\"decoder\"} 1"), "{text}");
    let bytes = scratch.read("a.trace");
    assert!(count(&bytes, "compute") > 100 * 6 && count(&bytes, "decoder (restart 1)") == 1);
    assert_eq!(count(&bytes, "was killed by signal 9"), 1);
    let report: Value = serde_json::from_slice(&scratch.read("r.json")).expect("JSON");
    let worst = report["worst_ticks"].as_array().expect("the report has them");
    assert!((1..=20).contains(&worst.len()));
    assert!(worst.iter().all(|tick| tick["cause"].as_str().is_some_and(|cause| !cause.is_empty())));
}

#[test]
fn an_address_that_is_taken_and_a_folder_that_is_not_there_end_the_run_before_it_begins() {
    let taken = TcpListener::bind("127.0.0.1:0").expect("there is a port");
    let address = taken.local_addr().expect("it has an address").to_string();
    let output = run(&["run", "--ticks", "5", "--metrics", &address]);
    assert_eq!(output.status.code(), Some(69), "{}", stderr(&output));
    assert!(stderr(&output).contains(&address), "{}", stderr(&output));
    for option in ["--trace", "--metrics-file"] {
        let output = run(&["run", "--ticks", "5", option, "/no/such/folder/file"]);
        assert_eq!(output.status.code(), Some(65), "{}", stderr(&output));
        assert!(stderr(&output).contains("/no/such/folder/file"), "{}", stderr(&output));
    }
}

#[test]
fn a_run_that_is_not_there_and_a_file_that_is_no_recording_are_refused() {
    let output = run(&["top", "--run", "stgdat_nothere", "--once"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let scratch = Scratch::new("no-recording");
    let path = scratch.path("a.mcap");
    std::fs::write(&path, "no recording").expect("a scratch file can be written");
    for verb in [&["trace", &path][..], &["tick", &path, "3"]] {
        let output = run(verb);
        assert_eq!(output.status.code(), Some(65), "{}", stderr(&output));
        assert!(stderr(&output).contains("a.mcap"), "{}", stderr(&output));
    }
}
