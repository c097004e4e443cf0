//! Recordings: `predict` in one process and `run` in eight write the same bytes, whatever the settings.

use crate::scratch::{Scratch, public_recording};
use crate::started::run_well;

/// Plays a recording with the same arguments through one process twice and through a lockstep run; all must write the
/// same. Returns it.
fn same_bytes(scratch: &Scratch, recording: &str, arguments: &[&str]) -> Vec<u8> {
    for name in ["once", "again"] {
        run_well(&[&["predict", recording, "--out", &scratch.path(name)], arguments].concat());
    }
    let file = scratch.path("run");
    let run = ["run", "--recording", recording, "--speed", "max", "--quiet", "--forecasts", &file];
    run_well(&[&run[..], arguments].concat());
    let once = scratch.read("once");
    assert!(!once.is_empty());
    assert!(once == scratch.read("again"), "predict twice: {arguments:?}");
    assert!(once == scratch.read("run"), "predict and run: {arguments:?}");
    once
}

/// Forecasts of the model itself in some JSON lines.
fn learned_len(lines: &[u8]) -> usize {
    String::from_utf8_lossy(lines).matches("\"quality\":\"learned\"").count()
}

#[test]
fn predict_and_run_write_the_same_bytes() {
    let scratch = Scratch::new("recording");
    let recording = scratch.recording("scene.csv", 50);
    let trusted = same_bytes(&scratch, &recording, &["--seed", "3", "--ticks", "45"]);
    assert_eq!(trusted.iter().filter(|&&byte| byte == b'\n').count(), 45);
    assert!(learned_len(&trusted) > 200, "{} learned forecasts", learned_len(&trusted));
    let associated = same_bytes(&scratch, &recording, &["--seed", "3", "--ticks", "45", "--associate"]);
    assert!(learned_len(&associated) > 200);
    assert!(trusted != associated, "tracks by position have numbers of their own");
}

#[test]
fn a_map_of_the_site_gives_the_same_bytes_too() {
    let scratch = Scratch::new("map");
    let recording = scratch.recording("scene.csv", 30);
    let map = scratch.path("site.map");
    run_well(&["map", &recording, "--out", &map]);
    let with_map = same_bytes(&scratch, &recording, &["--map", &map]);
    let without = same_bytes(&scratch, &recording, &["--map", "none"]);
    assert!(with_map != without, "the map tells the model something");
}

#[test]
fn predict_and_run_agree_on_public_recordings() {
    let names = [
        "interaction/recorded_trackfiles/DR_USA_Intersection_GL/vehicle_tracks_000.csv",
        "eth_ucy/raw/students001.txt",
    ];
    for (i, name) in names.into_iter().enumerate() {
        let Some(recording) = public_recording(name) else { continue };
        let scratch = Scratch::new(&format!("public-{i}"));
        let lines = same_bytes(&scratch, &recording, &["--seed", "3", "--ticks", "80"]);
        assert_eq!(lines.iter().filter(|&&byte| byte == b'\n').count(), 80, "{name}");
        assert!(learned_len(&lines) > 80, "{name}: {} learned forecasts", learned_len(&lines));
    }
}
