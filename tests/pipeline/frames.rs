//! Recordings of several sensors, with stamps per object, and with poses at another rate: all agents are in
//! every tick.

use std::fmt::Write as _;

use serde_json::Value;
use testing::Scratch;

use crate::started::run_well;

/// Three vehicles and two pedestrians along +x, 6 m apart.
const SPEEDS_MPS: [f64; 5] = [10.0, 8.0, 6.0, 1.4, 1.2];
const SWEEPS: u32 = 100;

/// Rows of ten seconds at 10 Hz. Each agent is measured at its offset after the sweep.
fn rows(offsets_s: [f64; 5], with_ids: bool) -> String {
    let mut csv = "stamp_s,id,type,x_m,y_m\n".to_owned();
    for sweep in 0..SWEEPS {
        for (agent, speed_mps) in SPEEDS_MPS.into_iter().enumerate() {
            let stamp_s = f64::from(sweep) * 0.1 + offsets_s[agent];
            let id = if with_ids { (agent + 1).to_string() } else { String::new() };
            let kind = if speed_mps < 2.0 { "pedestrian" } else { "vehicle" };
            let [x_m, y_m] = [speed_mps * stamp_s, 6.0 * agent as f64];
            writeln!(csv, "{stamp_s:.6},{id},{kind},{x_m:.4},{y_m}").expect("a string takes all");
        }
    }
    csv
}

/// Returns the number of ticks; the number of ticks with all five agents, after the first three ticks; and
/// two mean distances from the agents' true positions. The first distance is of the states, and the second of
/// the ends of the single best forecasts.
fn predicted(name: &str, csv: &str) -> (usize, usize, [f64; 2]) {
    let scratch = Scratch::new(name);
    let recording = scratch.file("own.csv", csv);
    let out = scratch.path("forecasts.jsonl");
    run_well(&["predict", &recording, "--out", &out]);
    let text = String::from_utf8(scratch.read("forecasts.jsonl")).expect("JSON is text");
    let (mut ticks, mut whole, mut off_m) = (0, 0, [Vec::new(), Vec::new()]);
    for line in text.lines() {
        let tick: Value = serde_json::from_str(line).expect("JSON lines");
        let number = |value: &Value| value.as_f64().expect("a number");
        let agents = tick["agents"].as_array().expect("agents");
        ticks += 1;
        whole += usize::from(ticks > 3 && agents.len() == 5);
        let stamp_s = number(&tick["stamp_ns"]) * 1e-9;
        for agent in agents.iter().filter(|_| stamp_s > 5.0) {
            let lane = (number(&agent["y_m"]) / 6.0).round();
            let steps = agent["best_m"].as_array().expect("steps");
            let end_s = stamp_s + steps.len() as f64 * number(&tick["step_s"]);
            let distance_m = |x_m: f64, y_m: f64, at_s: f64| {
                (x_m - SPEEDS_MPS[lane as usize] * at_s).hypot(y_m - 6.0 * lane)
            };
            off_m[0].push(distance_m(number(&agent["x_m"]), number(&agent["y_m"]), stamp_s));
            let end_m = &steps[steps.len() - 1];
            off_m[1].push(distance_m(number(&end_m[0]), number(&end_m[1]), end_s));
        }
    }
    (ticks, whole, off_m.map(|off_m| off_m.iter().sum::<f64>() / off_m.len() as f64))
}

#[test]
fn sensors_with_own_times_give_the_forecasts_of_one() {
    let (ticks, whole, [_, reference_m]) = predicted("frames-reference", &rows([0.0; 5], true));
    assert_eq!((ticks, whole), (100, 97));
    assert!(reference_m < 0.2, "{reference_m} m");
    let poses = |rate: u32| {
        let pose = |number: u32| {
            let stamp_s = f64::from(number) / f64::from(rate);
            format!("{stamp_s:.6},,ego,{:.3},-8\n", 5.0 * stamp_s)
        };
        (0..11 * rate).map(pose).collect::<String>()
    };
    let cases = [
        ("frames-30ms", rows([0.0, 0.0, 0.0, 0.03, 0.03], true)),
        ("frames-before", rows([0.03, 0.03, 0.03, 0.0, 0.0], true)),
        ("frames-three", rows([0.0, 0.045, 0.0, 0.03, 0.045], false)),
        ("frames-objects", rows([0.0, 0.02, 0.04, 0.06, 0.08], true)),
        ("frames-no-ids", rows([0.0, 0.02, 0.04, 0.06, 0.08], false)),
        ("frames-ego-50", rows([0.0013; 5], true) + &poses(50)),
        ("frames-ego-7", rows([0.0, 0.0, 0.0, 0.03, 0.03], true) + &poses(7)),
    ];
    for (name, csv) in cases {
        let (ticks, whole, [state_m, end_m]) = predicted(name, &csv);
        assert_eq!((ticks, whole), (100, 97), "{name}");
        assert!(state_m < 0.1, "{name}: states are {state_m} m off");
        assert!(end_m < reference_m + 0.1, "{name}: ends are {end_m} m off, {reference_m} m of one sensor");
    }
}
