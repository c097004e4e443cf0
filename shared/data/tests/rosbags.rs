//! Bags of ROS 2: frames, classes, identities and errors.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::io::Cursor;

use data::{Format, Input, Recording, Role, parse};
use interop::cdr::to_bytes;
use interop::messages::{
    DetectedObject, DetectedObjects, Header, ObjectClassification, Quaternion, TfMessage, Time,
    TrackedObject, TrackedObjects, TransformStamped, Uuid, label,
};
use wire::{AgentType, Detection, detection_flags};

pub fn header(sec: i32, frame: &str) -> Header {
    Header { stamp: Time { sec, nanosec: 0 }, frame_id: frame.to_owned() }
}

fn turned(angle_rad: f64) -> Quaternion {
    Quaternion { x: 0.0, y: 0.0, z: (angle_rad / 2.0).sin(), w: (angle_rad / 2.0).cos() }
}

/// `child` at (`x_m`, 0) in `parent`, turned to the left.
pub fn tf(sec: i32, parent: &str, child: &str, x_m: f64) -> (&'static str, &'static str, Vec<u8>) {
    let mut found = TransformStamped {
        header: header(sec, parent),
        child_frame_id: child.into(),
        ..TransformStamped::default()
    };
    found.transform.translation.x = x_m;
    found.transform.rotation = turned(FRAC_PI_2);
    ("/tf", TfMessage::DEFINITION.name, to_bytes(&TfMessage { transforms: vec![found] }))
}

fn detected(sec: i32, frame: &str, x_m: f64, class: u8) -> (&'static str, &'static str, Vec<u8>) {
    let mut object = DetectedObject { existence_probability: 0.5, ..DetectedObject::default() };
    object.classification = vec![ObjectClassification { label: class, probability: 1.0 }];
    object.kinematics.pose_with_covariance.pose.position.x = x_m;
    object.kinematics.pose_with_covariance.pose.orientation = turned(0.0);
    object.kinematics.orientation_availability = 2;
    object.kinematics.has_twist = true;
    object.kinematics.twist_with_covariance.twist.linear.x = 3.0;
    (object.shape.dimensions.x, object.shape.dimensions.y) = (4.0, 2.0);
    let message = DetectedObjects { header: header(sec, frame), objects: vec![object] };
    ("/detections", DetectedObjects::DEFINITION.name, to_bytes(&message))
}

fn tracked(sec: i32, uuids: &[u8]) -> (&'static str, &'static str, Vec<u8>) {
    let objects = uuids.iter().map(|&byte| TrackedObject {
        object_id: Uuid { uuid: [byte; 16] },
        classification: vec![ObjectClassification { label: label::PEDESTRIAN, probability: 1.0 }],
        ..TrackedObject::default()
    });
    let message = TrackedObjects { header: header(sec, "map"), objects: objects.collect() };
    ("/tracks", TrackedObjects::DEFINITION.name, to_bytes(&message))
}

/// A bag of messages: topic, schema and bytes of each.
pub fn bag(messages: &[(&str, &str, Vec<u8>)]) -> Vec<u8> {
    bag_with(mcap::WriteOptions::new(), messages)
}

fn bag_with(options: mcap::WriteOptions, messages: &[(&str, &str, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = options.compression(None).create(&mut bytes).expect("a bag in memory");
    for (place, (topic, schema, data)) in messages.iter().enumerate() {
        let schema = writer.add_schema(schema, "ros2msg", b"").expect("a bag in memory");
        let channel_id = writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).expect("a bag in memory");
        let (sequence, log_time) = (0, place as u64);
        let header = mcap::records::MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, data).expect("a bag in memory");
    }
    writer.finish().expect("a bag in memory");
    drop(writer);
    bytes.into_inner()
}

fn read(messages: &[(&str, &str, Vec<u8>)]) -> Result<Recording, String> {
    let input = Input::new(Role::Rows, "drive.mcap", bag(messages));
    assert_eq!(Format::detect(&input).expect("a bag in memory"), Format::Rosbag);
    parse(Format::Rosbag, &[input]).map_err(|error| error.to_string())
}

fn only(recording: &Recording, frame: usize) -> Detection {
    let [detection] = recording.frames[frame].detections[..] else { panic!("{:?}", recording.frames[frame]) };
    detection
}

#[test]
fn objects_are_moved_to_the_root_by_interpolated_transforms() {
    let messages = [
        tf(10, "map", "base_link", 100.0),
        tf(12, "map", "base_link", 104.0),
        detected(11, "base_link", 5.0, label::BUS),
        detected(12, "base_link", 5.0, label::BUS),
    ];
    let recording = read(&messages).unwrap();
    assert_eq!((recording.frames.len(), recording.interval_ns), (2, 1_000_000_000));
    assert_eq!(recording.frames[0].stamp_ns, 11_000_000_000);
    let bus = only(&recording, 0);
    assert!((bus.x_m - 102.0).abs() < 1e-4 && (bus.y_m - 5.0).abs() < 1e-4, "{bus:?}");
    assert!((f64::from(bus.heading_rad) - FRAC_PI_2).abs() < 1e-6, "{bus:?}");
    assert_eq!((bus.agent_type, bus.score, bus.speed_mps), (AgentType::Vehicle as u32, 0.5, 3.0));
    assert_eq!((bus.length_m, bus.width_m), (4.0, 2.0));
    assert!(!bus.has(detection_flags::HAS_ID) && recording.frames[0].truth.is_empty());
    let ego = recording.frames[1].ego;
    assert!(ego.is_sensor && (ego.position_m[0] - 104.0).abs() < 1e-4, "{ego:?}");
}

#[test]
fn tracks_keep_their_identities_and_other_classes_are_counted() {
    let recording = read(&[tracked(1, &[7, 9]), tracked(2, &[9])]).unwrap();
    assert!(recording.has_identities);
    assert_eq!(recording.frames[0].detections.len(), 2);
    let second = only(&recording, 1);
    assert_eq!((second.id, second.agent_type), (2, AgentType::Pedestrian as u32));
    let recording = read(&[detected(1, "map", 0.0, label::CAR), detected(2, "map", 0.0, 8)]).unwrap();
    assert_eq!((recording.frames.len(), recording.left_out[0].row_count), (1, 1));
}

/// A car with a value of its message changed.
fn changed(
    sec: i32,
    x_m: f64,
    change: impl Fn(&mut DetectedObject),
) -> (&'static str, &'static str, Vec<u8>) {
    let (topic, schema, bytes) = detected(sec, "map", x_m, label::CAR);
    let mut message: DetectedObjects = interop::cdr::from_bytes(&bytes).expect("a message");
    message.objects.iter_mut().for_each(change);
    (topic, schema, to_bytes(&message))
}

#[test]
fn values_that_no_agent_can_have_are_unknown_and_counted() {
    let speed = |object: &mut DetectedObject| {
        object.kinematics.twist_with_covariance.twist.linear.x = f64::NAN;
    };
    let far = |object: &mut DetectedObject| object.kinematics.twist_with_covariance.twist.linear.x = -9_999.0;
    let rotation = |object: &mut DetectedObject| {
        object.kinematics.pose_with_covariance.pose.orientation =
            Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
    };
    let size = |object: &mut DetectedObject| object.shape.dimensions.x = f64::NAN;
    let deviation = |object: &mut DetectedObject| {
        object.kinematics.has_position_covariance = true;
        object.kinematics.pose_with_covariance.covariance.0[0] = -1.0;
    };
    let messages = [
        changed(1, 0.0, |_| ()),
        changed(2, 3.0, speed),
        changed(3, 6.0, far),
        changed(4, 9.0, rotation),
        changed(5, 12.0, size),
        changed(6, 15.0, deviation),
        changed(7, f64::NAN, |_| ()),
    ];
    let recording = read(&messages).unwrap();
    let flags: Vec<u32> = (0..6).map(|frame| only(&recording, frame).flags).collect();
    let (heading, speed) = (detection_flags::HAS_HEADING, detection_flags::HAS_SPEED);
    let size = detection_flags::HAS_SIZE;
    let all = heading | speed | size;
    assert_eq!(flags, [all, all - speed, all - speed, size, all - size, all]);
    let counts: Vec<usize> = recording.left_out.iter().map(|left_out| left_out.row_count).collect();
    assert_eq!((recording.frames.len(), counts), (6, vec![1, 5]));
}

#[test]
fn a_bag_that_ends_in_the_middle_is_doubtful() {
    let messages: Vec<_> =
        (1..100).map(|sec| detected(sec, "map", 3.0 * f64::from(sec), label::CAR)).collect();
    let whole = bag(&messages);
    let open =
        |bytes: Vec<u8>| parse(Format::Rosbag, &[Input::new(Role::Rows, "drive.mcap", bytes)]).unwrap();
    assert_eq!(open(whole.clone()).findings, []);
    // The only chunk is cut, so its messages are written without a chunk.
    let loose = bag_with(mcap::WriteOptions::new().use_chunks(false), &messages);
    assert_eq!(open(loose.clone()).findings, []);
    for zeros in [0, 65_536] {
        let cut = [&loose[..loose.len() / 2], &vec![0; zeros]].concat();
        let recording = open(cut);
        let [found] = &recording.findings[..] else { panic!("{:?}", recording.findings) };
        let last_s = recording.frames.last().unwrap().stamp_ns / 1_000_000_000;
        assert!((30..70).contains(&last_s), "{last_s}");
        assert!(
            found.doubtful && found.sentence.starts_with("the file drive.mcap is cut off at byte"),
            "{found}"
        );
        assert!(found.sentence.contains(&format!("stamp {last_s}.000")), "{found}");
        assert!(data::findings(&recording).contains(found));
    }
}

#[test]
fn zeros_in_the_middle_of_a_bag_without_check_values_are_found() {
    let car = |sec| detected(sec, "map", 3.0 * f64::from(sec), label::CAR);
    let options = mcap::WriteOptions::new().calculate_chunk_crcs(false).chunk_size(Some(20_000));
    let whole = bag_with(options, &(1..400).map(car).collect::<Vec<_>>());
    let open = |bytes| parse(Format::Rosbag, &[Input::new(Role::Rows, "drive.mcap", bytes)]).unwrap();
    assert_eq!(open(whole.clone()).findings, []);
    // The messages end before the index.
    for at in (4_096..120_000).step_by(7_001) {
        let mut torn = whole.clone();
        torn[at..at + 4_096].fill(0);
        let recording = open(torn);
        // Zeros may cover the end of a chunk and the start of the next one.
        let kinds: Vec<&str> = recording.findings.iter().map(|found| &found.kind[..]).collect();
        assert!(
            [&["damaged"][..], &["cut_off"], &["cut_off", "damaged"]].contains(&&kinds[..]),
            "{at}: {kinds:?}"
        );
    }
}

#[test]
fn stamps_of_zero_are_a_doubt_and_the_log_has_the_times() {
    let messages: Vec<_> = (0..9).map(|sec| detected(0, "map", f64::from(sec), label::CAR)).collect();
    let recording = read(&messages).unwrap();
    // The first message was recorded at the time 0.
    assert_eq!(recording.frames.last().unwrap().stamp_ns, 8);
    assert_eq!(recording.findings[0].kind, "stamps_are_zero");
    assert!(recording.findings[0].sentence.contains("8 of 9 headers are 0"), "{}", recording.findings[0]);
    let clock = [detected(0, "map", 0.0, label::CAR), detected(1, "map", 1.0, label::CAR)];
    assert_eq!(read(&clock).unwrap().findings, []);
}

#[test]
fn bad_messages_and_objects_are_left_out_and_counted() {
    let car = |sec, x_m| detected(sec, "map", x_m, label::CAR);
    let (topic, schema, bytes) = car(4, 0.0);
    let cut = (topic, schema, bytes[..40].to_vec());
    let recording = read(&[car(1, 0.0), car(2, 3.0), car(3, 9e6), cut, car(5, 12.0)]).unwrap();
    let counts: Vec<usize> = recording.left_out.iter().map(|left_out| left_out.row_count).collect();
    assert_eq!((recording.frames.len(), counts), (3, vec![1, 1]));
    let recording = read(&[tracked(1, &[7, 7, 9])]).unwrap();
    assert_eq!((recording.frames[0].detections.len(), recording.left_out[0].row_count), (2, 1));
}

fn sentences(recording: &Recording) -> Vec<(String, bool)> {
    recording.findings.iter().map(|found| (found.to_string(), found.doubtful)).collect()
}

#[test]
fn messages_without_a_transform_are_left_out_and_a_doubt() {
    let mut messages: Vec<_> = (0..10).map(|sec| tf(sec, "map", "base_link", f64::from(sec))).collect();
    messages.extend((0..12).map(|sec| detected(sec, "base_link", 5.0, label::CAR)));
    let recording = read(&messages).unwrap();
    // The newest transform is used for a second.
    assert_eq!(recording.frames.len(), 11);
    let (sentence, is_doubtful) = &sentences(&recording)[0];
    assert!(
        *is_doubtful
            && sentence.contains("no transform from base_link to map within 1 s of 11.000 s in /tf: 1 of 12"),
        "{sentence}"
    );
}

/// A transform to the left of +x at a time in milliseconds.
fn tf_at(at_ms: u32, parent: &str, child: &str, at_m: [f64; 2]) -> (&'static str, &'static str, Vec<u8>) {
    let stamp = Time { sec: (at_ms / 1_000) as i32, nanosec: at_ms % 1_000 * 1_000_000 };
    let mut found = TransformStamped {
        header: Header { stamp, frame_id: parent.to_owned() },
        child_frame_id: child.into(),
        ..TransformStamped::default()
    };
    (found.transform.translation.x, found.transform.translation.y) = (at_m[0], at_m[1]);
    found.transform.rotation = turned(0.0);
    ("/tf", TfMessage::DEFINITION.name, to_bytes(&TfMessage { transforms: vec![found] }))
}

#[test]
fn of_two_parents_the_map_is_used() {
    let car = |sec| detected(sec, "base_link", 5.0, label::CAR);
    for [first, second] in [["map", "odom"], ["odom", "map"], ["world", "odom"]] {
        let at = |parent: &str, at_ms: u32| {
            let x_m = if parent == "odom" { 90.0 } else { 0.0 };
            tf_at(at_ms, parent, "base_link", [x_m + f64::from(at_ms) * 0.003, 0.0])
        };
        let mut messages = Vec::new();
        for at_ms in (0..4_000).step_by(100) {
            messages.extend([at(first, at_ms), at(second, at_ms + 30)]);
        }
        messages.extend([car(1), car(2)]);
        let recording = read(&messages).unwrap();
        let x_m = only(&recording, 0).x_m;
        assert!((x_m - 8.0).abs() < 1e-3, "{first} {second}: {x_m}");
        let [(note, false)] = &sentences(&recording)[..] else { panic!("{:?}", recording.findings) };
        assert!(
            note.contains("base_link has the parents") && note.contains(first) && note.contains(second),
            "{note}"
        );
    }
    // Both parents lead to the map.
    let mut messages = vec![tf_at(0, "map", "odom", [5.0, 0.0])];
    for at_ms in (0..4_000).step_by(100) {
        messages.extend([
            tf_at(at_ms, "map", "base_link", [0.0; 2]),
            tf_at(at_ms, "odom", "base_link", [0.0; 2]),
        ]);
        messages.push(tf_at(at_ms, "map", "odom", [5.0, 0.0]));
    }
    messages.extend([car(1), car(2)]);
    assert!(sentences(&read(&messages).unwrap()).iter().all(|(_, is_doubtful)| *is_doubtful));
}

#[test]
fn two_senders_of_a_transform_are_a_doubt() {
    let found = |rates_ms: [usize; 2], off_m: [f64; 2], phase_ms: u32| {
        let mut messages = Vec::new();
        for (sender, step_ms) in rates_ms.into_iter().enumerate().filter(|(_, step_ms)| *step_ms > 0) {
            for at_ms in (0..8_000).step_by(step_ms) {
                let off_m = off_m.map(|off_m| off_m * sender as f64);
                let x_m = f64::from(at_ms) * 0.003 + off_m[0];
                messages.push(tf_at(at_ms + phase_ms * sender as u32, "map", "base_link", [x_m, off_m[1]]));
            }
        }
        messages.extend((1..7).map(|sec| detected(sec, "base_link", 5.0, label::CAR)));
        sentences(&read(&messages).unwrap())
    };
    for rates_ms in [[50, 100], [20, 20], [100, 100], [100, 20]] {
        for phase_ms in [0, 3] {
            let [(doubt, true)] = &found(rates_ms, [1.5, -2.5], phase_ms)[..] else {
                panic!("{rates_ms:?} {phase_ms}")
            };
            assert!(doubt.contains("from base_link to map jump to and fro"), "{doubt}");
        }
    }
    assert_eq!(found([50, 0], [0.0; 2], 0), []);
    assert_eq!(found([50, 100], [0.01, 0.01], 3), []);
}

#[test]
fn a_frame_that_may_move_is_a_doubt() {
    let messages = [detected(1, "velodyne", 0.0, label::CAR), detected(2, "velodyne", 3.0, label::CAR)];
    let [(doubt, true)] = &sentences(&read(&messages).unwrap())[..] else { panic!("one doubt") };
    assert!(doubt.contains("no transform shows whether velodyne stands still"), "{doubt}");
    for frame in ["map", "odom", "world"] {
        assert_eq!(sentences(&read(&[detected(1, frame, 0.0, label::CAR)]).unwrap()), []);
    }
}

#[test]
fn several_topics_of_detections_are_merged_unless_one_is_usual() {
    let on = |topic: &'static str, sec, x_m| {
        let (_, schema, bytes) = detected(sec, "map", x_m, label::CAR);
        (topic, schema, bytes)
    };
    let merged =
        read(&[on("/front", 1, 0.0), on("/rear", 1, 50.0), on("/front", 2, 1.0), tracked(2, &[7])]).unwrap();
    assert_eq!((merged.frames.len(), merged.frames[0].detections.len()), (2, 2));
    let sensors = |recording: &Recording| -> Vec<(f32, u8)> {
        recording.frames[0].detections.iter().map(|detection| (detection.x_m, detection.sensor)).collect()
    };
    assert_eq!(sensors(&merged), [(0.0, 1), (50.0, 2)], "each topic is a sensor");
    let [(note, false)] = &sentences(&merged)[..] else { panic!("{:?}", merged.findings) };
    let expected =
        "the objects are those of /front (2 messages), /rear (1 messages); /tracks (1 messages) ignored";
    assert_eq!(note, expected);
    let usual = "/perception/object_recognition/detection/objects";
    let one = read(&[on("/front", 1, 0.0), on(usual, 1, 50.0)]).unwrap();
    assert_eq!(one.frames[0].detections.len(), 1);
    assert!(sentences(&one)[0].0.contains("/front (1 messages) ignored"));
    let topics: Vec<_> =
        one.topics.iter().map(|topic| (topic.name.as_str(), topic.messages, topic.is_read)).collect();
    assert_eq!(topics, [(usual, 1, true), ("/front", 1, false)]);
    let choose = |topics: &[&str]| {
        let bytes = bag(&[on("/front", 1, 0.0), on(usual, 1, 50.0), tracked(2, &[7])]);
        let topics = topics.iter().map(|topic| (*topic).to_owned()).collect();
        let input = Input { topics, ..Input::new(Role::Rows, "drive.mcap", bytes) };
        parse(Format::Rosbag, &[input]).map_err(|error| error.to_string())
    };
    let front = only(&choose(&["/front"]).unwrap(), 0);
    assert_eq!((front.x_m, front.sensor), (0.0, 0));
    assert_eq!(sensors(&choose(&["/front", usual]).unwrap()), [(0.0, 1), (50.0, 2)]);
    assert_eq!(
        sensors(&choose(&[usual, "/front"]).unwrap()),
        [(0.0, 2), (50.0, 1)],
        "in the order of --topic"
    );
    assert_eq!(choose(&["/tracks"]).unwrap().frames[0].stamp_ns, 2_000_000_000);
    let error = choose(&["/rear"]).unwrap_err();
    assert!(error.contains("no objects on the topic /rear") && error.contains("/front"), "{error}");
}

/// A bag of a car, split into three parts in a folder.
fn split(folder: &std::path::Path, change: impl Fn(&str, Vec<u8>) -> (String, Vec<u8>)) -> Vec<String> {
    std::fs::create_dir(folder).expect("a folder");
    let mut names = Vec::new();
    for part in 0..3 {
        let mut messages: Vec<_> =
            (0..4).map(|sec| detected(1 + 4 * part + sec, "lidar", 0.0, label::CAR)).collect();
        messages.extend((0..50).map(|at| {
            let at_ms = 900 + 4_000 * part as u32 + at * 100;
            tf_at(at_ms, "map", "base_link", [f64::from(at_ms) * 0.003, 0.0])
        }));
        if part == 0 {
            let (_, schema, bytes) = tf_at(0, "base_link", "lidar", [1.0, 0.0]);
            messages.push(("/tf_static", schema, bytes));
        }
        let (name, bytes) = change(&format!("drive_{part}.mcap"), bag(&messages));
        std::fs::write(folder.join(&name), bytes).expect("a part");
        names.push(name);
    }
    names
}

/// A list of parts, as rosbag2 writes it.
fn list(folder: &std::path::Path, names: &[String]) {
    let names: String = names.iter().map(|name| format!("    - {name}\n")).collect();
    let text =
        format!("rosbag2_bagfile_information:\n  relative_file_paths:\n{names}  files:\n    - path: x\n");
    std::fs::write(folder.join("metadata.yaml"), text).expect("a list");
}

#[test]
fn a_folder_of_rosbag2_is_one_recording() {
    let outer = tempfile::tempdir().unwrap();
    let check = |folder: &std::path::Path| {
        let recording = data::open(folder, None).unwrap();
        assert_eq!(recording.frames.len(), 12);
        assert_eq!(data::open(&folder.join("."), None).unwrap().name, recording.name);
        for (place, frame) in recording.frames.iter().enumerate() {
            let x_m = only(&recording, place).x_m;
            assert!((f64::from(x_m) - frame.stamp_ns as f64 * 3e-9 - 1.0).abs() < 1e-2, "{place}: {x_m}");
        }
        assert_eq!(recording.findings, []);
        assert_eq!(data::recordings_in(folder).unwrap(), [folder]);
    };
    let same = |name: &str, bytes: Vec<u8>| (name.to_owned(), bytes);
    let folder = outer.path().join("listed");
    let mut names = split(&folder, same);
    list(&folder, &names);
    check(&folder);
    assert_eq!(data::recordings_in(outer.path()).unwrap(), std::slice::from_ref(&folder));
    names.push("drive_3.mcap".to_owned());
    list(&folder, &names);
    let error = data::open(&folder, None).unwrap_err().to_string();
    assert!(error.contains("drive_3.mcap is missing"), "{error}");
    // The recorder was killed before it wrote the list.
    let folder = outer.path().join("drive");
    split(&folder, same);
    check(&folder);
    // LZ4 of whole files.
    let folder = outer.path().join("packed");
    let names = split(&folder, |name, bytes| {
        let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
        std::io::Write::write_all(&mut encoder, &bytes).unwrap();
        (format!("{name}.lz4"), encoder.finish().unwrap())
    });
    list(&folder, &names);
    check(&folder);
    // Zstandard, as rosbag2 compresses files.
    let folder = outer.path().join("zstd");
    let names = split(&folder, |name, bytes| {
        let level = ruzstd::encoding::CompressionLevel::Fastest;
        (format!("{name}.zstd"), ruzstd::encoding::compress_to_vec(&bytes[..], level))
    });
    list(&folder, &names);
    check(&folder);
}

#[test]
fn a_later_part_alone_is_refused_with_the_missing_transform() {
    let outer = tempfile::tempdir().unwrap();
    let folder = outer.path().join("drive");
    split(&folder, |name, bytes| (name.to_owned(), bytes));
    let error = data::open(&folder.join("drive_1.mcap"), None).unwrap_err().to_string();
    assert!(error.contains("no transform from lidar to map in /tf or /tf_static"), "{error}");
}

#[test]
fn a_bag_in_sqlite3_is_refused_with_the_way_to_convert_it() {
    let outer = tempfile::tempdir().unwrap();
    let file = outer.path().join("drive_0.db3");
    std::fs::write(&file, b"SQLite format 3\0 and more").unwrap();
    list(outer.path(), &["drive_0.db3".to_owned()]);
    for path in [file.as_path(), outer.path()] {
        let error = data::open(path, None).unwrap_err().to_string();
        assert!(error.contains("sqlite3") && error.contains("bag_to_mcap.py"), "{error}");
    }
}

#[test]
fn errors_name_file_message_and_value() {
    let car = |sec, frame, x_m| detected(sec, frame, x_m, label::CAR);
    let error = read(&[car(1, "map", 458_000.0)]).unwrap_err();
    assert!(
        error.starts_with("drive.mcap: message 1: an object at (458000, 0)") && error.contains("--origin"),
        "{error}"
    );
    let error = read(&[tf(1, "map", "base_link", 0.0), car(9, "base_link", 0.0)]).unwrap_err();
    assert!(error.contains("message 2: no transform from base_link to map within 1 s of 9.000 s"), "{error}");
    let error = read(&[car(1, "base_link", 0.0)]).unwrap_err();
    assert!(error.contains("message 1: objects in the frame base_link, and no transform"), "{error}");
    let error = read(&[tf(1, "map", "base_link", 0.0), car(1, "lidar", 0.0)]).unwrap_err();
    assert!(error.contains("message 2: no transform from lidar to map in /tf or /tf_static"), "{error}");
    let error = read(&[tf(1, "base_link", "lidar", 0.0), car(1, "lidar", 0.0)]).unwrap_err();
    assert!(error.contains("message 2: no transform from lidar to a frame that stands still"), "{error}");
    for frame in ["", "/"] {
        let error = read(&[car(1, frame, 0.0)]).unwrap_err();
        assert!(error.contains("message 1: the frame of the objects has no name"), "{error}");
        let error = read(&[tf(1, "map", "base_link", 0.0), car(1, frame, 0.0)]).unwrap_err();
        assert!(error.contains("no transform from a frame without a name to map"), "{error}");
    }
    let error = read(&[("/a", "std_msgs/msg/String", vec![])]).unwrap_err();
    assert!(error.contains("and has std_msgs/msg/String"), "{error}");
    let (topic, schema, bytes) = car(1, "map", 0.0);
    let error = read(&[(topic, schema, bytes[..40].to_vec())]).unwrap_err();
    assert!(error.starts_with("drive.mcap: message 1: /detections: 40 bytes: a value"), "{error}");
}
