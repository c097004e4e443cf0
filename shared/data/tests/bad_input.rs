//! Broken files of every format. Each gives an error with file, line, column and value. Readers never panic
//! and never skip a row.

use std::collections::BTreeSet;

use data::{Format, Input, ReadError, Recording, Role, parse};

const INTERACTION: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n\
    1,1,100,car,981.284,1018.604,-4.36,-5.41,-2.249,9.61,2.6\n\
    1,2,200,car,980.876,1018.042,-4.315,-5.457,-2.24,9.61,2.6\n";
const PEDESTRIANS: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy\n\
    P1,2,200,pedestrian/bicycle,980.56,1052.15,1.25,-0.5\n";
const PEDESTRIAN_POSITIONS: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y\n\
    P1,4,400,pedestrian/bicycle,980.56,1052.15\n";
const VEHICLES: &str = "id,frame,label,x_est,y_est,psi_est,vel_est\n0,22,veh,12.52,3.64,1.64,3.34\n";
const PEDESTRIAN_ROWS: &str = "id,frame,label,x_est,y_est,vx_est,vy_est\n0,22,ped,5.55,7.73,1.66,-0.01\n";
const VIDEO: &str = "0 789 399 815 436 0 0 0 0 \"Cart\"\n0 787 391 815 432 1 1 0 1 \"Cart\"\n";
const SCALES: &str = "deathCircle:\n   video2:\n      scale: 0.04\n      certainty: 1.0\n";
pub const CALIBRATION: &str = "P0: 1 0 0 0 0 1 0 0 0 0 1 0\n\
    R_rect 1 0 0 0 1 0 0 0 1\nTr_velo_cam 0 -1 0 0 0 0 -1 0 1 0 0 0\nTr_imu_velo 1 0 0 0 0 1 0 0 0 0 1 0\n";
pub const EGO_MOTION: &str = "49.0 8.4 112.8 0 0 0.5 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0.1 0.1 4 10 4 4 0\n";
pub const CARS: &str = "0,2,298.3,165.1,458.2,293.4,8.29,1.96,1.81,4.75,-4.57,1.84,13.53,-2.11,-1.78\n";
pub const LABELS: &str = "0 -1 DontCare -1 -1 -10 219 188 245 218 -1000 -1000 -1000 -10 -1 -1 -1\n\
    0 0 Van 0 0 -1.79 296.7 161.7 455.2 292.3 2.0 1.82 4.43 -4.55 1.85 13.41 -2.11\n";
const OWN: &str = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m,score,sigma_m\n\
    0.08,7,vehicle,12.5,-3.2,3.1,8.4,4.5,1.8,0.97,0.2\n0.00,,ego,1.0,2.0,0.5,,,,,\n";

const LEVELX: [&str; 3] = [
    include_str!("fixtures/levelx/07_tracks.csv"),
    include_str!("fixtures/levelx/07_tracksMeta.csv"),
    include_str!("fixtures/levelx/07_recordingMeta.csv"),
];
const HIGHD: [&str; 3] = [
    include_str!("fixtures/highd/01_tracks.csv"),
    include_str!("fixtures/highd/01_tracksMeta.csv"),
    include_str!("fixtures/highd/01_recordingMeta.csv"),
];
const COMMONROAD: &str = include_str!("fixtures/commonroad/ZAM_Fixture-1_1_T-1.2020a.xml");

fn levelx_files([tracks, tracks_meta, recording_meta]: [&str; 3]) -> Vec<Input> {
    vec![
        input(Role::Rows, "a.txt", tracks),
        input(Role::TracksMeta, "tracksMeta.csv", tracks_meta),
        input(Role::RecordingMeta, "recordingMeta.csv", recording_meta),
    ]
}

fn input(role: Role, path: &str, text: impl Into<Vec<u8>>) -> Input {
    Input::new(role, path, text)
}

fn rows(text: impl Into<Vec<u8>>) -> Vec<Input> {
    vec![input(Role::Rows, "a.txt", text)]
}

/// A small good recording of each format, the file with the rows first.
fn good() -> Vec<(Format, Vec<Input>)> {
    let sensors = || {
        [input(Role::Calibration, "calib.txt", CALIBRATION), input(Role::EgoMotion, "oxts.txt", EGO_MOTION)]
    };
    let scales = input(Role::Scales, "scales.yaml", SCALES);
    vec![
        (Format::EthUcy, rows("780\t1.0\t8.46\t3.59\n790\t1.0\t9.57\t3.79\n")),
        (Format::Obsmat, rows("7.8e+02 1.0 8.45 0.0 3.58 1.67 0.0 0.17\n")),
        (Format::SddTrajnet, rows("0 28.0 43.09 16.18\n12 28.0 41.55 16.12\n")),
        (Format::SddRaw, vec![input(Role::Rows, "deathCircle/video2/a.txt", VIDEO), scales]),
        (
            Format::Interaction,
            vec![input(Role::Vehicles, "a.txt", INTERACTION), input(Role::Pedestrians, "p.txt", PEDESTRIANS)],
        ),
        (
            Format::VciDut,
            vec![
                input(Role::Vehicles, "a.txt", VEHICLES),
                input(Role::Pedestrians, "p.txt", PEDESTRIAN_ROWS),
            ],
        ),
        (Format::KittiDetections, [vec![input(Role::Vehicles, "a.txt", CARS)], sensors().to_vec()].concat()),
        (Format::KittiLabels, [rows(LABELS), sensors().to_vec()].concat()),
        (Format::LevelX, levelx_files(LEVELX)),
        (Format::HighD, levelx_files(HIGHD)),
        (Format::CommonRoad, rows(COMMONROAD)),
        (Format::Csv, rows(OWN)),
    ]
}

fn with_rows(format: Format, text: impl Into<Vec<u8>>) -> Result<Recording, ReadError> {
    let (_, mut inputs) =
        good().into_iter().find(|(known, _)| *known == format).expect("all formats are known");
    inputs[0].bytes = text.into();
    parse(format, &inputs)
}

fn message(format: Format, text: impl Into<Vec<u8>>) -> String {
    match with_rows(format, text) {
        Ok(_) => panic!("{format}: read without an error"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn samples_of_every_format_are_read_and_detected() {
    // Frames, detections and left-out rows of each format (a lost box; a `DontCare` region).
    let counts = [
        [2, 2, 0],
        [1, 1, 0],
        [2, 2, 0],
        [1, 1, 1],
        [2, 3, 0],
        [1, 2, 0],
        [1, 1, 0],
        [1, 1, 1],
        [4, 11, 0],
        [3, 6, 0],
        [3, 9, 1],
        [1, 1, 0],
    ];
    for ((format, inputs), expected) in good().into_iter().zip(counts) {
        let recording = parse(format, &inputs).unwrap();
        let detection_count: usize = recording.frames.iter().map(|frame| frame.detections.len()).sum();
        let left_out_len: usize = recording.left_out.iter().map(|left_out| left_out.row_count).sum();
        assert_eq!([recording.frames.len(), detection_count, left_out_len], expected, "{format}");
        assert_eq!(Format::detect(&inputs[0]).unwrap(), format);
    }
}

#[test]
fn bad_values_are_named_with_file_line_and_column() {
    let cases = [
        (Format::EthUcy, "780\t1.0\t8.46\tabc\n", "a.txt:1:14: y = \"abc\": not a number"),
        (Format::EthUcy, "780\t1.0\tnan\t3\n", "a.txt:1:9: x = \"nan\": not finite"),
        (Format::EthUcy, "780\t1\t2\t3\n\n790\t1\tinf\t3\n", "a.txt:3:7: x = \"inf\": not finite"),
        (
            Format::EthUcy,
            "780\t1\t5412345\t3\n",
            "a.txt:1:7: x = \"5412345\": beyond ±32768 m of the origin: if all positions are like this one, \
             give an origin near them, --origin 5412000,0",
        ),
        (Format::EthUcy, "7.5\t1\t2\t3\n", "a.txt:1:1: frame = \"7.5\": not a whole number"),
        (Format::EthUcy, "-10\t1\t2\t3\n", "a.txt:1:1: frame = \"-10\": expected 0 to 10000000000"),
        (
            Format::EthUcy,
            "10\t-1\t2\t3\n",
            "a.txt:1:4: id = \"-1\": expected an id from 0 to 18446744073709551614",
        ),
        (Format::Obsmat, "780 1 8 0 3 1.6 x 0.1\n", "a.txt:1:17: vz = \"x\": not a number"),
        (Format::SddTrajnet, "0 28.0 4e999 16.1\n", "a.txt:1:8: x = \"4e999\": not finite"),
        (
            Format::SddRaw,
            "0 789 399 815 436 0 0 0 0 \"Dog\"\n",
            "deathCircle/video2/a.txt:1:27: label = \"\\\"Dog\\\"\": expected \"Pedestrian\", \"Biker\", \"Skater\", \
             \"Cart\", \"Car\" or \"Bus\"",
        ),
        (
            Format::SddRaw,
            "0 789 399 15 436 0 0 0 0 \"Car\"\n",
            "deathCircle/video2/a.txt:1:11: xmax = \"15\": less than the box's other side",
        ),
        (
            Format::SddRaw,
            "0 789 399 815 436 0 2 0 0 \"Car\"\n",
            "deathCircle/video2/a.txt:1:21: lost = \"2\": expected 0 or 1",
        ),
        (
            Format::KittiDetections,
            "0,1,298,165,458,293,8,1.9,1.8,4.7,-4.5,1.8,13,-2,-1\n",
            "a.txt:1:3: type = \"1\": expected 2, as in every row for a vehicle",
        ),
        (
            Format::KittiDetections,
            "7,2,298,165,458,293,8,1.9,1.8,4.7,-4.5,1.8,13,-2,-1\n",
            "a.txt:1:1: frame = \"7\": ego motion is known of frames 0 to 0",
        ),
        (
            Format::KittiDetections,
            "0,2,298,165,458,293,8,1.9,1.8,4.7,-4.5,1.8,1e300,-2,-1\n",
            "a.txt:1:35: x = \"-4.5\": stands nowhere near the car's first position",
        ),
        (
            Format::KittiLabels,
            "0 0 Ship 0 0 -1.7 296 161 455 292 2 1.8 4.4 -4.5 1.8 13 -2\n",
            "a.txt:1:5: type = \"Ship\": not a class of KITTI tracking",
        ),
    ];
    for (format, text, expected) in cases {
        assert_eq!(message(format, text), expected, "{format}");
    }
}

#[test]
fn an_error_has_its_place_as_fields() {
    let place = |text: &str| {
        let place = with_rows(Format::EthUcy, text.as_bytes()).unwrap_err().place();
        (place.path, place.line, place.value)
    };
    let of = |line, value: &str| ("a.txt".to_owned(), Some(line), Some(value.to_owned()));
    assert_eq!(place("780\t1\t2\t3\n\n790\t1\tinf\t3\n"), of(3, "inf"));
    assert_eq!(place("780\t1\t2\t3\n790\t1\t2\n"), of(2, "790\\t1\\t2"));
    assert_eq!(place("780\t4\t2\t3\n780\t4\t2\t3\n"), of(2, "4"));
    assert_eq!(place(""), ("a.txt".to_owned(), None, None));
    let missing = data::open("nowhere/b.csv".as_ref(), None).unwrap_err().place();
    assert_eq!((missing.path.as_str(), missing.line, missing.value), ("nowhere/b.csv", None, None));
}

#[test]
fn ids_have_64_bits_and_those_beyond_are_named() {
    let ids = [0, 1 << 63, u64::MAX - 1];
    let text: String = ids.iter().map(|id| format!("10\t{id}\t2\t3\n")).collect();
    let read = with_rows(Format::EthUcy, text.as_bytes()).unwrap();
    assert_eq!(read.frames[0].detections.iter().map(|detection| detection.id).collect::<Vec<_>>(), ids);
    let beyond = message(Format::EthUcy, format!("10\t{}\t2\t3\n", u64::MAX));
    assert!(beyond.ends_with("expected an id from 0 to 18446744073709551614"), "{beyond}");
}

#[test]
fn bad_values_below_a_header_are_named() {
    let interaction = |row: &str| message(Format::Interaction, format!("{}{row}\n", header(INTERACTION)));
    assert_eq!(
        interaction("1,1,100,car,981,1018,-4,-540,-2.2,9.6,2.6"),
        "a.txt:2:25: vy = \"-540\": expected -120 to 120"
    );
    assert_eq!(
        interaction("1,1,100,ship,9,1,-4,-5,-2,9,2"),
        "a.txt:2:9: agent_type = \"ship\": expected car"
    );
    assert_eq!(
        interaction("1,1,-3,car,9,1,-4,-5,-2,9,2"),
        "a.txt:2:5: timestamp_ms = \"-3\": expected 0 to 1000000000000"
    );
    assert_eq!(
        interaction("1,1,100,car,9,1,-4,-5,-2,-9,2"),
        "a.txt:2:26: length = \"-9\": expected 0 to 100"
    );
    let vci_dut = |row: &str| message(Format::VciDut, format!("{}{row}\n", header(VEHICLES)));
    assert_eq!(vci_dut("0,22,ped,12.5,3.6,1.6,3.3"), "a.txt:2:6: label = \"ped\": expected veh");
    assert_eq!(vci_dut("0,22,veh,12.5,3.6,,3.3"), "a.txt:2:19: psi_est = \"\": not a number");
    let own = |row: &str| message(Format::Csv, format!("{}{row}\n", header(OWN)));
    assert_eq!(own("1k,7,vehicle,1,2,,,,,,"), "a.txt:2:1: stamp_s = \"1k\": expected seconds like 12.08");
    assert_eq!(
        own("0.1,7,boat,1,2,,,,,,"),
        "a.txt:2:7: type = \"boat\": expected vehicle, cyclist, pedestrian, ego or above"
    );
    assert_eq!(
        own("0.1,7,vehicle,1,2,,,4.5,,,"),
        "a.txt:2:25: width_m = \"\": stands empty beside a length_m"
    );
    assert_eq!(
        own("99999999999,7,vehicle,1,2,,,,,,"),
        "a.txt:2:1: stamp_s = \"99999999999\": beyond ±4000000000 s"
    );
    for (zeros, unit) in [("000", "milliseconds"), ("000000", "microseconds"), ("000000000", "nanoseconds")] {
        assert_eq!(
            own(&format!("1700000000{zeros},7,vehicle,1,2,,,,,,")),
            format!(
                "a.txt:2:1: stamp_s = \"1700000000{zeros}\": beyond ±4000000000 s: it looks like {unit}, divide it by \
                 1{zeros}"
            )
        );
    }
    assert_eq!(
        own("0.1,7,vehicle,1,2,,,,,,\n0,,ego,0,0,,,,,,\n0,,above,1,1,,,,,,"),
        "a.txt:4:1: stamp_s = \"0\": has an ego or above row already, in line 3"
    );
}

fn header(sample: &str) -> String {
    format!("{}\n", sample.lines().next().expect("samples have lines"))
}

#[test]
fn bad_headers_are_named() {
    assert_eq!(
        message(Format::VciDut, "id,frame,x\n0,22,1\n"),
        "a.txt:1:1: header = \"id,frame,x\": expected \"id,frame,label,x_est,y_est,psi_est,vel_est\""
    );
    let own = |header: &str| message(Format::Csv, format!("{header}\n"));
    assert_eq!(own("stamp_s,type,x_m"), "a.txt:1:1: header = \"stamp_s,type,x_m\": needs a column y_m");
    assert_eq!(own("stamp_s,type,x_m,y_m,x_m"), "a.txt:1:22: header = \"x_m\": stands twice");
    assert!(
        own("stamp_s,type,x_m,y_m,z")
            .starts_with("a.txt:1:22: header = \"z\": no such column; known are stamp_s,id")
    );
}

#[test]
fn truncated_rows_are_errors() {
    for (format, inputs) in good() {
        let text = inputs[0].bytes.clone();
        let whole = parse(format, &inputs).unwrap();
        let detections = |recording: &Recording| -> usize {
            recording.frames.iter().map(|frame| frame.detections.len()).sum()
        };
        for cut in 0..text.len() {
            // A row that is cut may still be valid with a shorter number. No cut may cause a panic or give
            // more detections than the whole file.
            if let Ok(read) = with_rows(format, &text[..cut]) {
                assert!(detections(&read) <= detections(&whole), "{format} cut at {cut}");
            }
        }
        if format == Format::CommonRoad {
            let first = str::from_utf8(&text).unwrap().find("Obstacle>").unwrap();
            let error = message(format, &text[..first]);
            assert!(error.starts_with("a.txt:") && error.contains("not XML: "), "{error}");
            continue;
        }
        let last_row = String::from_utf8(text).unwrap();
        let separators: &[char] = if last_row.contains(',') { &[','] } else { &[' ', '\t'] };
        let cut = last_row.rfind(separators).unwrap();
        let error = message(format, &last_row.as_bytes()[..cut]);
        assert!(error.contains("columns, expected"), "{format}: {error}");
    }
}

#[test]
fn binary_and_empty_files_are_errors() {
    for (format, inputs) in good() {
        let name = &inputs[0].path;
        assert_eq!(
            message(format, b"\x7fELF\xff\xfe".as_slice()),
            format!("{name}:1: not text: byte 5 of the line is not UTF-8")
        );
        let mut tail = inputs[0].bytes.clone();
        let line_count = tail.iter().filter(|&&byte| byte == b'\n').count();
        tail.extend(b"\x80");
        assert_eq!(
            message(format, tail),
            format!("{name}:{}: not text: byte 1 of the line is not UTF-8", line_count + 1)
        );
        let zeros = message(format, vec![0_u8; 64]);
        assert!(zeros.starts_with(&format!("{name}:1:")), "{format}: {zeros}");
        // A sequence of KITTI without detections still has frames.
        if !matches!(
            format,
            Format::KittiDetections | Format::KittiLabels | Format::VciDut | Format::Interaction
        ) {
            assert_eq!(message(format, ""), format!("{name}: no rows"), "{format}");
        }
    }
}

#[test]
fn rows_in_any_order_are_read_and_duplicates_refused() {
    let has_rows =
        |(format, _): &(Format, Vec<Input>)| !matches!(format, Format::KittiDetections | Format::CommonRoad);
    for (format, inputs) in good().into_iter().filter(has_rows) {
        let text = String::from_utf8(inputs[0].bytes.clone()).unwrap();
        let has_header = matches!(
            format,
            Format::Interaction | Format::VciDut | Format::LevelX | Format::HighD | Format::Csv
        );
        let (top, body) =
            if has_header { text.split_at(text.find('\n').unwrap() + 1) } else { ("", text.as_str()) };
        let mut reversed: Vec<&str> = body.lines().collect();
        reversed.reverse();
        let read = with_rows(format, format!("{top}{}\n", reversed.join("\n"))).unwrap();
        assert_eq!(read.frames, parse(format, &inputs).unwrap().frames, "{format}");

        let row = body.lines().find(|row| !row.contains("DontCare")).unwrap();
        let error = with_rows(format, format!("{text}{row}\n")).unwrap_err();
        assert!(matches!(error, ReadError::Duplicate { .. }), "{format}: {error}");
    }
    let mixed = "stamp_s,id,type,x_m,y_m\n0,0,vehicle,1,1\n0,,vehicle,2,2\n0,0,vehicle,3,3\n";
    assert_eq!(message(Format::Csv, mixed), "a.txt:4: id 0 stands in this frame already, in a.txt:2");
    assert_eq!(
        message(Format::EthUcy, "780\t1\t8\t3\n790\t1\t9\t3\n780\t1\t8\t3\n"),
        "a.txt:3: id 1 stands in this frame already, in a.txt:1"
    );
}

#[test]
fn bad_companion_files_are_named() {
    let broken = |format: Format, role: Role, text: &str| {
        let (_, mut inputs) = good().into_iter().find(|(known, _)| *known == format).expect("known");
        let companion = inputs.iter_mut().find(|input| input.role == role).expect("has that file");
        companion.bytes = text.into();
        parse(format, &inputs).expect_err("broken").to_string()
    };
    let kitti = |role, text: &str| broken(Format::KittiDetections, role, text);
    assert_eq!(
        kitti(Role::Calibration, "R_rect 1 0 0\n"),
        "calib.txt:1:1: 4 columns, expected 10: \"R_rect 1 0 0\""
    );
    assert_eq!(
        kitti(Role::Calibration, "Q 1\n"),
        "calib.txt:1:1: key = \"Q\": not a key of a KITTI calibration"
    );
    assert_eq!(
        kitti(Role::Calibration, "R_rect 1 0 0 0 1 0 0 0 1\n"),
        "calib.txt: needs Tr_velo_cam, and there is none"
    );
    let singular = CALIBRATION.replace("R_rect 1", "R_rect 0");
    assert!(kitti(Role::Calibration, &singular).ends_with("the matrices have no inverse"));
    assert_eq!(kitti(Role::EgoMotion, ""), "oxts.txt: no rows");
    assert_eq!(
        kitti(Role::EgoMotion, &EGO_MOTION.replace("49.0", "149.0")),
        "oxts.txt:1:1: lat = \"149.0\": expected -85 to 85"
    );
    let sdd = |text: &str| broken(Format::SddRaw, Role::Scales, text);
    assert_eq!(
        sdd("gates:\n video2:\n  scale: 0.04\n"),
        "deathCircle/video2/a.txt: needs the scale of its scene and video, and there is none in scales.yaml"
    );
    assert_eq!(
        sdd("gates:\n video2:\n  scale: -1\n"),
        "scales.yaml:3:10: value = \"-1\": expected 0.0001 to 1"
    );
}

#[test]
fn interaction_pedestrian_rows_name_the_bad_value() {
    let error = |header: &str, row: &str| {
        let text = format!("{}{row}\n", self::header(header));
        let alone = [input(Role::Pedestrians, "p.txt", text.clone())];
        let beside = [input(Role::Vehicles, "a.txt", INTERACTION), input(Role::Pedestrians, "p.txt", text)];
        let [alone, beside] = [parse(Format::Interaction, &alone), parse(Format::Interaction, &beside)]
            .map(|read| read.expect_err("broken").to_string());
        assert_eq!(alone, beside);
        alone
    };
    let cases = [
        ("P1,1,100,pedestrian/bicycle,9,1,fast,0", "p.txt:2:33: vx = \"fast\": not a number"),
        ("P1,1,100,pedestrian/bicycle,9,1,0,-540", "p.txt:2:35: vy = \"-540\": expected -120 to 120"),
        (
            "P1,1,100,pedestrian/bicycle,9,1,110,110",
            "p.txt:2:33: vx = \"110\": a speed of 155.56349 m/s, at most 120 expected",
        ),
        ("P1,1,100,pedestrian/bicycle,9,,0,0", "p.txt:2:31: y = \"\": not a number"),
        ("P1,1,100,car,9,1,0,0", "p.txt:2:10: agent_type = \"car\": expected pedestrian/bicycle"),
        ("1,1,100,pedestrian/bicycle,9,1,0,0", "p.txt:2:1: track_id = \"1\": expected P and a number"),
        ("P1,1,1e2.5,pedestrian/bicycle,9,1,0,0", "p.txt:2:6: timestamp_ms = \"1e2.5\": not a number"),
        (
            "P1,1,100,pedestrian/bicycle,9,1,0",
            "p.txt:2:1: 7 columns, expected 8: \"P1,1,100,pedestrian/bicycle,9,1,0\"",
        ),
    ];
    for (row, expected) in cases {
        assert_eq!(error(PEDESTRIANS, row), expected);
    }
    assert_eq!(
        error(PEDESTRIAN_POSITIONS, "P1,1,100,pedestrian/bicycle,9,1,0,0"),
        "p.txt:2:1: 8 columns, expected 6: \"P1,1,100,pedestrian/bicycle,9,1,0,0\""
    );
    assert_eq!(
        error("track_id,frame_id,x,y", "P1,1,9,1"),
        "p.txt:1:1: header = \"track_id,frame_id,x,y\": expected \
         \"track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy\""
    );
}

#[test]
fn an_unknown_format_error_lists_the_known_ones() {
    let unknown = |text: &str| Format::detect(&rows(text)[0]).expect_err("fits none").to_string();
    assert_eq!(
        unknown("1 2 3\n"),
        "a.txt: the first row has 3 columns and is no header, such as stamp_s,id,type,x_m,y_m with commas, \
         semicolons or tabs; name the format (one of eth-ucy, obsmat, sdd-trajnet, sdd-raw, interaction, vci-dut, \
         kitti-detections, kitti-labels, levelx, highd, commonroad, rosbag, csv)"
    );
    assert!(
        unknown("stamp_s|id|type|x_m|y_m\n")
            .starts_with("a.txt: the first row has 1 column and is no header,")
    );
    assert!(
        unknown("0.0,1,vehicle,2.0,3.0,0,8\n").contains("7 columns and is no header, such as stamp_s,id")
    );
    assert!(unknown("7 1 2 3\n").starts_with("a.txt: frames are neither tens nor dozens;"));
    assert!(unknown("60 1 2 3\n").starts_with("a.txt: all frames are multiples of 60;"));
    assert_eq!(
        "kitti".parse::<Format>().unwrap_err().to_string(),
        format!("unknown format \"kitti\": expected one of {}", Format::names())
    );
    for format in Format::ALL {
        assert_eq!(format.to_string().parse(), Ok(format));
    }
}

#[test]
fn missing_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a/b/annotations.txt");
    let error = data::open(&path, None).unwrap_err().to_string();
    assert!(error.starts_with(&path.display().to_string()), "{error}");
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, VIDEO).unwrap();
    let error = data::open(&path, None).unwrap_err().to_string();
    let scales = folder.path().join("estimated_scales.yaml");
    assert_eq!(error, format!("{}: needs scales, and there is none at {}", path.display(), scales.display()));
    let error = data::open(folder.path(), None).unwrap_err().to_string();
    assert!(error.ends_with("not a regular file"), "{error}");
}

/// A scenario that is cut off is read up to its last whole obstacle.
#[test]
fn a_scenario_that_is_cut_off_keeps_its_whole_agents() {
    let whole = with_rows(Format::CommonRoad, COMMONROAD).unwrap();
    let agents = |recording: &Recording| -> BTreeSet<u64> {
        let detections = recording.frames.iter().flat_map(|frame| &frame.detections);
        detections.map(|detection| detection.id).collect()
    };
    let ends: Vec<usize> = COMMONROAD.match_indices("Obstacle>").map(|(at, end)| at + end.len()).collect();
    let mut read_count = 0;
    for cut in 0..COMMONROAD.find("</commonRoad>").unwrap() + 5 {
        let Ok(read) = with_rows(Format::CommonRoad, &COMMONROAD.as_bytes()[..cut]) else { continue };
        read_count += 1;
        assert!(agents(&read).is_subset(&agents(&whole)), "cut at {cut}");
        let last = ends.iter().rev().find(|end| **end <= cut).unwrap();
        let [found] = &read.findings[..] else { panic!("{:?}", read.findings) };
        assert!(found.kind == "cut_off" && found.doubtful, "{found:?}");
        assert!(found.sentence.contains(&format!("at byte {last} of {cut}")), "{found:?}");
    }
    assert!(read_count > 100, "{read_count}");
    assert!(whole.findings.is_empty());
}

/// A file that ends in the middle of a row is read up to this row, in every format of rows. A wrong row in the middle,
/// or one that a line break ends, is an error.
#[test]
fn a_row_that_is_cut_off_is_left_out_with_a_doubt() {
    let folder = tempfile::tempdir().unwrap();
    let row = |k: usize| {
        format!("{:.2},7,vehicle,{:.2},3.25,0.01,8.50,4.60,1.85\n", 0.1 * k as f64, 0.85 * k as f64)
    };
    let header = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m\n";
    let whole: String = header.to_owned() + &(0..30).map(row).collect::<String>();
    let open = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        data::open(&path, None)
    };
    let last = whole[..whole.len() - 1].rfind('\n').unwrap() + 1;
    for len in last + 1..last + 30 {
        let recording = open("cut.csv", &whole[..len]).unwrap();
        let kinds: Vec<_> = recording.findings.iter().map(|found| found.kind.as_str()).collect();
        assert_eq!((recording.frames.len(), &kinds[..]), (29, &["cut_off"][..]), "{len} bytes");
        let doubt = &recording.findings[0];
        assert!(doubt.doubtful && doubt.sentence.contains(&format!("byte {last} of {len}")), "{doubt:?}");
        let other = open("other.csv", &whole[..last]).unwrap();
        assert_eq!(other.frames, recording.frames, "{len} bytes");
        assert!(other.findings.is_empty() && other.sha256 != recording.sha256);
    }
    let ended = format!("{}\n", &whole[..last + 9]);
    let error = open("ended.csv", &ended).unwrap_err().to_string();
    assert!(error.contains("ended.csv:31:1: 3 columns, expected 9"), "{error}");
    let middle = whole.replacen("0.85,3.25", "0.85", 1);
    let error = open("middle.csv", middle.trim_end()).unwrap_err().to_string();
    assert!(error.contains("middle.csv:3:1: 8 columns"), "{error}");

    let trajnet =
        [("0", 1.0), ("12", 1.5), ("24", 2.0), ("36", 2.5)].map(|(frame, x)| format!("{frame} 1 {x} 4.25\n"));
    let text = trajnet.concat();
    let recording = open("rows.txt", &text[..text.len() - 6]).unwrap();
    assert_eq!((recording.frames.len(), recording.findings.len()), (3, 1));
}

#[test]
fn a_bag_without_its_beginning_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("headless.mcap");
    std::fs::write(&path, b"\x00\x01\xffrest of a bag\x89MCAP0\r\n").unwrap();
    let error = data::open(&path, None).unwrap_err().to_string();
    assert!(error.contains("beginning is missing or damaged"), "{error}");
}
