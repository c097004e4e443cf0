//! Tests of the program `stgdat-lab`: refused files, frame rates, origins, closed pipes.
#![expect(clippy::unwrap_used, reason = "a test ends at what it can't do")]

use std::fmt::Write as _;
use std::process::{Command, Output, Stdio};

use testing::Scratch;

/// Runs the program.
fn lab(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_stgdat-lab")).args(arguments).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs the program, which must succeed. Returns its standard error.
fn lab_well(arguments: &[&str]) -> String {
    let output = lab(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    stderr(&output)
}

fn assert_refused(arguments: &[&str], code: i32, text: &str) {
    let output = lab(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
    assert!(stderr(&output).contains(text), "{arguments:?}: {}", stderr(&output));
    assert!(output.stdout.is_empty(), "{arguments:?}: nothing to report");
}

#[test]
fn places_that_can_not_be_written_are_refused_before_any_work() {
    assert_refused(&["train", "--out", "no/such/folder/file"], 65, "no/such/folder: No such file");
    assert_refused(&["train", "--out", "."], 65, "is a directory");
}

#[test]
fn files_that_are_not_weights_are_refused() {
    let scratch = Scratch::new("lab-weights");
    let foreign = scratch.file("foreign.safetensors", "PNG and nothing else");
    assert_refused(&["card", &foreign], 65, "foreign.safetensors");
    assert_refused(&["card", "no/such.safetensors"], 65, "no/such.safetensors");
}

#[test]
fn options_that_a_target_does_not_use_are_refused() {
    for (target, option) in [
        ("eth-ucy", ["--parts", "seen"].as_slice()),
        ("interaction", &["--sigmas", "0.1"]),
        ("sdd", &["--particles"]),
        ("tracking", &["--positions"]),
        ("interaction", &["--format", "csv"]),
        ("sdd", &["--fps", "25"]),
    ] {
        let arguments = [&["evaluate", target], option].concat();
        assert_refused(&arguments, 2, &format!("{} is for ", option[0]));
    }
}

#[test]
fn a_precision_that_the_kernels_lack_is_refused() {
    let scratch = Scratch::new("lab-precision");
    let recording = scratch.recording("scene.csv", 5);
    let evaluate =
        |set: &str| ["evaluate", &recording, "--kernels", "portable", "--set", set].map(str::to_owned);
    for (set, code, text) in [
        ("decoder.precision=bf16", 78, "precision bf16 needs "),
        ("decoder.workers=2", 2, "evaluations set decoder.precision alone"),
    ] {
        let arguments = evaluate(set);
        assert_refused(&arguments.each_ref().map(String::as_str), code, text);
    }
}

#[test]
fn the_frame_rate_of_recordings_can_be_given() {
    let scratch = Scratch::new("lab-fps");
    let mut text = "id,frame,label,x_est,y_est,vx_est,vy_est\n".to_owned();
    for (frame, id) in (0..360).flat_map(|frame| (0..3).map(move |id| (frame, id))) {
        writeln!(text, "{id},{frame},ped,{:.4},{id}.0,1.4,0.0", 1.4 * f64::from(frame) / 29.97).unwrap();
    }
    let recording = scratch.file("walk_traj_ped_filtered.csv", &text);
    let out = scratch.path("site.map");
    for arguments in [&["evaluate", &recording, "--threads", "2"][..], &["map", &recording, "--out", &out]] {
        let usual = lab_well(arguments);
        assert!(usual.contains("warning: ") && usual.contains("at 29.97 frames a second"), "{usual}");
        let fitting = lab_well(&[arguments, &["--fps", "29.97"]].concat());
        assert!(!fitting.contains("warning: "), "{fitting}");
    }
}

#[test]
fn coordinates_out_of_reach_name_the_option_that_fits() {
    let scratch = Scratch::new("lab-origin");
    let mut text = "stamp_s,id,type,x_m,y_m,heading_rad\n".to_owned();
    for step in 0..120 {
        let time_s = f64::from(step) * 0.1;
        writeln!(text, "{time_s:.1},1,vehicle,{:.2},50194.0,0.0", 81_596.0 + 8.0 * time_s).unwrap();
    }
    let (far, out) = (scratch.file("far.csv", text), scratch.path("site.map"));
    assert_refused(&["evaluate", &far], 65, "--origin 81000,50000");
    lab_well(&["map", &far, "--origin", "81000,50000", "--out", &out]);
    let lanes = scratch.file("site.osm", testing::lane([81_596.0, 50_194.0]));
    lab_well(&["map", "--lanelet2", &lanes, "--origin", "81000,50000m", "--out", &out]);
}

#[test]
fn a_closed_pipe_ends_verbs_quietly() {
    let scratch = Scratch::new("lab-closed");
    let recording = scratch.recording("scene.csv", 30);
    let picture = scratch.path("scene.svg");
    for arguments in [&["manual"][..], &["card"], &["plot", "scene", &recording, "--out", &picture]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_stgdat-lab"));
        let output = command.args(arguments).stdout(Stdio::from(writer)).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
        assert!(!stderr(&output).contains("panicked"), "{arguments:?}: {}", stderr(&output));
    }
}
