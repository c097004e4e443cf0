//! The converters of `stgdat.datasets`, if Python is available: the program reads their output.
//!
//! `$STGDAT_PYTHON` replaces `python3`. Argoverse 2 needs a Python with pyarrow.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::f32::consts::{FRAC_PI_2, PI};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use data::{Recording, open};
use tempfile::TempDir;
use wire::{AgentType, Detection, detection_flags};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

fn python() -> Command {
    let mut command = Command::new(std::env::var("STGDAT_PYTHON").unwrap_or_else(|_| "python3".into()));
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command
}

/// Whether Python has a module. If not, prints that the test skips.
fn has(module: &str) -> bool {
    let found = python().args(["-c", &format!("import {module}")]).output();
    let found = found.is_ok_and(|output| output.status.success());
    if !found {
        testing::skip(format_args!("there is no python3 (or $STGDAT_PYTHON) with {module}"));
    }
    found
}

/// Runs a test's own script.
fn script(text: &str, arguments: &[&Path]) {
    let output = python().args(["-c", text]).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn convert(converter: &str, arguments: &[&str], out: &Path) -> Output {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../services/offline/python/stgdat/datasets");
    python().arg(folder).arg(converter).args(arguments).arg("--out").arg(out).output().unwrap()
}

/// The recording that a converter writes, and the converter's output.
fn converted(converter: &str, arguments: &[&str], out: &Path, name: &str) -> (Recording, String) {
    let output = convert(converter, arguments, out);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let recording = open(&out.join(name), None).unwrap_or_else(|error| panic!("{error}"));
    assert!(recording.has_identities);
    assert!(recording.frames.iter().all(|frame| frame.ego.is_sensor), "the ego sees");
    (recording, String::from_utf8(output.stdout).unwrap())
}

/// The error of a converter.
fn refused(converter: &str, arguments: &[&str], out: &Path) -> String {
    let output = convert(converter, arguments, out);
    assert_eq!(output.status.code(), Some(65), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stdout.is_empty() && std::fs::read_dir(out).unwrap().count() == 0, "nothing is written");
    String::from_utf8(output.stderr).unwrap()
}

/// The stamps in ms and the numbers of detections.
fn frames(recording: &Recording) -> Vec<(i64, usize)> {
    recording.frames.iter().map(|frame| (frame.stamp_ns / 1_000_000, frame.detections.len())).collect()
}

fn detection(recording: &Recording, frame: usize, agent_type: AgentType) -> Detection {
    let of_type = |detection: &&Detection| detection.agent_type == agent_type as u32;
    *recording.frames[frame].detections.iter().find(of_type).expect("is there")
}

fn assert_near(found: &[f32], expected: &[f32]) {
    let near = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 2e-3);
    assert!(near && found.len() == expected.len(), "{found:?}, expected {expected:?}");
}

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).to_str().unwrap().to_owned()
}

#[test]
fn nuscenes_scenes_are_converted() {
    if !has("json") {
        return;
    }
    let out = tempfile::tempdir().unwrap();
    let tables = fixture("nuscenes").to_str().unwrap().to_owned();
    let arguments = [tables.as_str(), "--scene", "scene-0001"];
    let (recording, printed) = converted("nuscenes", &arguments, out.path(), "scene-0001.csv");
    assert_eq!(frames(&recording), [(0, 2), (500, 2), (1000, 2)]);
    assert_eq!(recording.frames[2].stamp_ns, 1_000_153_000);
    assert!(printed.contains("3 frames, 3 agents; left out 1 movable_object.trafficcone, 1 vehicle.bicycle"));
    let car = detection(&recording, 1, AgentType::Vehicle);
    assert_near(&[car.x_m, car.y_m, car.heading_rad], &[420.0, 1205.0, FRAC_PI_2]);
    assert_near(&[car.length_m, car.width_m], &[4.6, 1.9]);
    assert!(!car.has(detection_flags::HAS_SPEED));
    assert_near(&[detection(&recording, 0, AgentType::Cyclist).heading_rad], &[-2.0]);
    let ego = recording.frames[1].ego;
    assert_near(&[ego.position_m[0], ego.position_m[1], ego.heading_rad], &[411.0, 1184.0, FRAC_PI_2]);
    assert!(!out.path().join("scene-0002.csv").exists(), "only the scene that was named");

    let other = tempfile::tempdir().unwrap();
    let error = refused("nuscenes", &[&tables, "--scene", "scene-9"], other.path());
    assert!(error.contains("scene.json: no scene scene-9"), "{error}");
    let broken = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(&tables).unwrap() {
        let entry = entry.unwrap();
        std::fs::copy(entry.path(), broken.path().join(entry.file_name())).unwrap();
    }
    let annotations = broken.path().join("sample_annotation.json");
    let text = std::fs::read_to_string(&annotations).unwrap();
    let cases = [
        (
            text.replacen("[420.0, 1200.0, 1.0]", "[420.0, \"x\", 1.0]", 1),
            "translation = [420.0, 'x', 1.0]: expected 3",
        ),
        (
            text.replacen("\"instance_token\": \"i-car\"", "\"instance_token\": \"i-?\"", 1),
            "instance.json: no record i-?",
        ),
        (text[..text.len() / 2].to_owned(), "sample_annotation.json:"),
        (text.replacen("[420.0, 1200.0, 1.0]", "[NaN, 1200.0, 1.0]", 1), "vehicle 1: x = nan: not finite"),
        (
            text.replacen("\"instance_token\": \"i-car\"", "\"instance_token\": [1]", 1),
            "instance_token = [1]: expected a text",
        ),
    ];
    for (text, expected) in cases {
        std::fs::write(&annotations, &text).unwrap();
        let goes_on = tempfile::tempdir().unwrap();
        let output = convert("nuscenes", &[broken.path().to_str().unwrap()], goes_on.path());
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(65) && error.starts_with("error: "), "{error}");
        assert!(error.contains(expected), "{error}");
        if text.ends_with(']') || text.ends_with("]\n") {
            assert!(
                error.contains("error: scene scene-0001: ") && error.ends_with("left out: 1, named above\n")
            );
            assert_eq!(written(&goes_on), ["scene-0002.csv"]);
        }
    }
}

/// The files in a folder.
fn written(folder: &TempDir) -> Vec<String> {
    let entries = std::fs::read_dir(folder.path()).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Makes the database of a log, with one text of its SQL replaced.
fn nuplan_log(folder: &TempDir, from: &str, to: &str) -> String {
    let sql = std::fs::read_to_string(fixture("nuplan/log.sql")).unwrap();
    assert!(sql.contains(from));
    let text = folder.path().join("log.sql");
    std::fs::write(&text, sql.replacen(from, to, 1)).unwrap();
    let log = folder.path().join("log.db");
    let _ = std::fs::remove_file(&log);
    let make = "import sqlite3, sys\nd = sqlite3.connect(sys.argv[2])\nd.executescript(open(sys.argv[1]).read())\nd.commit()";
    script(make, &[&text, &log]);
    log.to_str().unwrap().to_owned()
}

#[test]
fn nuplan_logs_are_converted() {
    if !has("sqlite3") {
        return;
    }
    let [work, out, other] = [(); 3].map(|()| tempfile::tempdir().unwrap());
    let log = nuplan_log(&work, "category", "category");
    let (recording, printed) = converted("nuplan", &[&log, "--every", "2"], out.path(), "log.csv");
    assert_eq!(frames(&recording), [(0, 3), (100, 3)]);
    assert!(printed.contains("2 frames, 3 agents; left out 2 traffic_cone"), "{printed}");
    let text = std::fs::read_to_string(out.path().join("log.csv")).unwrap();
    assert!(text.starts_with("# converted from log.db\n# origin_m: 664430.0 3996050.0\nstamp_s,"), "{text}");
    let ego = recording.frames[1].ego.position_m;
    assert_near(&ego, &[1.4, 0.7]);
    let car = detection(&recording, 1, AgentType::Vehicle);
    assert_near(&[car.x_m, car.y_m, car.heading_rad, car.speed_mps], &[21.2, 3.7, 0.0, 8.0]);
    assert_near(&[car.length_m, car.width_m], &[4.8, 2.0]);
    // The box of the pedestrian faces +x, but the pedestrian walks towards +y.
    let walker = detection(&recording, 1, AgentType::Pedestrian);
    assert_near(&[walker.heading_rad, walker.speed_mps], &[FRAC_PI_2, 1.2]);
    assert_near(&[detection(&recording, 0, AgentType::Cyclist).heading_rad], &[1.5]);

    let error = refused("nuplan", &[&log, "--origin", "none"], other.path());
    assert!(error.contains("beyond ±32768 m, --origin first"), "{error}");
    let goes_on = tempfile::tempdir().unwrap();
    let output = convert("nuplan", &[&path(&work, "log.sql"), "none.db", &log], goes_on.path());
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(65) && error.ends_with("left out: 2, named above\n"), "{error}");
    assert!(error.contains("log.sql: not a log") && error.contains("none.db: no such file"), "{error}");
    assert_eq!(written(&goes_on), ["log.csv"]);
    let strange = nuplan_log(&work, "'bicycle'", "'tram'");
    let error = refused("nuplan", &[&strange], other.path());
    assert!(error.contains("log.db: category.name = 'tram': no category of nuPlan"), "{error}");
    let error = refused("nuplan", &[&path(&work, "log.sql")], other.path());
    assert!(error.contains("log.sql: not a log of nuPlan: file is not a database"), "{error}");
    let few = convert("nuplan", &[&log, "--every", "0"], other.path());
    let error = String::from_utf8(few.stderr).unwrap();
    assert!(few.status.code() == Some(2) && error.contains("--every: 0: expected 1 to 100"), "{error}");
    let error = refused("nuplan", &[&path(&work, "none.db")], other.path());
    assert!(error.contains("none.db: no such file"), "{error}");
}

#[test]
fn argoverse_2_logs_are_converted() {
    if !has("pyarrow.feather") {
        return;
    }
    let [work, out, other] = [(); 3].map(|()| tempfile::tempdir().unwrap());
    let make = "import json, sys, pyarrow\nfrom pyarrow import feather\n\
        for name, rows in json.load(open(sys.argv[1])).items():\n    \
        feather.write_feather(pyarrow.Table.from_pylist(rows), sys.argv[2] + '/' + name + '.feather')";
    script(make, &[&fixture("argoverse2/log.json"), work.path()]);
    let log = work.path().to_str().unwrap();
    let name = format!("{}.csv", work.path().file_name().unwrap().to_str().unwrap());
    let (recording, printed) = converted("argoverse2_sensor", &[log], out.path(), &name);
    assert_eq!(frames(&recording), [(0, 2), (100, 2), (200, 2)]);
    assert!(printed.contains("3 frames, 2 agents; left out 1 BOLLARD"), "{printed}");
    // The ego looks along +y: ahead of it is north, and to its right is east.
    let car = detection(&recording, 1, AgentType::Vehicle);
    assert_near(&[car.x_m, car.y_m, car.heading_rad], &[5_003.0, 2_020.8, FRAC_PI_2]);
    let walker = detection(&recording, 2, AgentType::Pedestrian);
    assert_near(&[walker.x_m, walker.y_m, walker.heading_rad], &[4_996.0, 2_006.6, -FRAC_PI_2]);

    let goes_on = tempfile::tempdir().unwrap();
    let output = convert("argoverse2_sensor", &["no/such/log", log], goes_on.path());
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(65) && error.contains("no/such/log"), "{error}");
    assert_eq!(written(&goes_on), [name]);
    std::fs::write(work.path().join("city_SE3_egovehicle.feather"), "no feather").unwrap();
    let error = refused("argoverse2_sensor", &[log], other.path());
    assert!(error.contains("city_SE3_egovehicle.feather: not a feather file"), "{error}");
}

/// The bytes of a `Scenario`, by its published field numbers.
mod scenario {
    fn varint(mut value: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        while value >= 0x80 {
            bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        bytes.push(value as u8);
        bytes
    }

    pub fn integer(number: u64, value: u64) -> Vec<u8> {
        [varint(number << 3), varint(value)].concat()
    }

    pub fn bytes(number: u64, content: &[u8]) -> Vec<u8> {
        [varint(number << 3 | 2), varint(content.len() as u64), content.to_vec()].concat()
    }

    pub fn double(number: u64, value: f64) -> Vec<u8> {
        [varint(number << 3 | 1), value.to_le_bytes().to_vec()].concat()
    }

    pub fn float(number: u64, value: f32) -> Vec<u8> {
        [varint(number << 3 | 5), value.to_le_bytes().to_vec()].concat()
    }

    /// A state at (x, y) with a heading and a velocity.
    pub fn state([x_m, y_m]: [f64; 2], [heading_rad, vx_mps, vy_mps]: [f32; 3]) -> Vec<u8> {
        let numbers = [double(2, x_m), double(3, y_m), double(4, 30.0)].concat();
        let size = [float(5, 4.5), float(6, 1.9), float(7, 1.6)].concat();
        let motion = [float(8, heading_rad), float(9, vx_mps), float(10, vy_mps), integer(11, 1)].concat();
        bytes(3, &[numbers, size, motion].concat())
    }

    pub fn absent() -> Vec<u8> {
        bytes(3, &integer(11, 0))
    }

    pub fn track(identity: u64, kind: u64, states: &[Vec<u8>]) -> Vec<u8> {
        bytes(2, &[integer(1, identity), integer(2, kind), states.concat()].concat())
    }

    /// CRC-32C of a TFRecord, masked.
    fn masked_crc(data: &[u8]) -> u32 {
        let crc = !data.iter().fold(!0_u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0x82f6_3b78 * (crc & 1)))
        });
        crc.rotate_right(15).wrapping_add(0xa282_ead8)
    }

    /// A record of a TFRecord file.
    pub fn record(data: &[u8]) -> Vec<u8> {
        let len = (data.len() as u64).to_le_bytes();
        [&len[..], &masked_crc(&len).to_le_bytes(), data, &masked_crc(data).to_le_bytes()].concat()
    }
}

/// Three steps of the autonomous vehicle, a car, a pedestrian that appears late, and a sign.
fn waymo_scenario(name: &str, packed: bool) -> Vec<u8> {
    use scenario::{absent, bytes, double, integer, state, track};
    let stamps_s = [0.0, 0.1, 0.200_01];
    let stamps = if packed {
        bytes(1, &stamps_s.map(f64::to_le_bytes).concat())
    } else {
        stamps_s.map(|stamp_s| double(1, stamp_s)).concat()
    };
    let at = |x_m: f64, y_m: f64| [-47_000.5 + x_m, 8_000.25 + y_m];
    let steps = [0.0, 1.0, 2.0];
    let car = steps.map(|step| state(at(20.0 + step, 3.0), [0.0, 10.0, 0.1]));
    let walker = [absent(), state(at(5.0, -4.0), [1.0, -1.3, 0.0]), state(at(4.87, -4.0), [1.0, -1.3, 0.0])];
    let own = steps.map(|step| state(at(0.5 * step, 0.0), [0.1, 5.0, 0.5]));
    let sign = steps.map(|_| state(at(9.0, 9.0), [0.0; 3]));
    [
        stamps,
        track(17, 1, &car),
        track(4_000_000_000, 2, &walker),
        track(99, 1, &own),
        track(5, 4, &sign),
        integer(10, 1),
        integer(6, 2),
        bytes(5, name.as_bytes()),
        bytes(8, &integer(1, 3)),
    ]
    .concat()
}

#[test]
fn waymo_scenarios_are_converted() {
    if !has("struct") {
        return;
    }
    let [work, out, other] = [(); 3].map(|()| tempfile::tempdir().unwrap());
    let records = [("19a486cd29a0d7a7", false), ("b2", true)]
        .map(|(name, packed)| scenario::record(&waymo_scenario(name, packed)))
        .concat();
    let file = path(&work, "training.tfrecord");
    std::fs::write(&file, &records).unwrap();
    for (name, scenario) in [("19a486cd29a0d7a7.csv", "19a486cd29a0d7a7"), ("b2.csv", "b2")] {
        let arguments = [file.as_str(), "--scenario", scenario];
        let (recording, printed) = converted("waymo", &arguments, out.path(), name);
        assert_eq!(frames(&recording), [(0, 1), (100, 2), (200, 2)]);
        assert_eq!(recording.frames[2].stamp_ns, 200_010_000);
        assert!(printed.contains("3 frames, 2 agents; left out 3 other"), "{printed}");
        let car = detection(&recording, 1, AgentType::Vehicle);
        assert_near(&[car.x_m, car.y_m, car.heading_rad, car.speed_mps], &[21.5, 3.25, 0.0, 10.0]);
        let walker = detection(&recording, 1, AgentType::Pedestrian);
        assert_near(&[walker.x_m, walker.y_m, walker.heading_rad, walker.speed_mps], &[5.5, -3.75, PI, 1.3]);
        assert_near(&recording.frames[2].ego.position_m, &[1.5, 0.25]);
    }

    let first = scenario::record(&waymo_scenario("a", true));
    let cases: [(Vec<u8>, &str); 5] = [
        (first[..first.len() - 9].to_vec(), "byte 0: the file ends within a record"),
        (first[..7].to_vec(), "byte 0: the file ends within a record's length"),
        ([&first[..], b"no record at all"].concat(), &format!("byte {}: not a TFRecord", first.len())),
        (scenario::record(b"\x0a\xff"), "record at byte 0: not a Scenario message"),
        (scenario::record(&waymo_scenario("../a", true)), "record at byte 0: not a Scenario: no scenario_id"),
    ];
    for (bytes, expected) in cases {
        std::fs::write(&file, bytes).unwrap();
        let output = convert("waymo", &[&file], other.path());
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(65), "{error}");
        assert!(error.contains("training.tfrecord") && error.contains(expected), "{error}");
    }
    std::fs::write(&file, &first).unwrap();
    let none = tempfile::tempdir().unwrap();
    let error = refused("waymo", &[&file, "--scenario", "z"], none.path());
    assert!(error.contains("no scenario z in "), "{error}");
}

/// Position of a scenario's second stamp, packed.
const SECOND_STAMP: usize = 10;

#[test]
fn waymo_goes_on_after_a_scenario_that_can_not_be_converted() {
    if !has("struct") {
        return;
    }
    let work = tempfile::tempdir().unwrap();
    let good = |name: &str| scenario::record(&waymo_scenario(name, true));
    // The middle scenario lacks a stamp.
    let mut short = waymo_scenario("b", true);
    short[1] -= 8;
    short.drain(SECOND_STAMP..SECOND_STAMP + 8);
    let short = [good("a"), scenario::record(&short), good("c")].concat();
    let mut damaged = [good("a"), good("b"), good("c")].concat();
    damaged[good("a").len() + 40] ^= 1;
    let torn = [good("a"), good("b")[..50].to_vec()].concat();
    let files = ["short", "damaged", "torn", "whole"].map(|name| path(&work, name));
    for (file, content) in files.iter().zip([&short, &damaged, &torn, &good("d")]) {
        std::fs::write(file, content).unwrap();
    }
    let whole = files[3].as_str();
    let middle = good("a").len();
    let cases = [
        (0, vec!["a.csv", "c.csv", "d.csv"], "scenario b: track 99: 3 states, expected 2".to_owned()),
        (
            1,
            vec!["a.csv", "c.csv", "d.csv"],
            format!("record at byte {middle}: damaged: its checksum differs"),
        ),
        (2, vec!["a.csv", "d.csv"], format!("byte {middle}: the file ends within a record")),
    ];
    for (broken, names, expected) in cases {
        let out = tempfile::tempdir().unwrap();
        let output = convert("waymo", &[&files[broken], whole], out.path());
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(65), "{error}");
        assert!(error.contains(&expected) && error.ends_with("left out: 1, named above\n"), "{error}");
        assert_eq!(written(&out), names);
        let recording = open(&out.path().join("d.csv"), None).unwrap();
        assert_eq!(frames(&recording), [(0, 1), (100, 2), (200, 2)]);
    }
    let out = tempfile::tempdir().unwrap();
    let output = convert("waymo", &["no/such/file", whole], out.path());
    assert!(output.status.code() == Some(65) && written(&out) == ["d.csv"]);
}

#[test]
fn converters_explain_their_arguments() {
    if !has("argparse") {
        return;
    }
    let out = tempfile::tempdir().unwrap();
    for converter in ["argoverse2_sensor", "nuplan", "nuscenes", "waymo"] {
        let help = convert(converter, &["--help"], out.path());
        let text = String::from_utf8(help.stdout).unwrap();
        assert!(
            help.status.success() && text.contains("--origin X,Y") && text.contains("--out DIR"),
            "{text}"
        );
        let wrong = convert(converter, &["a", "--origin", "here"], out.path());
        let error = String::from_utf8(wrong.stderr).unwrap();
        assert!(
            wrong.status.code() == Some(2) && error.contains("'here': expected none, first or X,Y"),
            "{error}"
        );
    }
}
