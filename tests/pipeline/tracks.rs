//! Tracks as files: `track` in all formats, and tracks as recordings.

use std::collections::BTreeSet;
use testing::Scratch;

use crate::started::{Started, run, run_well, stderr, stdout, stgdat};

/// The rows of agents, split at commas. The first line of a CSV names the columns.
fn rows(text: &str) -> Vec<Vec<&str>> {
    text.lines().map(|line| line.split(',').collect()).collect()
}

#[test]
fn tracks_can_be_played_as_a_recording() {
    let scratch = Scratch::new("tracks");
    let recording = scratch.recording("scene.csv", 40);
    let path = scratch.path("tracks.csv");
    run_well(&["track", &recording, "--associate", "--out", &path]);
    let text = String::from_utf8(scratch.read("tracks.csv")).expect("CSV is text");
    let rows_of_tracks = rows(&text);
    let agents = || rows_of_tracks[1..].iter().filter(|row| row[2] != "above");
    assert_eq!(rows_of_tracks[1..].iter().filter(|row| row[2] == "above").count(), 40, "a frame per tick");
    assert!(agents().count() > 200, "{} rows", agents().count());
    assert!(agents().all(|row| ["confirmed", "coasting"].contains(&row[12])), "{text}");

    // If the tracks are played again, they keep their ids, and the same number of agents is at the same
    // positions.
    let again = stdout(&run_well(&["track", &path, "--as", "mot"]));
    let ids = |rows: &mut dyn Iterator<Item = &str>| rows.map(str::to_owned).collect::<BTreeSet<_>>();
    let first_ids = ids(&mut agents().map(|row| row[1]));
    let again = rows(&again);
    assert!(again.iter().all(|row| row.len() == 10 && row[2..6] == ["-1"; 4]), "{again:?}");
    assert_eq!(ids(&mut again.iter().map(|row| row[1])).len(), first_ids.len());
}

#[test]
fn the_learned_prior_changes_tracks() {
    let scratch = Scratch::new("tracks-prior");
    let recording = scratch.recording("scene.csv", 40);
    let tracks = |prior: &str| {
        stdout(&run_well(&[
            "track",
            &recording,
            "--associate",
            "--set",
            &format!("tracker.prior={prior}"),
            "--as",
            "mot",
        ]))
    };
    let learned = tracks("learned");
    assert_eq!(learned, tracks("learned"), "the same bytes twice");
    assert_ne!(learned, tracks("kinematic"));
}

#[test]
fn output_can_be_appended_by_a_shell() {
    let scratch = Scratch::new("tracks-appended");
    let recording = scratch.recording("scene.csv", 5);
    let path = scratch.path("all.jsonl");
    std::fs::write(&path, "before\n").expect("a scratch folder");
    for arguments in [&["predict"][..], &["predict", "--out", "/dev/stdout"]] {
        let file = std::fs::File::options().append(true).open(&path).expect("just written");
        let output = Started::spawn(stgdat().args(arguments).arg(&recording).stdout(file)).output();
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let text = String::from_utf8(scratch.read("all.jsonl")).expect("JSON is text");
    assert!(text.starts_with("before\n{"), "{text}");
    assert_eq!(text.lines().count(), 11);
}

#[test]
fn kitti_results_need_a_kitti_sequence() {
    let scratch = Scratch::new("tracks-kitti");
    let recording = scratch.recording("scene.csv", 5);
    let out = scratch.path("out.txt");
    let output = run(&["track", &recording, "--as", "kitti", "--out", &out]);
    assert_eq!(output.status.code(), Some(65));
    let text = stderr(&output);
    assert!(text.contains("--as kitti needs a sequence of KITTI") && text.contains("calib"), "{text}");
    assert!(!std::path::Path::new(&out).exists());
}
