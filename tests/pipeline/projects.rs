//! `stgdat stage new`: a project that builds and runs.

use std::path::Path;

use crate::scratch::Scratch;
use crate::started::{piped, run, run_well, stderr};

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

    // What the workspace has built is not built again.
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
