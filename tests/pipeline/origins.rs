//! Maps and recordings with MGRS or UTM coordinates, from file to forecast.

use serde_json::Value;
use testing::{Scratch, lane};

use crate::started::{run, run_well, stderr, stdout};

/// A vehicle along the map's lane at 10 m/s, .3 m to the left of its middle, and the ego vehicle behind it.
fn recording([x0, y0]: [f64; 2]) -> String {
    let mut rows = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n".to_owned();
    for step in 0..100 {
        let (stamp_s, x, y) = (f64::from(step) / 10.0, x0 + 5.0 + f64::from(step), y0 + 0.3);
        rows += &format!("{stamp_s},1,vehicle,{x},{y},0,10\n{stamp_s},,ego,{},{y},0,\n", x - 20.0);
    }
    rows
}

/// The forecasts of `predict` with these arguments, relative to `origin`.
fn forecasts(file: &str, origin: [f64; 2]) -> Vec<[f64; 2]> {
    let text = std::fs::read_to_string(file).expect("forecasts");
    let mut points = Vec::new();
    for line in text.lines() {
        let line: Value = serde_json::from_str(line).expect("JSON");
        for agent in line["agents"].as_array().expect("agents") {
            let best = agent["best_m"].as_array().expect("steps").iter();
            let modes = agent["modes_m"].as_array().expect("modes").iter().flat_map(|mode| mode.as_array());
            for point in best.chain(modes.flatten()) {
                let at = |axis: usize| point[axis].as_f64().expect("a number") - origin[axis];
                points.push([at(0), at(1)]);
            }
        }
    }
    points
}

#[test]
fn forecasts_go_along_lanes_in_any_metric_frame() {
    let scratch = Scratch::new("origins");
    let predict = |name: &str, place: [f64; 2], options: &[&str]| {
        let map = scratch.file(&format!("{name}.osm"), lane(place));
        let recording = scratch.file(&format!("{name}.csv"), recording(place));
        let out = scratch.path(&format!("{name}.jsonl"));
        run_well(&[&["predict", &recording, "--lanes", &map, "--out", &out], options].concat());
        forecasts(&out, place)
    };
    let local = predict("local", [0.0; 2], &[]);
    assert!(local.len() > 1_000);
    for (name, place, origin) in [
        ("mgrs", [81_596.0, 50_194.0], "81596,50194"),
        ("mgrs-rounded", [97_250.5, 93_194.0], "97000,93000"),
        ("utm", [458_000.0, 5_428_000.0], "458000,5428000"),
        ("negative", [-40_000.0, -70_000.0], "-40000,-70000"),
    ] {
        let found = predict(name, place, &["--origin", origin]);
        assert_eq!(found.len(), local.len(), "{name}");
        // f32 resolves .03 mm within 512 m of the origin, and filters propagate this error.
        let most = local
            .iter()
            .zip(&found)
            .fold(0.0_f64, |most, (a, b)| most.max((a[0] - b[0]).abs()).max((a[1] - b[1]).abs()));
        assert!(most < 5e-3, "{name}: {most} m");
    }
}

#[test]
fn runs_and_tracks_are_in_the_frame_of_the_recording() {
    let scratch = Scratch::new("origin-run");
    let place = [81_596.0, 50_194.0];
    let map = scratch.file("site.osm", lane(place));
    let recording = scratch.file("a.csv", recording(place));
    let (in_process, of_run, tracks) =
        (scratch.path("p.jsonl"), scratch.path("r.jsonl"), scratch.path("t.csv"));
    let common = ["--origin", "81000,50000", "--lanes", &map];
    run_well(&[&["predict", &recording, "--out", &in_process][..], &common].concat());
    let played = ["run", "--speed", "max", "--quiet", "--recording", &recording, "--forecasts", &of_run];
    run_well(&[&played[..], &common].concat());
    assert!(scratch.read("p.jsonl") == scratch.read("r.jsonl"), "`run` and `predict` give the same bytes");
    run_well(&["track", &recording, "--origin", "81000,50000", "--out", &tracks]);
    let tracks = String::from_utf8(scratch.read("t.csv")).expect("text");
    assert!(tracks.contains("\n0,,ego,81581,50194.3,0,"), "{}", &tracks[..300]);
    assert!(tracks.contains("\n0,1,vehicle,81601,50194.3,0,10,"), "{}", &tracks[..300]);
}

#[test]
fn forecasts_along_lanes_are_counted_and_a_map_without_traffic_is_doubted() {
    let scratch = Scratch::new("touched");
    let map = scratch.file("site.osm", lane([0.0; 2]));
    for (name, place, is_touched) in [("on", [0.0; 2], true), ("off", [0.0, 1_000.0], false)] {
        let recording = scratch.file(&format!("{name}.csv"), recording(place));
        let (out, report) = (scratch.path("f.jsonl"), scratch.path("report.json"));
        let predicted = run_well(&["predict", &recording, "--lanes", &map, "--out", &out]);
        let played = ["run", "--speed", "max", "--quiet", "--recording", &recording, "--lanes", &map];
        let played = run_well(&[&played[..], &["--report", &report]].concat());
        let report: Value = serde_json::from_slice(&scratch.read("report.json")).expect("JSON");
        let [along, off] = ["along", "off"].map(|key| report["lanes"][key].as_u64().expect("a count"));
        let doubt = "no vehicle has been on a lane of the map";
        for output in [&predicted, &played] {
            assert_eq!(stderr(output).contains(doubt), !is_touched, "{name}: {}", stderr(output));
            let counted = format!("{along} forecasts along lanes, {off} of moving");
            assert!(stdout(output).contains(&counted), "{name}: {}", stdout(output));
        }
        assert_eq!((along > 50, off > 50), (is_touched, !is_touched), "{along} {off}");
        assert_eq!(report["verdict"]["reasons"].to_string().contains(doubt), !is_touched, "{report}");
    }
}

#[test]
fn coordinates_out_of_reach_name_the_option_that_fits() {
    let scratch = Scratch::new("origin-refused");
    let place = [81_596.0, 50_194.0];
    let map = scratch.file("site.osm", lane(place));
    let far = scratch.file("far.csv", recording(place));
    let near = scratch.file("near.csv", recording([0.0; 2]));
    for (arguments, expected) in [
        (["predict", &far], "--origin 81000,50000"),
        (["track", &far], "--origin 81000,50000"),
        (["predict", &near], "--lanes-origin 81000,50000m"),
    ] {
        let lanes = ["--lanes", &map];
        let with_lanes = if arguments[1] == near { &lanes[..] } else { &[] };
        let output = run(&[&arguments[..], with_lanes].concat());
        assert_eq!(output.status.code(), Some(65), "{arguments:?}");
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
    }
}
