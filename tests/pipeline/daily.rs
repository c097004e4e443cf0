//! Everyday use: closed pipes, files and misspelt verbs as arguments, colours.

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Map, Value};
use testing::Scratch;

use crate::started::{piped, run, run_well, stderr, stdout, stgdat};

/// An output without a reader.
fn closed() -> Stdio {
    let (reader, writer) = std::io::pipe().expect("there are descriptors");
    drop(reader);
    writer.into()
}

#[test]
fn a_closed_pipe_ends_verbs_quietly() {
    let scratch = Scratch::new("closed");
    let recording = scratch.recording("scene.csv", 12);
    for arguments in [
        &["graph"][..],
        &["wire", "--c"],
        &["--help"],
        &["--version"],
        &["check"],
        &["completions", "bash"],
        &["predict", &recording],
        &["track", &recording],
    ] {
        let output = stgdat().args(arguments).stdout(closed()).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
        assert!(!stderr(&output).contains("panicked"), "{arguments:?}: {}", stderr(&output));
    }
    // A failure keeps its exit code.
    let missing = stgdat().args(["predict", "missing.csv"]).stderr(closed()).output().unwrap();
    assert_eq!(missing.status.code(), Some(65));
}

#[test]
fn a_run_goes_on_after_its_output_has_closed() {
    let scratch = Scratch::new("unread");
    let report = scratch.path("report.json");
    let mut command = stgdat();
    command.args(["run", "--agents", "3", "--ticks", "15", "--report", &report]);
    let status = command.stdout(closed()).stderr(closed()).status().unwrap();
    assert_eq!(status.code(), Some(0));
    assert!(std::fs::read_to_string(&report).unwrap().contains("\"status\""));
}

#[test]
fn a_recording_or_its_folder_may_be_the_argument() {
    let scratch = Scratch::new("argument");
    let recording = scratch.recording("scene.csv", 8);
    let folder = std::path::Path::new(&recording).parent().unwrap().to_str().unwrap().to_owned();
    let speed = ["--speed", "max", "--quiet"];
    let named = stdout(&run_well(&[&["run", "--recording", &recording][..], &speed].concat()));
    let recording_line = |text: &str| text.lines().find(|line| line.contains("recording")).map(str::to_owned);
    for file in [&[recording.as_str()][..], &["run", &recording], &[&folder]] {
        let output = run_well(&[file, &speed].concat());
        assert_eq!(recording_line(&stdout(&output)), recording_line(&named), "{file:?}");
    }
    for (word, code, message) in [
        ("evalute", 2, "did you mean `stgdat evaluate`?"),
        ("missing.csv", 65, "missing.csv: No such file"),
        ("missing", 2, "no such verb and no such file"),
    ] {
        let output = run(&[word]);
        assert_eq!(output.status.code(), Some(code), "{word}");
        assert!(stderr(&output).contains(message), "{}", stderr(&output));
    }
    let output = run(&["evalute", &recording, "--all"]);
    assert!(stderr(&output).contains("did you mean `stgdat evaluate`?"), "{}", stderr(&output));
}

#[test]
fn a_seed_that_changes_nothing_is_noted() {
    let scratch = Scratch::new("seed");
    let recording = scratch.recording("scene.csv", 8);
    let note = "--seed changes nothing here";
    let predict = |more: &[&str]| stderr(&run_well(&[&["predict", recording.as_str()], more].concat()));
    assert!(predict(&["--seed", "4"]).contains(note));
    assert!(!predict(&[]).contains(note));
    assert!(!predict(&["--seed", "4", "--set", "sampler.propagation=monte-carlo"]).contains(note));
    let generated = run_well(&["run", "--agents", "2", "--ticks", "5", "--seed", "4"]);
    assert!(!stderr(&generated).contains(note));
}

#[test]
fn colours_appear_only_if_asked_for_or_on_a_terminal() {
    let is_colored = |arguments: &[&str], variables: &[(&str, &str)]| {
        let mut command = stgdat();
        command.args(["run", "--bogus"]).args(arguments).env_remove("NO_COLOR");
        let output = command.envs(variables.iter().copied()).output().unwrap();
        output.stderr.contains(&0x1b)
    };
    assert!(!is_colored(&[], &[]));
    assert!(is_colored(&["--color", "always"], &[("NO_COLOR", "1")]));
    assert!(is_colored(&[], &[("STGDAT_COLOR", "always")]));
    assert!(!is_colored(&["--color=never"], &[("STGDAT_COLOR", "always")]));
    // The log of a stage.
    let logged = |color: &str| {
        let arguments = ["run", "--agents", "2", "--ticks", "5", "--color", color];
        stgdat().args(arguments).env("RUST_LOG", "info").output().unwrap().stderr
    };
    assert!(!logged("never").contains(&0x1b) && !logged("auto").contains(&0x1b));
}

#[test]
fn the_log_of_a_run_is_json_if_asked_for() {
    let scratch = Scratch::new("log");
    // Every second detection of the vehicle repeats the previous one.
    let row = |sweep: u32| format!("{},1,vehicle,{},0\n", f64::from(sweep) * 0.1, f64::from(sweep / 2) * 2.0);
    let csv = "stamp_s,id,type,x_m,y_m\n".to_owned() + &(0..40).map(row).collect::<String>();
    let recording = scratch.file("repeated.csv", csv);
    // A stage that does not use our log.
    let shell = "echo 'the map is old' >&2; exec \"$0\" stage localiser";
    let localiser = ["sh", "-c", shell, env!("CARGO_BIN_EXE_stgdat")];
    let pipeline = scratch.pipeline_with("localiser", &localiser);
    let output = stgdat()
        .args(["--log", "json", "run", &recording, "--speed", "max", "--pipeline", &pipeline])
        .output()
        .unwrap();
    let object = |line: &str| serde_json::from_str::<Map<String, Value>>(line);
    let errors = stderr(&output);
    let lines: Vec<_> =
        errors.lines().map(|line| object(line).unwrap_or_else(|error| panic!("{line}: {error}"))).collect();
    let has = |line: &Map<String, Value>, key: &str| line.get(key).is_some_and(Value::is_string);
    assert!(lines.iter().all(|line| has(line, "timestamp") && has(line, "level") && has(line, "message")));
    let find = |target: &str| lines.iter().find(|line| line["target"] == target).expect(target);
    let of_stage = find("tracker::tally");
    assert_eq!((&of_stage["stage"], &of_stage["level"]), (&"tracker".into(), &"WARN".into()), "{of_stage:?}");
    assert!(of_stage["run"].as_str().unwrap().starts_with("stgdat_"), "{of_stage:?}");
    assert!(of_stage["tick"].as_u64().unwrap() < 40, "{of_stage:?}");
    let of_launcher = find("launch::arguments");
    assert!(of_launcher["message"].as_str().unwrap().contains("repeated"), "{of_launcher:?}");
    let foreign = find("output");
    assert_eq!((&foreign["stage"], &foreign["message"]), (&"localiser".into(), &"the map is old".into()));
    assert_eq!(foreign["run"], of_stage["run"]);
    // The last line of a command that fails, and no line that the variable excludes.
    let mut failing = stgdat();
    failing.args(["run", "missing.csv"]).env("RUST_LOG", "error").env("STGDAT_LOG", "json");
    let failure = object(stderr(&failing.output().unwrap()).trim()).unwrap();
    assert_eq!((&failure["level"], has(&failure, "message")), (&"ERROR".into(), true), "{failure:?}");
}

/// The program in its own folder, optionally with a different `stgdat-lab` beside it. PATH contains only this
/// folder.
fn copied(scratch: &Scratch, lab: Option<&str>) -> Command {
    let program = scratch.path("stgdat");
    std::fs::copy(env!("CARGO_BIN_EXE_stgdat"), &program).expect("the program can be copied");
    if let Some(script) = lab {
        let path = scratch.file("stgdat-lab", script);
        std::fs::set_permissions(path, Permissions::from_mode(0o755)).expect("the file is ours");
    }
    let mut command = piped(program);
    command.env("PATH", "/nowhere");
    command
}

#[test]
fn verbs_of_the_laboratory_are_run_by_it() {
    let script = "#!/bin/sh\necho \"$@\"\nexit 7\n";
    let beside = Scratch::new("lab-beside");
    let arguments = ["--color", "never", "fault", "run", "mine.toml", "--help"];
    let output = copied(&beside, Some(script)).args(arguments).output().unwrap();
    assert_eq!((output.status.code(), stdout(&output)), (Some(7), arguments.join(" ") + "\n"));

    let absent = Scratch::new("lab-absent");
    let output = copied(&absent, None).args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(69));
    assert!(stderr(&output).contains("cargo build --release --package stgdat-lab"), "{}", stderr(&output));

    // In PATH.
    let folder = Path::new(&beside.path("stgdat-lab")).parent().unwrap().to_owned();
    let output = copied(&absent, None).args(arguments).env("PATH", folder).output().unwrap();
    assert_eq!((output.status.code(), stdout(&output)), (Some(7), arguments.join(" ") + "\n"));
}
