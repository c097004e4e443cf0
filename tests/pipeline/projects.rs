//! `stgdat stage new`: a project that runs.

use recorder::Report;
use testing::Scratch;

use crate::programs::example;
use crate::started::{Started, piped, run, run_well, stderr, stdout, wait_for};

/// Creates a new project. Returns its program and the text of its pipeline.toml with this program. The
/// program is the example from which the project starts, because that example is already built.
fn made(scratch: &Scratch, name: &str, of: &str, begun_as: &str) -> (String, String) {
    run_well(&["stage", "new", name, "--of", of, "--dir", &scratch.path("")]);
    let text = String::from_utf8(scratch.read(&format!("{name}/pipeline.toml"))).expect("UTF-8");
    let (program, target) = (example(begun_as), format!("target/release/{name}"));
    assert!(text.contains(&format!("command = [\"{target}\"]\n")), "{text}");
    (program.clone(), text.replace(&target, &program))
}

#[test]
fn added_stages_are_reported_and_come_back() {
    let scratch = Scratch::new("added");
    let (filter, text) = made(&scratch, "my_filter", "filter", "speed_limiter");
    let (monitor, lines) = made(&scratch, "my_monitor", "monitor", "conflict_monitor");
    let added = lines.split_once("[[topic]]").expect("it declares a topic").1;
    let pipeline = scratch.file("both.toml", format!("{text}\n[[topic]]{added}"));
    let report = scratch.path("report.json");

    // Lockstep loses no tick, neither on the tick's path nor outside it.
    let scene = ["run", "--agents", "5", "--quiet", "--pipeline", &pipeline, "--report", &report];
    run_well(&[&scene[..], &["--ticks", "20", "--speed", "max"]].concat());
    let told = Report::read(report.as_ref()).expect("a report");
    for name in ["my_filter", "my_monitor"] {
        let stage = told.stages.iter().find(|stage| stage.name == name).unwrap_or_else(|| panic!("{told:?}"));
        assert_eq!((stage.ticks, stage.drops.total(), stage.restarts), (20, 0, 0), "{name}");
        assert!(stage.compute_ms.p50.is_some() && stage.budget_ms.is_some(), "{name}: {stage:?}");
    }
    assert_eq!((told.ticks, told.forecasts.held + told.hops_missing), (20, 0));

    // A real-time run restarts both stages after a kill.
    let started = Started::run(&[&scene[1..], &["--ticks", "60"]].concat());
    started.wait_until_it_forecasts();
    let pid_of = |program: &str| {
        let stages = started.stages();
        stages.iter().find(|(_, line)| line[0] == program).map(|(pid, _)| *pid)
    };
    for program in [&filter, &monitor] {
        let pid = wait_for("the stage does not run", || pid_of(program));
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
}

/// `stgdat` tests that the manifest has all crates of the program, and the workspace builds the program.
#[test]
fn a_new_project_resolves_and_runs() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let scratch = Scratch::new("project");
    let (_, pipeline) = made(&scratch, "my_localiser", "localiser", "area_localiser");
    let refused = run(&["stage", "new", "my_localiser", "--dir", &scratch.path("")]);
    assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("is there already"), "{}", stderr(&refused));

    // The pinned versions have all dependencies.
    let mut resolve = piped(cargo);
    resolve.args(["tree", "--offline", "--prefix", "none"]).current_dir(scratch.path("my_localiser"));
    let resolved = resolve.output().expect("cargo, which runs the tests, is there");
    assert!(resolved.status.success(), "{}", stderr(&resolved));
    assert!(stdout(&resolved).contains("stgdat-ports v"), "{}", stdout(&resolved));

    let pipeline = scratch.file("mine.toml", pipeline);
    let run = ["run", "--ticks", "15", "--agents", "6", "--speed", "max", "--quiet", "--pipeline", &pipeline];
    run_well(&run);
}
