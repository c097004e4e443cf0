//! A live producer whose clock is set, or which is silent for a while.

use serde_json::Value;
use testing::Scratch;

use crate::programs::example;
use crate::started::{Started, piped, run_well, stderr, stgdat};

/// Five objects along +y, without identities, at 10 Hz for 20 s.
fn rows() -> String {
    let mut csv = "stamp_s,type,x_m,y_m\n".to_owned();
    for sweep in 0..200 {
        let stamp_s = f64::from(sweep) * 0.1;
        for (agent, speed_mps) in [10.0, 8.0, 6.0, 1.4, 1.2].into_iter().enumerate() {
            let kind = if speed_mps > 2.0 { "vehicle" } else { "pedestrian" };
            csv += &format!("{stamp_s:.1},{kind},{},{:.3}\n", 6 * agent, speed_mps * stamp_s);
        }
    }
    csv
}

/// The report of a run of the producer with these options, and the number of agents of each tick.
fn run(name: &str, options: &[&str]) -> (Value, Vec<usize>) {
    let scratch = Scratch::new(name);
    let play = format!("source.play={}", scratch.file("five.csv", rows()));
    let pipeline = scratch.pipeline_with("source", &[&example("producer")]);
    let (out, report) = (scratch.path("out.jsonl"), scratch.path("report.json"));
    let run = ["run", "--quiet", "--pipeline", &pipeline, "--forecasts", &out, "--report", &report];
    let options = options.iter().flat_map(|option| ["--set", option]);
    run_well(&run.into_iter().chain(["--set", &play]).chain(options).collect::<Vec<_>>());
    let lines = String::from_utf8(scratch.read("out.jsonl")).expect("text");
    let ticks = lines.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON lines"));
    let agents = ticks.filter_map(|tick| Some(tick["agents"].as_array()?.len())).collect();
    (serde_json::from_slice(&scratch.read("report.json")).expect("JSON"), agents)
}

fn reasons(report: &Value) -> String {
    report["verdict"]["reasons"].to_string()
}

#[test]
fn a_clock_that_is_set_back_begins_a_session_without_doubles() {
    for (name, back_s) in [("clock_half", 0.5), ("clock_ten", 10.0), ("clock_forty", 40.0)] {
        let set = format!("source.set_clock=[60,-{back_s}]");
        let (report, agents) = run(name, &["source.ticks=120", &set]);
        let reasons = reasons(&report);
        assert!(reasons.contains(&format!("the stamps go back by {back_s:.2} s at tick ")), "{reasons}");
        assert_ne!(report["verdict"]["status"], "ok");
        assert_eq!(report["sessions"]["count"], 2);
        assert!(agents.iter().all(|agents| *agents <= 5), "{agents:?}");
        // Most ticks of both sessions, even on a busy machine.
        assert!(agents[agents.len() / 2..].iter().filter(|agents| **agents == 5).count() > 30, "{agents:?}");
    }
}

#[test]
fn a_clock_that_is_set_forward_by_a_minute_begins_a_session() {
    let (report, agents) = run("clock_forward", &["source.ticks=120", "source.set_clock=[60,60]"]);
    assert_eq!(report["sessions"]["count"], 2, "{report}");
    assert!(agents.iter().all(|agents| *agents <= 5), "{agents:?}");
    assert!(agents[agents.len() / 2..].iter().filter(|agents| **agents == 5).count() > 30, "{agents:?}");
}

#[test]
fn a_step_of_the_computers_clock_begins_a_session() {
    for step_s in [-40_i64, 3_600] {
        let scratch = Scratch::new("clock_realtime");
        // Moves CLOCK_REALTIME of every process that calls the C library, once the file `step` is there.
        let library = scratch.path("step.so");
        let source = scratch.file("step.rs", STEP.replace("STEP_S", &step_s.to_string()));
        let compiler = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".to_owned());
        let arguments = ["--crate-type", "cdylib", "--edition", "2024", &source, "-o", &library];
        let compiled = piped(compiler).args(arguments).output().expect("rustc");
        assert!(compiled.status.success(), "{}", stderr(&compiled));
        let play = format!("source.play={}", scratch.file("five.csv", rows()));
        let pipeline = scratch.pipeline_with("source", &[&example("producer")]);
        let (out, report) = (scratch.path("out.jsonl"), scratch.path("report.json"));
        let mut command = stgdat();
        command.args(["run", "--quiet", "--pipeline", &pipeline, "--forecasts", &out, "--report", &report]);
        command.args(["--set", &play, "--set", "source.ticks=120", "--set", "source.wall_clock=true"]);
        command.env("LD_PRELOAD", &library).env("STEP_FILE", scratch.path("step"));
        let run = Started::spawn(&mut command);
        run.wait_until_it_forecasts();
        scratch.file("step", "");
        let output = run.output();
        assert!(output.status.success(), "{step_s}: {}", stderr(&output));
        let log = stderr(&output);
        assert_eq!(log.matches("a new session begins").count(), 1, "{step_s}: {log}");
        let report: Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
        assert_eq!(report["sessions"]["count"], 2, "{step_s}: {report}");
        let lines = String::from_utf8(scratch.read("out.jsonl")).expect("text");
        let ticks = lines.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON lines"));
        let ticks: Vec<Value> = ticks.collect();
        let stamp_s = |tick: &Value| tick["stamp_ns"].as_i64().expect("a stamp") / 1_000_000_000;
        let first_s = stamp_s(&ticks[0]);
        let is_after = |tick: &&Value| (stamp_s(tick) - first_s - step_s).abs() < 30;
        let five = |tick: &&Value| tick["agents"].as_array().is_some_and(|agents| agents.len() == 5);
        assert!(ticks.iter().filter(is_after).filter(five).count() > 20, "{step_s}: {} ticks", ticks.len());
    }
}

const STEP: &str = r#"
use std::ffi::{c_char, c_int, c_long};

#[repr(C)]
pub struct Time {
    s: i64,
    ns: i64,
}

unsafe extern "C" {
    fn syscall(number: c_long, ...) -> c_long;
    fn getenv(name: *const c_char) -> *const c_char;
    fn access(path: *const c_char, mode: c_int) -> c_int;
}

#[unsafe(no_mangle)]
pub unsafe extern "C" fn clock_gettime(clock: c_int, time: *mut Time) -> c_int {
    let number = if cfg!(target_arch = "x86_64") { 228 } else { 113 };
    unsafe {
        let result = syscall(number, clock, time) as c_int;
        let file = getenv(c"STEP_FILE".as_ptr());
        if clock == 0 && result == 0 && !file.is_null() && access(file, 0) == 0 {
            (*time).s += STEP_S;
        }
        result
    }
}
"#;

#[test]
fn a_loop_has_forecasts_in_every_round() {
    let (report, agents) = run("clock_loop", &["source.ticks=40", "source.rounds=3"]);
    assert_eq!(report["sessions"]["count"], 3, "{report}");
    for round in agents.chunks(agents.len().div_ceil(3)) {
        assert!(round.iter().filter(|agents| **agents == 5).count() > 20, "{agents:?}");
    }
}

#[test]
fn a_silent_producer_is_named_when_it_is_back() {
    let (report, _) = run("silence", &["source.ticks=60", "source.pause=[30,2.5]"]);
    let reasons = reasons(&report);
    assert!(reasons.contains("no input for 2."), "{reasons}");
    assert_eq!((&report["silences"]["count"], &report["sessions"]["count"]), (&1.into(), &1.into()));
}
