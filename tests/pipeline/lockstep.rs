//! Generated scenes in lockstep: nothing is lost, runs repeat to the byte, and the report has its figures.

use serde_json::Value;
use testing::Scratch;

use crate::started::{Started, run_well, stderr};

/// The stages on the path of a forecast.
const PASSED: [&str; 7] = ["source", "tracker", "localiser", "extractor", "encoder", "decoder", "sampler"];

/// A number of the report, which must exist and be finite.
fn number(report: &Value, pointer: &str) -> f64 {
    let value = report.pointer(pointer).and_then(Value::as_f64);
    value.filter(|x| x.is_finite()).unwrap_or_else(|| panic!("no number at {pointer}: {report}"))
}

/// Runs a generated scene to its end. Returns its report and its forecasts, one line per tick.
fn lockstep(name: &str, ticks: usize, agents: usize) -> (Value, Vec<Value>) {
    let scratch = Scratch::new(name);
    let (report, forecasts) = (scratch.path("report.json"), scratch.path("forecasts.jsonl"));
    let (ticks, agents) = (ticks.to_string(), agents.to_string());
    let scene = ["run", "--ticks", &ticks, "--agents", &agents, "--speed", "max", "--quiet"];
    run_well(&[&scene[..], &["--report", &report, "--forecasts", &forecasts]].concat());
    let report = serde_json::from_slice(&scratch.read("report.json")).expect("the report is JSON");
    let lines = String::from_utf8(scratch.read("forecasts.jsonl")).expect("JSON lines are UTF-8");
    (report, lines.lines().map(|line| serde_json::from_str(line).expect("each line is JSON")).collect())
}

#[test]
fn the_report_has_what_scripts_rely_on() {
    let (report, lines) = lockstep("report", 160, 12);
    assert_eq!(report["ticks"], 160);
    assert!(report["late_ticks"].as_u64().is_some_and(|late| late <= 160), "{report}");
    assert_eq!(report["drops"], 0);
    assert_eq!(report["verdict"]["status"], "ok", "{}", report["verdict"]);

    let by_quality =
        ["learned", "held", "kinematic"].map(|quality| number(&report["forecasts"], &format!("/{quality}")));
    let written: usize = lines.iter().map(|line| line["agents"].as_array().map_or(0, Vec::len)).sum();
    assert_eq!(by_quality.iter().sum::<f64>(), written as f64, "every forecast is counted once");
    assert!(by_quality[0] > 12.0 * 60.0 && by_quality[1] == 0.0, "{by_quality:?}");

    let in_order = ["p50", "p99", "max"].map(|key| number(&report, &format!("/end_to_end_ms/{key}")));
    assert!(in_order[0] > 0.0 && in_order.is_sorted(), "{in_order:?}");
    let overhead_ms = ["p50", "p99"].map(|key| number(&report, &format!("/overhead_ms/{key}")));
    assert!(overhead_ms.is_sorted() && overhead_ms[0] < in_order[0], "{overhead_ms:?} of {in_order:?}");

    let stages = report["stages"].as_array().expect("a list of stages");
    assert_eq!(stages.iter().map(|stage| &stage["name"]).collect::<Vec<_>>(), PASSED);
    for stage in stages {
        let [p50, p99] = ["p50", "p99"].map(|key| number(stage, &format!("/compute_ms/{key}")));
        // The factor of 1.01 allows for the resolution of percentiles.
        assert!(0.0 <= p50 && p50 <= p99 && p99 <= 1.01 * in_order[2], "{stage} in {in_order:?} ms");
        assert!(number(stage, "/budget_ms") > 0.0, "{stage}");
    }

    assert_eq!(report["accuracy"]["draws"], 20);
    for key in ["ade_m", "fde_m", "cv_ade_m", "cv_fde_m"] {
        let error_m = number(&report["accuracy"], &format!("/{key}"));
        assert!(error_m > 0.0 && error_m < 100.0, "{key}: {error_m}");
    }
    assert!(number(&report, "/accuracy/forecasts") > 100.0, "100 ticks have truth for the whole horizon");
}

#[test]
fn a_full_scene_has_valid_forecasts_and_no_losses() {
    let (report, lines) = lockstep("full", 300, wire::AGENTS_MAX);
    assert_eq!((&report["ticks"], &report["drops"]), (&300.into(), &0.into()));
    assert!(number(&report, "/agents/max") > 120.0, "{}", report["agents"]);
    assert_eq!(report["forecasts"]["held"], 0);
    assert_eq!(lines.len(), 300);
    for (tick, line) in lines.iter().enumerate() {
        assert_eq!(line["seq"], tick);
        for agent in line["agents"].as_array().expect("a list of agents") {
            assert_valid(agent);
        }
    }
}

/// Asserts that a forecast has finite numbers, valid covariances and probabilities that sum to 1.
fn assert_valid(agent: &Value) {
    let probability = agent["probability"].as_array().expect("a list");
    let sum: f64 = probability.iter().filter_map(Value::as_f64).sum();
    assert!((sum - 1.0).abs() < 1e-4, "probabilities sum to {sum}: {agent}");
    assert_eq!(agent["modes_m"].as_array().map(Vec::len), Some(probability.len()), "{agent}");
    let here = [number(agent, "/x_m"), number(agent, "/y_m")];
    for (x_m, y_m) in points(&agent["modes_m"]).into_iter().chain(points(&agent["best_m"])) {
        // 128 m/s over the horizon: no agent of an intersection moves that far.
        assert!((x_m - here[0]).hypot(y_m - here[1]) < 600.0, "({x_m}, {y_m}) from {here:?}: {agent}");
    }
    for moments in agent["covariance_m2"].as_array().expect("a list") {
        let [xx, xy, yy] = [0, 1, 2].map(|i| number(moments, &format!("/{i}")));
        assert!(xx >= 0.0 && yy >= 0.0 && xy * xy <= xx * yy * 1.001 + 1e-6, "{moments}");
    }
}

/// All points of nested lists.
fn points(value: &Value) -> Vec<(f64, f64)> {
    let list = value.as_array().expect("a list");
    match list[..] {
        [Value::Number(_), Value::Number(_)] => vec![(number(value, "/0"), number(value, "/1"))],
        _ => list.iter().flat_map(points).collect(),
    }
}

#[test]
fn concurrent_runs_write_the_same_bytes_as_one_alone() {
    let scratch = Scratch::new("side-by-side");
    let start = |name: &str, seed: &str| {
        let scene = ["--ticks", "60", "--agents", "12", "--speed", "max", "--quiet", "--seed", seed];
        Started::run(&[&scene[..], &["--forecasts", &scratch.path(name)]].concat())
    };
    let end_well = |run: Started| {
        let output = run.output();
        assert!(output.status.success(), "{}", stderr(&output));
    };
    end_well(start("alone", "3"));
    let together = [start("a", "3"), start("b", "3"), start("other", "4")];
    together.into_iter().for_each(end_well);
    let alone = scratch.read("alone");
    assert_eq!(alone.iter().filter(|&&byte| byte == b'\n').count(), 60);
    assert!(alone == scratch.read("a") && alone == scratch.read("b"), "two runs of one seed differ");
    assert!(alone != scratch.read("other"), "two seeds, one scene");
}
