//! `stgdat stage new`: a project that builds and runs.

use std::path::Path;

use recorder::Report;
use testing::Scratch;

use crate::started::{Started, piped, run, run_well, stderr, wait_for};

/// Builds a new project. Returns the path of its program and the text of its pipeline.toml.
fn built(scratch: &Scratch, name: &str, of: &str) -> (String, String) {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    run_well(&["stage", "new", name, "--of", of, "--dir", &scratch.path("")]);
    let profile = Path::new(env!("CARGO_BIN_EXE_stgdat")).parent().expect("a program lies in a folder");
    let target = profile.parent().expect("the folder of a profile lies in target");
    let mut build = piped(cargo);
    build
        .args(["build", "--offline", "--quiet"])
        .current_dir(scratch.path(name))
        .env("CARGO_TARGET_DIR", target);
    if profile.ends_with("release") {
        build.arg("--release");
    }
    let built = build.output().expect("cargo, which runs the tests, is there");
    assert!(built.status.success(), "{}", stderr(&built));
    let program = profile.join(name).display().to_string();
    let text = String::from_utf8(scratch.read(&format!("{name}/pipeline.toml"))).expect("UTF-8");
    (program.clone(), text.replace(&format!("target/release/{name}"), &program))
}

#[test]
fn added_stages_are_reported_and_come_back() {
    let scratch = Scratch::new("added");
    let (filter, text) = built(&scratch, "my_filter", "filter");
    let (monitor, lines) = built(&scratch, "my_monitor", "monitor");
    let added = lines.split_once("[[topic]]").expect("it declares a topic").1;
    let pipeline = scratch.file("both.toml", format!("{text}\n[[topic]]{added}"));
    let report = scratch.path("report.json");

    // In lockstep nothing is lost, neither on the ticks' path nor beside it.
    let scene = ["run", "--agents", "5", "--quiet", "--pipeline", &pipeline, "--report", &report];
    run_well(&[&scene[..], &["--ticks", "20", "--speed", "max"]].concat());
    let told = Report::read(report.as_ref()).expect("a report");
    for name in ["my_filter", "my_monitor"] {
        let stage = told.stages.iter().find(|stage| stage.name == name).unwrap_or_else(|| panic!("{told:?}"));
        assert_eq!((stage.ticks, stage.drops.total(), stage.restarts), (20, 0, 0), "{name}");
        assert!(stage.compute_ms.p50.is_some() && stage.budget_ms.is_some(), "{name}: {stage:?}");
    }
    assert_eq!((told.ticks, told.forecasts.held + told.hops_missing), (20, 0));

    // In real time both stages are restarted after a kill.
    let started = Started::run(&[&scene[1..], &["--ticks", "60"]].concat());
    let pid_of = |program: &str| {
        let stages = started.stages();
        stages.iter().find(|(_, line)| line[0] == program).map(|(pid, _)| *pid)
    };
    for program in [&filter, &monitor] {
        let pid = wait_for("the stage does not run", || pid_of(program));
        std::thread::sleep(std::time::Duration::from_secs(1));
        rustix::process::kill_process(pid, rustix::process::Signal::KILL).expect("it runs");
        wait_for("the stage does not come back", || pid_of(program).filter(|new| *new != pid));
    }
    let output = started.output();
    assert!(output.status.success(), "{}", stderr(&output));
    let told = Report::read(report.as_ref()).expect("a report");
    for name in ["my_filter", "my_monitor"] {
        let stage = told.stages.iter().find(|stage| stage.name == name).expect("it is reported");
        assert!(stage.restarts == 1 && stage.ticks > 20, "{name}: {stage:?}");
    }
    [filter, monitor]
        .into_iter()
        .for_each(|program| std::fs::remove_file(program).expect("it has been built"));
}

#[test]
fn a_new_project_builds_and_runs() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let scratch = Scratch::new("project");
    let folder = scratch.path("");
    run_well(&["stage", "new", "my_localiser", "--dir", &folder]);
    let project = scratch.path("my_localiser");
    let refused = run(&["stage", "new", "my_localiser", "--dir", &folder]);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("is there already"), "{}", stderr(&refused));

    // The project uses the workspace's build, so nothing is built twice.
    let profile = Path::new(env!("CARGO_BIN_EXE_stgdat")).parent().expect("a program lies in a folder");
    let target = profile.parent().expect("the folder of a profile lies in target");
    let mut build = piped(cargo);
    build.args(["build", "--offline", "--quiet"]).current_dir(&project).env("CARGO_TARGET_DIR", target);
    if profile.ends_with("release") {
        build.arg("--release");
    }
    let built = build.output().expect("cargo, which runs the tests, is there");
    assert!(built.status.success(), "{}", stderr(&built));

    let program = profile.join("my_localiser").display().to_string();
    let text = String::from_utf8(scratch.read("my_localiser/pipeline.toml")).expect("UTF-8");
    assert!(text.contains("command = [\"target/release/my_localiser\"]\n"), "{text}");
    let pipeline = scratch.file("mine.toml", text.replace("target/release/my_localiser", &program));
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
    std::fs::remove_file(program).expect("it has been built");
}
