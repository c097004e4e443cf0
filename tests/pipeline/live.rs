//! Recordings that a producer sends live: tracks, forecasts and doubts are the same as with `predict`.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::Value;
use testing::Scratch;

use crate::programs::example;
use crate::python::{EXAMPLES, python};
use crate::started::run_well;

/// Sweeps for two checks of the tracker's audit.
const SWEEPS: u32 = 64;
/// Three vehicles and two pedestrians along +y, 6 m apart.
const SPEEDS_MPS: [f64; 5] = [10.0, 8.0, 6.0, 1.4, 1.2];
/// Largest distance between live and lockstep states. In lockstep the previous tick's forecasts move a state
/// to the next stamp; live, the newest forecasts that arrived in time do.
const APART_MAX_M: f64 = 0.3;

/// The pedestrians' sensor measures 30 ms later. One position of a pedestrian is 12 m off. Every other row of
/// the second vehicle repeats the previous one. Headings of the first vehicle are in degrees.
fn rows() -> String {
    let mut csv = "stamp_s,id,type,x_m,y_m,heading_rad\n".to_owned();
    for sweep in 0..SWEEPS {
        for (agent, speed_mps) in SPEEDS_MPS.into_iter().enumerate() {
            let is_vehicle = speed_mps > 2.0;
            let stamp_s = f64::from(sweep) * 0.1 + if is_vehicle { 0.0 } else { 0.03 };
            let measured_s = if agent == 1 { f64::from(sweep / 2) * 0.2 } else { stamp_s };
            let off_m = if (agent, sweep) == (3, 40) { 12.0 } else { 0.0 };
            let heading = if agent == 0 { "90" } else { "" };
            let kind = if is_vehicle { "vehicle" } else { "pedestrian" };
            let [x_m, y_m] = [6.0 * agent as f64 + off_m, speed_mps * measured_s];
            let written = writeln!(csv, "{stamp_s:.2},{},{kind},{x_m},{y_m:.3},{heading}", agent + 1);
            written.expect("a string takes all");
        }
    }
    csv
}

/// Position and speed of the published states, by stamp and identity.
fn states(lines: &[u8]) -> BTreeMap<i64, BTreeMap<u64, [f64; 3]>> {
    let number = |value: &Value| value.as_f64().expect("a number");
    let mut states = BTreeMap::new();
    for line in String::from_utf8_lossy(lines).lines() {
        let tick: Value = serde_json::from_str(line).expect("JSON lines");
        let state = |agent: &Value| {
            let speed_mps = number(&agent["vx_mps"]).hypot(number(&agent["vy_mps"]));
            let state = [number(&agent["x_m"]), number(&agent["y_m"]), speed_mps];
            (agent["source_id"].as_u64().expect("an identity"), state)
        };
        let agents = tick["agents"].as_array().expect("agents");
        let by_id: BTreeMap<u64, [f64; 3]> = agents.iter().map(state).collect();
        assert_eq!(by_id.len(), agents.len(), "no two tracks with the same identity");
        states.insert(tick["stamp_ns"].as_i64().expect("a stamp"), by_id);
    }
    states
}

/// The doubts of a report, by kind.
fn doubts(report: &[u8]) -> Vec<String> {
    let report: Value = serde_json::from_slice(report).expect("JSON");
    let findings = report["input"]["findings"].as_array().expect("findings").clone();
    let doubts = findings.iter().filter(|found| found["doubtful"] == true);
    let mut kinds: Vec<String> =
        doubts.map(|found| found["kind"].as_str().expect("a kind").to_owned()).collect();
    kinds.sort();
    kinds
}

#[test]
fn a_recording_that_a_producer_sends_gives_what_predict_gives() {
    let scratch = Scratch::new("live");
    let recording = scratch.file("own.csv", rows());
    let (out, report) = (scratch.path("offline.jsonl"), scratch.path("offline.json"));
    run_well(&["predict", &recording, "--out", &out, "--report", &report]);
    let offline = states(&scratch.read("offline.jsonl"));
    assert_eq!(doubts(&scratch.read("offline.json")), ["headings_in_degrees", "repeated"]);

    let in_python = format!("{EXAMPLES}/producer.py");
    let python = python();
    let mut producers = vec![vec![example("producer")]];
    producers.extend(python.map(|python| {
        vec![
            python,
            in_python,
            "--csv".to_owned(),
            recording.clone(),
            "--interval-ms".to_owned(),
            "100".to_owned(),
        ]
    }));
    for command in producers {
        let command: Vec<&str> = command.iter().map(String::as_str).collect();
        let pipeline = scratch.pipeline_with("source", &command);
        let play = format!("source.play={recording}");
        let options = if command.len() == 1 { vec!["--set", &play] } else { Vec::new() };
        let (out, report) = (scratch.path("live.jsonl"), scratch.path("live.json"));
        let run = ["run", "--quiet", "--pipeline", &pipeline, "--forecasts", &out, "--report", &report];
        run_well(&[&run[..], &options].concat());
        let live = states(&scratch.read("live.jsonl"));
        // A busy machine may lose ticks.
        assert!(live.len() > SWEEPS as usize / 2, "{command:?}: {} ticks", live.len());
        for (stamp_ns, agents) in live.iter().filter(|(stamp_ns, _)| **stamp_ns > 1_000_000_000) {
            let expected =
                offline.get(stamp_ns).unwrap_or_else(|| panic!("{command:?}: tick at {stamp_ns} ns"));
            let ids = |states: &BTreeMap<u64, [f64; 3]>| states.keys().copied().collect::<Vec<_>>();
            assert_eq!((ids(agents), agents.len()), (ids(expected), 5), "{command:?}: at {stamp_ns} ns");
            for (id, [x_m, y_m, speed_mps]) in agents {
                let [there_x_m, there_y_m, _] = expected[id];
                let apart_m = (x_m - there_x_m).hypot(y_m - there_y_m);
                assert!(apart_m < APART_MAX_M, "{command:?}: {id} is {apart_m} m apart at {stamp_ns} ns");
                let most_mps = 1.2 * SPEEDS_MPS[*id as usize - 1] + 0.5;
                assert!(*speed_mps < most_mps, "{command:?}: {id} at {speed_mps} m/s at {stamp_ns} ns");
            }
        }
        assert_eq!(doubts(&scratch.read("live.json")), ["headings_in_degrees", "repeated"], "{command:?}");
    }
}
