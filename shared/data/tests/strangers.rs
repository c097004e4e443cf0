//! levelX and CommonRoad, by fixtures in the published layouts.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::f32::consts::{FRAC_PI_2, PI};
use std::path::{Path, PathBuf};

use data::{Format, Input, Recording, Role, open, parse};
use wire::{AgentType, Detection, detection_flags};

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

/// Opens a fixture and asserts its detected format.
fn read(name: &str, format: Format) -> Recording {
    let recording = open(&fixture(name), None).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(recording, open(&fixture(name), Some(format)).unwrap());
    assert!(recording.has_identities && recording.frames.is_sorted_by(|a, b| a.stamp_ns < b.stamp_ns));
    for frame in &recording.frames {
        frame.detections.iter().for_each(|detection| detection.check().unwrap());
        assert_eq!(frame.truth.len(), frame.detections.len());
        assert!(!frame.ego.is_sensor);
    }
    recording
}

/// The stamps in ms and the numbers of detections.
fn frames(recording: &Recording) -> Vec<(i64, usize)> {
    recording.frames.iter().map(|frame| (frame.stamp_ns / 1_000_000, frame.detections.len())).collect()
}

fn detection(recording: &Recording, frame: usize, id: u64) -> Detection {
    *recording.frames[frame].detections.iter().find(|detection| detection.id == id).expect("is there")
}

fn assert_state(detection: &Detection, expected: [f32; 4]) {
    let found = [detection.x_m, detection.y_m, detection.heading_rad, detection.speed_mps];
    for (found, expected) in found.into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-4, "{detection:?}");
    }
}

#[test]
fn levelx_joins_tracks_with_their_classes() {
    let recording = read("levelx/07_tracks.csv", Format::LevelX);
    assert_eq!((recording.interval_ns, recording.name.as_str()), (40_000_000, "levelx/07_tracks"));
    assert_eq!(frames(&recording), [(400, 2), (440, 3), (480, 3), (520, 3)]);
    let [car, rider, walker] = [0, 1, 2].map(|id| detection(&recording, 1, id));
    assert_eq!(car.agent_type, AgentType::Vehicle as u32);
    assert_state(&car, [40.4, -30.0, 0.0, 10.0]);
    assert_eq!((car.length_m, car.width_m), (4.516, 1.842));
    assert_eq!(rider.agent_type, AgentType::Cyclist as u32);
    assert_state(&rider, [12.0, -19.8, FRAC_PI_2, 5.0]);
    assert_eq!(walker.agent_type, AgentType::Pedestrian as u32);
    assert_state(&walker, [5.0, -8.0, PI, 1.25]);
    assert!(!walker.has(detection_flags::HAS_SIZE));
}

#[test]
fn highd_is_turned_into_a_right_handed_world_of_middles() {
    let recording = read("highd/01_tracks.csv", Format::HighD);
    assert_eq!((recording.interval_ns, frames(&recording)), (40_000_000, vec![(40, 2), (80, 3), (120, 1)]));
    let [car, truck, standing] = [1, 2, 3].map(|id| detection(&recording, 1, id));
    assert_state(&car, [363.86 + 2.425, -(21.68 + 1.06), 0.0, 40.0]);
    assert_eq!((car.length_m, car.width_m), (4.85, 2.12));
    // Towards −x and to its left, because the image's y points down.
    assert_state(&truck, [161.85 + 6.05, -10.65, -PI + 0.5_f32.atan2(22.5), 22.505554]);
    assert_state(&standing, [102.0, -10.4, PI, 0.0]);
}

#[test]
fn commonroad_2020a_has_dynamic_and_static_agents() {
    let recording = read("commonroad/ZAM_Fixture-1_1_T-1.2020a.xml", Format::CommonRoad);
    assert_eq!(recording.interval_ns, 100_000_000);
    assert_eq!(frames(&recording), [(0, 3), (100, 3), (200, 3)]);
    assert_state(&detection(&recording, 1, 200), [10.8, 0.0, 0.0, 8.0]);
    let walker = detection(&recording, 2, 201);
    assert_state(&walker, [20.0, -2.88, FRAC_PI_2, 1.2]);
    assert_eq!((walker.agent_type, walker.length_m), (AgentType::Pedestrian as u32, 0.6));
    assert_eq!(detection(&recording, 0, 202).agent_type, AgentType::Cyclist as u32);
    let parked = detection(&recording, 2, 300);
    assert_state(&parked, [15.0, -4.0, 0.02, 0.0]);
    assert!(!parked.has(detection_flags::HAS_SPEED), "none is given");
    let [left_out] = &recording.left_out[..] else { panic!("one kind: {:?}", recording.left_out) };
    assert_eq!((left_out.reason.as_str(), left_out.row_count), ("constructionZone", 1));
}

#[test]
fn commonroad_2018b_has_roles() {
    let recording = read("commonroad/ZAM_Fixture-2_1_T-1.2018b.xml", Format::CommonRoad);
    assert_eq!((recording.interval_ns, frames(&recording)), (40_000_000, vec![(0, 2), (40, 2)]));
    assert_state(&detection(&recording, 1, 7), [10.8, -0.08, -0.1, 20.0]);
    assert_eq!(detection(&recording, 1, 7).length_m, 12.0);
}

/// The error of a scenario with one text replaced.
fn commonroad_error(from: &str, to: &str) -> String {
    let text = std::fs::read_to_string(fixture("commonroad/ZAM_Fixture-1_1_T-1.2020a.xml")).unwrap();
    assert!(text.contains(from), "{from}");
    let input = Input::new(Role::Rows, "a.xml", text.replacen(from, to, 1));
    match parse(Format::CommonRoad, &[input]) {
        Ok(_) => panic!("{to}: read without an error"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn bad_values_of_commonroad_are_named_with_their_place() {
    let cases = [
        ("<x>10.8</x>", "<x>1e9</x>", "a.xml:20:29: x = \"1e9\": beyond ±32768 m"),
        ("<x>10.8</x>", "<x>\n  far</x>", "a.xml:21:3: x = \"far\": not a number"),
        (
            "timeStepSize=\"0.1\"",
            "timeStepSize=\"0\"",
            "a.xml:2:27: timeStepSize = \"0\": expected 0.001 to 10",
        ),
        ("timeStepSize=\"0.1\"", "", "a.xml:2:1: element = \"commonRoad\": needs timeStepSize"),
        (
            "<type>car</type>",
            "<type>boat</type>",
            "a.xml:10:11: type = \"boat\": no obstacle type of CommonRoad",
        ),
        ("<exact>1</exact>", "<exact>1.5</exact>", "a.xml:22:22: time = \"1.5\": not a whole number"),
        ("<time><exact>1</exact></time>", "", "a.xml:19:7: element = \"state\": needs time"),
        (
            "<time><exact>1</exact></time>",
            "<time><intervalStart>1</intervalStart></time>",
            "a.xml:22:9: element = \"time\": needs exact",
        ),
        ("<exact>8.0</exact>", "<exact>nan</exact>", "a.xml:16:24: velocity = \"nan\": not finite"),
        ("<exact>8.0</exact>", "<exact>300</exact>", "a.xml:16:24: velocity = \"300\": expected -120 to 120"),
        ("id=\"200\"", "id=\"-2\"", "a.xml:9:24: id = \"-2\": expected an id from 0"),
        (
            "<exact>2</exact>",
            "<exact>1</exact>",
            "a.xml:25: id 200 stands in this frame already, in a.xml:19",
        ),
        ("</commonRoad>", "</commonroad>", ": not XML: "),
        ("<commonRoad ", "<!DOCTYPE a [<!ENTITY b \"c\">]><commonRoad ", "not XML: XML with DTD detected"),
    ];
    for (from, to, expected) in cases {
        let error = commonroad_error(from, to);
        assert!(
            error.starts_with(expected) || expected.starts_with([':', 'n']) && error.contains(expected),
            "{error}"
        );
    }
}

#[test]
fn deep_and_empty_xml_is_refused_without_a_panic() {
    let root = "<commonRoad timeStepSize=\"0.1\">";
    let deep = root.to_owned() + &"<a>".repeat(200_000) + &"</a>".repeat(200_000) + "</commonRoad>";
    let cases = [
        (deep, "a.xml: no rows"),
        (format!("{root}</commonRoad>"), "a.xml: no rows"),
        ("<osm></osm>".to_owned(), "a.xml:1:1: root = \"osm\": expected commonRoad"),
        ("\n".to_owned(), "a.xml: no rows"),
        ("<!-- nothing -->".to_owned(), "a.xml:1:1: not XML"),
    ];
    for (text, expected) in cases {
        let input = Input::new(Role::Rows, "a.xml", text);
        let error = parse(Format::CommonRoad, &[input]).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

/// The inputs of a levelX recording with one text of one of them replaced.
fn levelx_error(folder: &str, role: Role, from: &str, to: &str) -> String {
    let number = if folder == "highd" { "01" } else { "07" };
    let files =
        [(Role::Rows, "tracks"), (Role::TracksMeta, "tracksMeta"), (Role::RecordingMeta, "recordingMeta")];
    let inputs = files.map(|(file_role, name)| {
        let text = std::fs::read_to_string(fixture(&format!("{folder}/{number}_{name}.csv"))).unwrap();
        assert!(file_role != role || text.contains(from), "{from}");
        let text = if file_role == role { text.replacen(from, to, 1) } else { text };
        Input::new(file_role, format!("{name}.csv"), text)
    });
    let format = if folder == "highd" { Format::HighD } else { Format::LevelX };
    match parse(format, &inputs) {
        Ok(_) => panic!("{to}: read without an error"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn bad_values_of_levelx_are_named_with_their_place() {
    let cases = [
        ("levelx", Role::Rows, ",xCenter,", ",x,", "tracks.csv:1:1: header = \"recordingId"),
        (
            "levelx",
            Role::Rows,
            "7,2,11",
            "7,9,11",
            "tracks.csv:10:3: trackId = \"9\": has no row in tracksMeta.csv",
        ),
        ("levelx", Role::Rows, "7,0,11", "7,0,-1", "tracks.csv:3:5: frame = \"-1\": expected 0 to"),
        ("levelx", Role::Rows, "7,0,11", "7,0,10", "tracks.csv:3: id 0 stands in this frame already"),
        ("levelx", Role::Rows, "40.40000", "far", "tracks.csv:3:10: xCenter = \"far\": not a number"),
        ("levelx", Role::Rows, ",0.00000\n", "\n", "tracks.csv:2:1: 16 columns, expected 17"),
        (
            "levelx",
            Role::TracksMeta,
            "bicycle",
            "horse",
            "tracksMeta.csv:3:22: class = \"horse\": expected car, van",
        ),
        (
            "levelx",
            Role::RecordingMeta,
            "25.0",
            "0",
            "recordingMeta.csv:2:5: frameRate = \"0\": no frame rate",
        ),
        (
            "levelx",
            Role::RecordingMeta,
            "\n7,1,25.0",
            "\n#",
            "recordingMeta.csv:2:1: 13 columns, expected 15",
        ),
        (
            "highd",
            Role::TracksMeta,
            "Car,2",
            "Car,3",
            "tracksMeta.csv:2:23: drivingDirection = \"3\": expected 1 or 2",
        ),
        ("highd", Role::Rows, "40.00", "400", "tracks.csv:2:28: xVelocity = \"400\": expected -120 to 120"),
        (
            "highd",
            Role::Rows,
            "362.26",
            "32767.9",
            "tracks.csv:2:5: x = \"32767.9\": the middle of the box lies",
        ),
    ];
    for (folder, role, from, to, expected) in cases {
        let error = levelx_error(folder, role, from, to);
        assert!(error.starts_with(expected), "{error}");
    }
}

#[test]
fn missing_files_of_levelx_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = std::fs::read(fixture("levelx/07_tracks.csv")).unwrap();
    let path = folder.path().join("07_tracks.csv");
    std::fs::write(&path, &tracks).unwrap();
    let error = open(&path, None).unwrap_err().to_string();
    assert!(
        error.contains("needs attributes of the tracks") && error.contains("07_tracksMeta.csv"),
        "{error}"
    );
    std::fs::copy(fixture("levelx/07_tracksMeta.csv"), folder.path().join("07_tracksMeta.csv")).unwrap();
    let error = open(&path, None).unwrap_err().to_string();
    assert!(error.contains("needs attributes of the recording"), "{error}");
    let renamed = folder.path().join("renamed.csv");
    std::fs::write(&renamed, &tracks).unwrap();
    let error = open(&renamed, None).unwrap_err().to_string();
    assert!(error.ends_with("the file's name does not end in _tracks.csv"), "{error}");
}
