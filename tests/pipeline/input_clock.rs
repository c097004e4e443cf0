//! A live producer whose clock is set, or which is silent for a while.

use serde_json::Value;
use testing::Scratch;

use crate::programs::example;
use crate::started::run_well;

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
    for (name, back_s) in [("clock_half", 0.5), ("clock_ten", 10.0)] {
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
