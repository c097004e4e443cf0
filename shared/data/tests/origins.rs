//! Recordings far from the origin of their frame: UTM, MGRS.

use data::{Format, Input, OpenOptions, ReadError, Recording, Role, open_with, parse};
use wire::WorldOrigin;

const COMMONROAD: &str = include_str!("fixtures/commonroad/ZAM_Fixture-1_1_T-1.2020a.xml");

fn origin(text: &str) -> WorldOrigin {
    text.parse().expect("an origin")
}

fn read(format: Format, role: Role, text: &str, less: &str) -> Result<Recording, ReadError> {
    parse(format, &[Input { origin: origin(less), ..Input::new(role, "a.txt", text) }])
}

/// A file of each format with a world frame, with positions around a point.
fn files([x0, y0]: [f64; 2]) -> Vec<(Format, Role, String)> {
    let at = |x: f64, y: f64| [x0 + x, y0 + y];
    let [[ax, ay], [bx, by]] = [at(1.25, -2.5), at(2.125, -2.5)];
    vec![
        (
            Format::Csv,
            Role::Rows,
            format!(
                "stamp_s,id,type,x_m,y_m\n0,1,vehicle,{ax},{ay}\n0,,ego,{bx},{by}\n0.1,1,vehicle,{bx},{by}\n"
            ),
        ),
        (Format::EthUcy, Role::Rows, format!("780\t1\t{ax}\t{ay}\n790\t1\t{bx}\t{by}\n")),
        (Format::Obsmat, Role::Rows, format!("780 1 {ax} 0 {ay} 1 0 1\n786 1 {bx} 0 {by} 1 0 1\n")),
        (
            Format::Interaction,
            Role::Vehicles,
            format!(
                "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n\
                 1,1,100,car,{ax},{ay},8.7,0,0,4,2\n1,2,200,car,{bx},{by},8.7,0,0,4,2\n"
            ),
        ),
        (
            Format::VciDut,
            Role::Vehicles,
            format!(
                "id,frame,label,x_est,y_est,psi_est,vel_est\n0,22,veh,{ax},{ay},0,8\n0,23,veh,{bx},{by},0,8\n"
            ),
        ),
    ]
}

#[test]
fn an_origin_is_subtracted_before_rounding_in_each_format() {
    for (corner, less) in [
        ([458_000.0, 5_428_000.0], "458000,5428000"),
        ([81_596.5, 50_194.25], "81596.5,50194.25m"),
        ([-90_000.0, -40_000.0], "-90000,-40000"),
    ] {
        for ((format, role, text), (_, _, near)) in files(corner).into_iter().zip(files([0.0; 2])) {
            let moved =
                read(format, role, &text, less).unwrap_or_else(|error| panic!("{}: {error}", format.name()));
            let plain =
                read(format, role, &near, "0,0").unwrap_or_else(|error| panic!("{}: {error}", format.name()));
            assert_eq!(moved.frames, plain.frames, "{format} {less}");
            assert_eq!([moved.frames[0].detections[0].x_m, moved.frames[0].detections[0].y_m], [1.25, -2.5]);
        }
    }
    let [x, y] = [458_000.000_125, 5_428_000.0];
    let text = format!("stamp_s,id,type,x_m,y_m\n0,1,vehicle,{x},{y}\n");
    let read = read(Format::Csv, Role::Rows, &text, "458000,5428000").expect("a recording");
    assert!((read.frames[0].detections[0].x_m - 0.000_125).abs() < 1e-7, "f32 would lose 1/8 mm here");
}

#[test]
fn a_position_out_of_reach_names_an_origin_that_fits() {
    for (corner, less, fitting) in [
        ([458_321.0, 5_428_999.5], "0,0", "--origin 458000,5428000"),
        ([-40_500.0, 10.0], "0,0", "--origin -41000,0"),
        ([10.0, 93_000.0], "0,0", "--origin 0,92000"),
        ([0.0, 0.0], "458000,5428000", "--origin 0,-1000"),
    ] {
        for (format, role, text) in files(corner) {
            let error = read(format, role, &text, less).expect_err(format.name()).to_string();
            assert!(error.contains("beyond ±32768 m of the origin: if all"), "{format}: {error}");
            assert!(error.ends_with(fitting), "{format}: {error}");
            let named = fitting.trim_start_matches("--origin ");
            assert!(read(format, role, &text, named).is_ok(), "{format}: {named}");
        }
    }
}

#[test]
fn scenarios_of_commonroad_take_an_origin() {
    let plain = read(Format::CommonRoad, Role::Rows, COMMONROAD, "0,0").expect("a scenario");
    let moved = read(Format::CommonRoad, Role::Rows, COMMONROAD, "100.5,-7").expect("a scenario");
    let all = |recording: &Recording| {
        let detections = recording.frames.iter().flat_map(|frame| &frame.detections);
        detections.map(|detection| [detection.x_m, detection.y_m]).collect::<Vec<_>>()
    };
    for ([x, y], [moved_x, moved_y]) in all(&plain).into_iter().zip(all(&moved)) {
        assert!((x - 100.5 - moved_x).abs() < 1e-4 && (y + 7.0 - moved_y).abs() < 1e-4);
    }
}

#[test]
fn formats_that_begin_at_their_scene_refuse_an_origin() {
    let scene = "0 28.0 43.09 16.18\n12 28.0 41.55 16.12\n";
    let error = read(Format::SddTrajnet, Role::Rows, scene, "1,2").expect_err("pixels").to_string();
    assert_eq!(error, "a.txt: sdd-trajnet has its origin at the scene, and takes no --origin");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("own.csv");
    std::fs::write(&path, "stamp_s,type,x_m,y_m\n0,vehicle,458001,5428002\n").expect("a file");
    let options = OpenOptions { origin: origin("458000,5428000"), ..OpenOptions::default() };
    let recording = open_with(&path, options).expect("a recording");
    assert_eq!(recording.frames[0].detections[0].x_m, 1.0);
}
