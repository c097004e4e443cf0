//! External programs in a run: replaced stages, detectors and planners.

use std::path::Path;

use rustix::process::Signal;
use testing::Scratch;

use crate::python::{EXAMPLES, python};
use crate::started::{Started, assert_nothing_left, piped, run_well, stderr, stdout};

/// An example's program, which `cargo test --workspace` builds beside the tests.
pub fn example(name: &str) -> String {
    let path = Path::new(env!("CARGO_BIN_EXE_stgdat")).with_file_name("examples").join(name);
    assert!(
        path.exists(),
        "{} is missing: cargo build --release -p stgdat-examples --examples",
        path.display()
    );
    path.display().to_string()
}

#[test]
fn one_line_replaces_a_stage_by_an_external_program() {
    let scratch = Scratch::new("swap");
    let pipeline = scratch.pipeline_with("localiser", &[&example("area_localiser")]);
    let forecasts = |name: &str, arguments: &[&str]| {
        let file = scratch.path(name);
        let run =
            ["run", "--ticks", "40", "--agents", "10", "--speed", "max", "--quiet", "--forecasts", &file];
        run_well(&[&run[..], arguments].concat());
        scratch.read(name)
    };
    let area = |radius_m: &str| {
        let set = format!("localiser.radius_m={radius_m}");
        forecasts("area", &["--pipeline", &pipeline, "--set", &set])
    };
    let empty = area("1e-6");
    assert!(empty == forecasts("no-map", &["--map", "none"]), "an empty area is as good as no map");
    assert!(empty != area("20"), "the option reaches the program");
    assert!(empty != forecasts("shipped", &[]), "the stage that was swapped out is not what ran");
}

#[test]
fn every_stage_runs_as_a_command_of_its_own() {
    let scratch = Scratch::new("commands");
    for stage in ["encoder", "sampler"] {
        let pipeline = scratch.pipeline_with(stage, &[env!("CARGO_BIN_EXE_stgdat"), "stage", stage]);
        run_well(&["check", &pipeline]);
        run_well(&[
            "run",
            "--ticks",
            "15",
            "--agents",
            "6",
            "--speed",
            "max",
            "--quiet",
            "--pipeline",
            &pipeline,
        ]);
    }
}

/// Asserts that a consumer has printed forecasts with all modes of the detector's vehicle and pedestrian. The best
/// forecast of the vehicle, which drives straight on, may be constant velocity.
fn assert_forecasts_of_both(printed: &str) {
    let lines = |name: &str, quality: &str| {
        let lines = printed.lines().filter(|line| line.trim_start().starts_with(name));
        lines.filter(|line| line.contains("20 modes") && line.contains(quality)).count()
    };
    assert!(printed.lines().any(|line| line.ends_with(": 2 agents")), "{printed}");
    assert!(lines("vehicle", "") > 5 && lines("pedestrian", "learned") > 5, "{printed}");
}

/// Asserts that the pedestrian walks 5 m to the right of the position and that the car passes 2 m to its
/// left. Positions are printed to 0.1 m.
fn assert_around(printed: &str, [x_m, y_m]: [f64; 2]) {
    let positions = |kind: &'static str| {
        let of_kind = printed.lines().filter(move |line| line.trim_start().starts_with(kind));
        of_kind.filter_map(|line| {
            let (x, rest) = line.split_once(" at (")?.1.split_once(", ")?;
            Some([x.parse::<f64>().ok()?, rest.split_once(')')?.0.parse::<f64>().ok()?])
        })
    };
    assert!(positions("pedestrian").count() > 5, "{printed}");
    assert!(positions("pedestrian").all(|[x, _]| (x - x_m - 5.0).abs() < 0.2), "{printed}");
    assert!(positions("vehicle").all(|[_, y]| (y - y_m - 2.0).abs() < 0.2), "{printed}");
}

#[test]
fn a_detector_and_a_planner_in_rust_join_a_run() {
    let scratch = Scratch::new("rust");
    let pipeline = scratch.pipeline_with("source", &[&example("producer")]);
    let report = scratch.path("report.json");
    let origin = ["--origin", "458000,5428000.5"];
    let run = Started::run(
        &[&origin[..], &["--ticks", "60", "--pipeline", &pipeline, "--report", &report]].concat(),
    );
    let root = run.wait_until_it_runs();
    let consumer = Started::spawn(piped(example("consumer")).arg("--run").arg(&root));
    let consumed = consumer.output();
    assert!(consumed.status.success(), "{}", stderr(&consumed));
    assert_forecasts_of_both(&stdout(&consumed));
    assert_around(&stdout(&consumed), [458_000.0, 5_428_000.5]);
    let output = run.output();
    assert!(output.status.success(), "{}", stderr(&output));
    let report: serde_json::Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
    // A busy machine may lose a tick.
    assert!(report["ticks"].as_u64().is_some_and(|ticks| (50..=60).contains(&ticks)), "{report}");
    assert_nothing_left(&root);
}

#[test]
fn a_detector_and_a_planner_in_python_join_a_run() {
    let Some(python) = python() else { return };
    let examples = Path::new(EXAMPLES);
    let program = |name: &str| examples.join(name).display().to_string();
    let scratch = Scratch::new("python");
    let pipeline = scratch.pipeline_with("source", &[&python, &program("producer.py"), "60"]);
    let run = Started::run(&["--pipeline", &pipeline, "--origin", "-81000,50194.25"]);
    let root = run.wait_until_it_runs();
    let mut consumer = piped(&python);
    consumer.arg(program("consumer.py")).env("STGDAT_ROOT", &root).env_remove("STGDAT_PREFIX");
    let consumer = Started::spawn(&mut consumer);
    run.wait_until_it_forecasts();
    // A detector that pauses for longer than its readers' deadline can continue.
    run.signal_stage(&program("producer.py"), Signal::STOP);
    std::thread::sleep(std::time::Duration::from_millis(400));
    run.signal_stage(&program("producer.py"), Signal::CONT);
    let consumed = consumer.output();
    assert!(consumed.status.success(), "{}", stderr(&consumed));
    let output = run.output();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&consumed).lines().count() > 20, "{}", stdout(&consumed));
    assert_around(&stdout(&consumed), [-81_000.0, 50_194.25]);
    assert_nothing_left(&root);
}
