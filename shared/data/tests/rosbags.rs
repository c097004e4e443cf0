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
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new().compression(None).create(&mut bytes).expect("a bag in memory");
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
    let mut loose = Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().compression(None).use_chunks(false);
    let mut writer = options.create(&mut loose).unwrap();
    for (place, (topic, schema, data)) in messages.iter().enumerate() {
        let schema = writer.add_schema(schema, "ros2msg", b"").unwrap();
        let channel_id = writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap();
        let log_time = place as u64;
        let header =
            mcap::records::MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    let loose = loose.into_inner();
    assert_eq!(open(loose.clone()).findings, []);
    for zeros in [0, 65_536] {
        let cut = [&loose[..loose.len() / 2], &vec![0; zeros]].concat();
        let recording = open(cut);
        let [found] = &recording.findings[..] else { panic!("{:?}", recording.findings) };
        let last_s = recording.frames.last().unwrap().stamp_ns / 1_000_000_000;
        assert!((30..70).contains(&last_s), "{last_s}");
        assert!(found.doubtful && found.sentence.starts_with("the file is cut off at byte"), "{found}");
        assert!(found.sentence.contains(&format!("stamp {last_s}.000")), "{found}");
        assert!(data::findings(&recording).contains(found));
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
fn errors_name_file_message_and_value() {
    let car = |sec, frame, x_m| detected(sec, frame, x_m, label::CAR);
    let error = read(&[car(1, "map", 458_000.0)]).unwrap_err();
    assert!(
        error.starts_with("drive.mcap: message 1: x_m = \"458000\"") && error.contains("--origin"),
        "{error}"
    );
    let error = read(&[tf(1, "map", "base_link", 0.0), car(9, "base_link", 0.0)]).unwrap_err();
    assert!(error.contains("message 2: no transform from base_link to map within 1 s of 9.000 s"), "{error}");
    let error = read(&[car(1, "base_link", 0.0)]).unwrap_err();
    assert!(error.contains("message 1: objects in the frame base_link, and no transform"), "{error}");
    let error = read(&[tracked(1, &[7, 7])]).unwrap_err();
    assert!(error.starts_with("drive.mcap: message 1: object_id = \"1\""), "{error}");
    let error = read(&[("/a", "std_msgs/msg/String", vec![])]).unwrap_err();
    assert!(error.contains("and has std_msgs/msg/String"), "{error}");
    let (topic, schema, bytes) = car(1, "map", 0.0);
    let error = read(&[(topic, schema, bytes[..40].to_vec())]).unwrap_err();
    assert!(error.starts_with("drive.mcap: message 1: /detections: 40 bytes: a value"), "{error}");
}
