//! Fuzz targets, one per reader of recordings, and one for maps of lanes.
//!
//! Each target starts from a small good recording, which the fuzzer edits: it overwrites, inserts and removes
//! bytes, repeats lines, and inserts words that break number parsers. The target also passes the fuzzer's
//! bytes to the reader unchanged. A reader must not panic, and its result must satisfy the pipeline's
//! assumptions.
//!
//! A test run does a bounded number of iterations. To search for longer:
//!
//! ```sh
//! # Ten minutes, one target after the other; prints the number of inputs.
//! BOLERO_RANDOM_TEST_TIME_MS=600000 BOLERO_RANDOM_ITERATIONS=100000000000 \
//!     cargo test --release -p stgdat-tests --test fuzz_readers csv -- --nocapture
//! # Coverage-guided; needs cargo-bolero and a nightly compiler.
//! cargo bolero test -p stgdat-tests csv --engine libfuzzer
//! ```

use data::{Format, Input, Recording, Role, WindowOptions, parse, tracks, windows};
use lanes::{Coordinates, LaneMap, Routes};

/// Iterations of a target in an ordinary test run.
const ITERATIONS: usize = 20_000;
/// Longest list of edits, in bytes.
const EDITS_BYTES_MAX: usize = 64;
/// Texts that often break parsers.
const WORDS: [&[u8]; 20] = [
    b"nan",
    b"-inf",
    b"1e999",
    b"1e-999",
    b"99999999999999999999",
    b"-0",
    b"32769",
    b"0x10",
    b"\"",
    b",",
    b"\t",
    b"\r\n",
    b"\n",
    b"\0",
    b"\xff",
    b"\xef\xbb\xbf",
    b"<a>",
    b"<!--",
    b"&lt;",
    b"<![CDATA[",
];

const CALIBRATION: &str = "P0: 1 0 0 0 0 1 0 0 0 0 1 0\n\
    R_rect 1 0 0 0 1 0 0 0 1\nTr_velo_cam 0 -1 0 0 0 0 -1 0 1 0 0 0\nTr_imu_velo 1 0 0 0 0 1 0 0 0 0 1 0\n";
const EGO_MOTION: &str = "49.0 8.4 112.8 0 0 0.5 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0.1 0.1 4 10 4 4 0\n\
    49.00001 8.4 112.8 0 0 0.5 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0.1 0.1 4 10 4 4 0\n";
const LABELS: &str = "0 -1 DontCare -1 -1 -10 219 188 245 218 -1000 -1000 -1000 -10 -1 -1 -1\n\
    0 0 Van 0 0 -1.79 296.7 161.7 455.2 292.3 2.0 1.82 4.43 -4.55 1.85 13.41 -2.11\n\
    1 0 Van 0 0 -1.79 296.7 161.7 455.2 292.3 2.0 1.82 4.43 -4.50 1.85 13.01 -2.11\n";

#[test]
fn eth_ucy() {
    fuzz(Format::EthUcy, &[(Role::Rows, "780\t1.0\t8.46\t3.59\n790\t1.0\t9.57\t3.79\n790\t2\t-1e0\t4\n")]);
}

#[test]
fn obsmat() {
    fuzz(
        Format::Obsmat,
        &[(Role::Rows, "7.8e+02 1.0 8.45 0.0 3.58 1.67 0.0 0.17\n786 1 9.1 0 3.6 1.66 0 0.3\n")],
    );
}

#[test]
fn sdd_trajnet() {
    let scales = "File\tRatio\ncoupa_0.jpg\tCoupa\t0\tA\t44\t11\t13.6\t489\t5\t489.0\t489.0\t0.01\t0.0279\n";
    fuzz(
        Format::SddTrajnet,
        &[
            (Role::Rows, "0 28.0 43.09 16.18\n12 28.0 41.55 16.12\n24 28.0 40.1 16.1\n"),
            (Role::Scales, scales),
        ],
    );
}

#[test]
fn sdd_raw() {
    let rows = "0 789 399 815 436 0 0 0 0 \"Cart\"\n0 787 391 815 432 1 0 0 1 \"Cart\"\n1 1 1 9 9 1 1 0 1 \"Biker\"\n";
    let scales = "coupa:\n   video0:\n      scale: 0.04\n      certainty: 1.0\n";
    fuzz(Format::SddRaw, &[(Role::Rows, rows), (Role::Scales, scales)]);
}

#[test]
fn interaction() {
    let vehicles = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n\
        1,1,100,car,981.284,1018.604,-4.36,-5.41,-2.249,9.61,2.6\n1,2,200,car,980.876,1018.042,-4.3,-5.4,-2.2,9.6,2.6\n";
    let riders = "track_id,frame_id,timestamp_ms,agent_type,x,y\n\
        P1,2,200,pedestrian/bicycle,980.56,1052.15\nP1,6,600,pedestrian/bicycle,981,1052\n";
    fuzz(Format::Interaction, &[(Role::Vehicles, vehicles), (Role::Pedestrians, riders)]);
}

#[test]
fn vci_dut() {
    let vehicles = "id,frame,label,x_est,y_est,psi_est,vel_est\n0,22,veh,12.52,3.64,1.64,3.34\n";
    let pedestrians =
        "id,frame,label,x_est,y_est,vx_est,vy_est\n0,22,ped,5.55,7.73,1.66,-0.01\n0,23,ped,5.6,7.73,1.6,0\n";
    fuzz(Format::VciDut, &[(Role::Vehicles, vehicles), (Role::Pedestrians, pedestrians)]);
}

#[test]
fn kitti_detections() {
    let cars = "0,2,298.3,165.1,458.2,293.4,8.29,1.96,1.81,4.75,-4.57,1.84,13.53,-2.11,-1.78\n";
    let files = [
        (Role::Vehicles, cars),
        (Role::Calibration, CALIBRATION),
        (Role::EgoMotion, EGO_MOTION),
        (Role::Labels, LABELS),
    ];
    fuzz(Format::KittiDetections, &files);
}

#[test]
fn kitti_labels() {
    let files = [(Role::Rows, LABELS), (Role::Calibration, CALIBRATION), (Role::EgoMotion, EGO_MOTION)];
    fuzz(Format::KittiLabels, &files);
}

#[test]
fn levelx() {
    let tracks = "recordingId,trackId,frame,trackLifetime,xCenter,yCenter,heading,width,length,xVelocity,yVelocity\n\
        7,0,10,0,40.0,-30.0,359.5,1.842,4.516,10.0,0.0\n7,1,10,0,5.0,-8.0,181.3,0.0,0.0,-1.25,0.0\n\
        7,0,11,1,40.4,-30.0,359.5,1.842,4.516,10.0,0.0\n";
    let tracks_meta = "recordingId,trackId,initialFrame,class\n7,0,10,truck_bus\n7,1,10,pedestrian\n";
    let recording_meta = "recordingId,locationId,frameRate,weekday\n7,1,25.0,tuesday\n";
    fuzz(
        Format::LevelX,
        &[(Role::Rows, tracks), (Role::TracksMeta, tracks_meta), (Role::RecordingMeta, recording_meta)],
    );
}

#[test]
fn highd() {
    let tracks = "frame,id,x,y,width,height,xVelocity,yVelocity,laneId\n1,1,362.26,21.68,4.85,2.12,40.85,0.0,5\n\
        1,2,32760.0,9.4,12.1,2.5,-22.5,0.5,2\n2,1,363.89,21.68,4.85,2.12,40.85,0.0,5\n";
    let tracks_meta = "id,width,height,class,drivingDirection\n1,4.85,2.12,Car,2\n2,12.1,2.5,Truck,1\n";
    let recording_meta = "id,frameRate,locationId,startTime\n1,25,2,08:38\n";
    fuzz(
        Format::HighD,
        &[(Role::Rows, tracks), (Role::TracksMeta, tracks_meta), (Role::RecordingMeta, recording_meta)],
    );
}

#[test]
fn commonroad() {
    let xml = "<?xml version='1.0'?>\n<commonRoad timeStepSize=\"0.1\"><obstacle id='7'><role>dynamic</role>\n\
        <type>car</type><shape><circle><radius>1</radius></circle></shape><initialState><position><point><x>1</x>\n\
        <y>2</y></point></position><orientation><exact>0.1</exact></orientation><time><exact>0</exact></time>\n\
        <velocity><exact>8.0</exact></velocity></initialState><trajectory><state><position><point><x>1.8</x>\n\
        <y>2</y></point></position><time><exact>1</exact></time></state></trajectory></obstacle>\n\
        <staticObstacle id=\"8\"><type>parkedVehicle</type><shape><rectangle><length>4</length><width>2</width>\n\
        </rectangle></shape><initialState><position><point><x>5</x><y>2&#46;5</y></point></position>\n\
        <time><exact>0</exact></time></initialState></staticObstacle></commonRoad>\n";
    fuzz(Format::CommonRoad, &[(Role::Rows, xml)]);
}

#[test]
fn csv() {
    let rows = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m,score,sigma_m\n\
        0.08,7,vehicle,12.5,-3.2,3.1,8.4,4.5,1.8,0.97,0.2\n0.16,7,vehicle,12.1,-3.2,3.1,8.4,,,,\n\
        # a comment\n0.00,,ego,1.0,2.0,0.5,,,,,\n-0.5,,pedestrian,1,2,,,,,,\n";
    fuzz(Format::Csv, &[(Role::Rows, rows)]);
}

/// A lanelet with its successor, in degrees. It also has a node with local coordinates, an island and a
/// limit.
const LANES: &str = "<?xml version='1.0'?>\n<osm version='0.6'><node id='1' lat='0.0000' lon='0.0000'><tag k='local_x' v='0'/><tag k='local_y' v='0'/></node>\n\
    <node id='2' lat='0.0001' lon='0.0000'><tag k='local_x' v='0'/><tag k='local_y' v='11.1'/></node><node id='3' lat='0.0000' lon='0.00003'><tag k='local_x' v='3.3'/><tag k='local_y' v='0'/></node>\n\
    <node id='4' lat='0.0001' lon='0.00003'><tag k='local_x' v='3.3'/><tag k='local_y' v='11.1'/></node><node id='5' lat='0.0002' lon='0.0'><tag k='local_x' v='0'/><tag k='local_y' v='22.2'/></node><node id='6' lat='0.0002' lon='0.00003'><tag k='local_x' v='3.3'/><tag k='local_y' v='22.2'/></node>\n\
    <node id='7'><tag k='local_x' v='30'/><tag k='local_y' v='5'/></node>\n\
    <way id='10'><nd ref='1'/><nd ref='2'/><tag k='type' v='line_thin'/><tag k='subtype' v='dashed'/></way>\n\
    <way id='11'><nd ref='3'/><nd ref='4'/></way><way id='12'><nd ref='2'/><nd ref='5'/></way>\n\
    <way id='13'><nd ref='6'/><nd ref='4'/></way><way id='14'><nd ref='4'/><nd ref='7'/></way>\n\
    <relation id='20'><member type='way' role='left' ref='10'/><member type='way' role='right' ref='11'/>\n\
    <member type='relation' role='regulatory_element' ref='30'/><tag k='type' v='lanelet'/></relation>\n\
    <relation id='21'><member type='way' role='left' ref='12'/><member type='way' role='right' ref='13'/>\n\
    <member type='way' role='centerline' ref='14'/><tag k='type' v='lanelet'/><tag k='one_way' v='no'/></relation>\n\
    <relation id='22'><member type='way' role='outer' ref='11'/><member type='way' role='outer' ref='13'/>\n\
    <tag k='type' v='multipolygon'/><tag k='subtype' v='keepout'/></relation>\n\
    <relation id='30'><member type='way' role='ref_line' ref='14'/><member type='relation' role='yield' ref='20'/>\n\
    <tag k='type' v='regulatory_element'/><tag k='subtype' v='right_of_way'/><tag k='sign_type' v='25mph'/></relation>\n\
    </osm>";

#[test]
fn lanelet2() {
    let read = |text: &[u8]| LaneMap::parse("site.osm", text, Coordinates::Default);
    check_lanes(&read(LANES.as_bytes()).unwrap_or_else(|error| panic!("the sample: {error}")));
    bolero::check!().with_iterations(ITERATIONS).with_max_len(EDITS_BYTES_MAX).for_each(|bytes: &[u8]| {
        let mut edited = LANES.as_bytes().to_vec();
        edit(&mut edited, bytes);
        for text in [&edited[..], bytes] {
            if let Ok(map) = read(text) {
                check_lanes(&map);
            }
        }
    });
}

/// Asserts the assumptions of code that uses lanes.
fn check_lanes(map: &LaneMap) {
    assert!(!map.lanes().is_empty());
    let mut routes = Routes::default();
    for lane in map.lanes() {
        let len = lane.centre_m.len();
        assert!(len > 1 && lane.half_width_m.len() == len && lane.along_m.len() == len);
        assert!(lane.centre_m.as_flattened().iter().all(|x| x.is_finite()));
        assert!(lane.along_m.is_sorted() && lane.length_m().is_finite());
        assert!(lane.limit_mps.is_none_or(|limit| limit > 0.0));
        let named = lane.successors.iter().copied().chain(lane.neighbours.into_iter().flatten());
        assert!(named.max().is_none_or(|place| (place as usize) < map.lanes().len()));
        routes.find(map, wire::AgentType::Vehicle, lane.centre_m[0], 0.0, 50.0);
        let points = routes.as_slice().iter().flat_map(|route| &route.points_m);
        assert!(points.flatten().all(|x| x.is_finite()));
    }
}

fn fuzz(format: Format, files: &[(Role, &str)]) {
    let input = |&(role, text): &(Role, &str)| Input::new(role, "coupa/video0/coupa_0.txt", text);
    let sample: Vec<Input> = files.iter().map(input).collect();
    check(&parse(format, &sample).unwrap_or_else(|error| panic!("the sample: {error}")));
    bolero::check!().with_iterations(ITERATIONS).with_max_len(EDITS_BYTES_MAX).for_each(|bytes: &[u8]| {
        let mut edited = sample.clone();
        let (which, edits) = bytes.split_first().unwrap_or((&0, &[]));
        let file = usize::from(*which) % edited.len();
        edit(&mut edited[file].bytes, edits);
        let mut replaced = sample.clone();
        replaced[file].bytes = bytes.to_vec();
        for inputs in [edited, replaced] {
            // A wrong role must not make a file unsafe to read.
            let _ = Format::detect(&inputs[file]);
            if let Ok(recording) = parse(format, &inputs) {
                check(&recording);
            }
        }
    });
}

/// Applies edits of four bytes each: position (two bytes), kind, and the byte or word.
fn edit(text: &mut Vec<u8>, edits: &[u8]) {
    for edit in edits.chunks_exact(4) {
        let place = usize::from(u16::from_le_bytes([edit[0], edit[1]])) % (text.len() + 1);
        let word = WORDS[usize::from(edit[3]) % WORDS.len()];
        match edit[2] % 6 {
            0 => text.insert(place, edit[3]),
            1 if place < text.len() => text[place] = edit[3],
            2 => drop(text.drain(place..(place + usize::from(edit[3] % 8)).min(text.len()))),
            3 => text.truncate(place),
            4 => {
                let line = text[place..].split(|&byte| byte == b'\n').next().unwrap_or_default().to_vec();
                text.extend(line);
            }
            _ => drop(text.splice(place..place, word.iter().copied())),
        }
    }
}

/// Asserts the pipeline's assumptions.
fn check(recording: &Recording) {
    assert!(!recording.frames.is_empty());
    assert_eq!(recording.sha256.len(), 64);
    assert!(recording.frames.is_sorted_by(|a, b| a.stamp_ns < b.stamp_ns));
    for frame in &recording.frames {
        assert!(frame.ego.heading_rad.is_finite() && frame.ego.position_m.iter().all(|x| x.is_finite()));
        assert!(frame.detections.iter().all(|detection| detection.check().is_ok()));
        assert!(frame.truth.iter().all(|truth| truth.x_m.is_finite() && truth.y_m.is_finite()));
    }
    for track in tracks(recording) {
        assert!(track.states.is_sorted_by(|a, b| a.0 < b.0));
    }
    for window in windows(recording, &WindowOptions::new(8, 12, 400_000_000)) {
        assert!(window.agents.iter().all(|agent| agent.history.last().is_some_and(Option::is_some)));
    }
}
