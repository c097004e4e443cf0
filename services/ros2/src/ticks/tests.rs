use std::f64::consts::FRAC_PI_2;

use interop::messages::{
    DetectedObject, ObjectClassification, Quaternion, Time, TrackedObject, TransformStamped, Uuid, label,
};
use wire::{AgentType, DETECTIONS_MAX, detection_flags};

use super::*;

const MS: i64 = 1_000_000;

fn world(pose: Option<[f64; 3]>) -> World {
    World { frame: "map".to_owned(), origin: WorldOrigin::new([1_000.0, 0.0]).unwrap(), pose }
}

fn header(stamp_ms: i64, frame: &str) -> Header {
    let (sec, nanosec) = ((stamp_ms / 1000) as i32, (stamp_ms % 1000 * MS) as u32);
    Header { stamp: Time { sec, nanosec }, frame_id: frame.to_owned() }
}

fn turned(angle_rad: f64) -> Quaternion {
    Quaternion { x: 0.0, y: 0.0, z: (angle_rad / 2.0).sin(), w: (angle_rad / 2.0).cos() }
}

fn object(x_m: f64, class: u8) -> DetectedObject {
    let mut object = DetectedObject { existence_probability: 0.5, ..DetectedObject::default() };
    object.classification = vec![ObjectClassification { label: class, probability: 1.0 }];
    object.kinematics.pose_with_covariance.pose.position.x = x_m;
    object.kinematics.pose_with_covariance.pose.orientation = turned(0.0);
    object.kinematics.pose_with_covariance.covariance.0[0] = 0.09;
    object.kinematics.pose_with_covariance.covariance.0[7] = 0.09;
    object.kinematics.has_position_covariance = true;
    object.kinematics.orientation_availability = 2;
    object.kinematics.has_twist = true;
    object.kinematics.twist_with_covariance.twist.linear.x = 3.0;
    (object.shape.dimensions.x, object.shape.dimensions.y) = (4.0, 2.0);
    object
}

/// Cars at these positions, which arrive at the time of their stamp.
fn message(stamp_ms: i64, frame: &str, x_m: &[f64]) -> Message {
    let objects = x_m.iter().map(|&x_m| object(x_m, label::CAR).into()).collect();
    Message { header: header(stamp_ms, frame), objects, sensor: 0, arrived_ns: (stamp_ms * MS) as u64 }
}

fn transform(stamp_ms: i64, parent: &str, child: &str, x_m: f64, angle_rad: f64) -> TfMessage {
    let mut found = TransformStamped {
        header: header(stamp_ms, parent),
        child_frame_id: child.into(),
        ..TransformStamped::default()
    };
    found.transform.translation.x = x_m;
    found.transform.rotation = turned(angle_rad);
    TfMessage { transforms: vec![found] }
}

/// (stamp, own stamps of the detections) in ms of each tick for messages with these arrivals.
fn played(messages: Vec<Message>) -> Vec<(i64, Vec<i64>)> {
    let mut ticks = Ticks::new(world(None));
    let mut found = Vec::new();
    let mut take = |ticks: &mut Ticks, now_ns: u64| {
        while let Some(Tick { frame, .. }) = ticks.next(now_ns) {
            let own_ms = |d: &Detection| (frame.stamp_ns + d.offset_ns) / MS;
            found.push((frame.stamp_ns / MS, frame.detections.iter().map(own_ms).collect()));
        }
    };
    let mut now_ns = 0;
    for message in messages {
        // The stage looks every 10 ms.
        while now_ns < message.arrived_ns {
            take(&mut ticks, now_ns);
            now_ns += 10_000_000;
        }
        now_ns = message.arrived_ns;
        ticks.message(message);
        take(&mut ticks, now_ns);
    }
    (0..30).for_each(|step| take(&mut ticks, now_ns + step * 10_000_000));
    found
}

fn stamps(played: &[(i64, Vec<i64>)]) -> Vec<i64> {
    played.iter().map(|(stamp_ms, _)| *stamp_ms).collect()
}

#[test]
fn an_object_keeps_its_values_and_is_moved_into_the_world() {
    let mut ticks = Ticks::new(world(None));
    ticks.transform(&transform(0, "base_link", "lidar", 1.0, 0.0), true);
    ticks.transform(&transform(1_000, "map", "base_link", 1_100.0, FRAC_PI_2), false);
    ticks.message(message(1_000, "lidar", &[10.0]));
    let Tick { frame, left_out, .. } = ticks.next(0).expect("a tick");
    assert_eq!((frame.stamp_ns, left_out, frame.observed_types), (1_000 * MS, 0, 0b111));
    let [detection] = frame.detections[..] else { panic!("{frame:?}") };
    assert!((detection.x_m - 100.0).abs() < 1e-4 && (detection.y_m - 11.0).abs() < 1e-4, "{detection:?}");
    assert!((f64::from(detection.heading_rad) - FRAC_PI_2).abs() < 1e-6);
    assert_eq!((detection.speed_mps, detection.length_m, detection.width_m), (3.0, 4.0, 2.0));
    assert_eq!((detection.score, detection.agent_type), (0.5, AgentType::Vehicle as u32));
    assert!((detection.sigma_m - 0.3).abs() < 1e-6);
    assert!(frame.ego.is_sensor && (frame.ego.position_m[0] - 100.0).abs() < 1e-4, "{:?}", frame.ego);
}

#[test]
fn a_pose_replaces_the_transforms() {
    let mut ticks = Ticks::new(world(Some([1_005.0, 2.0, FRAC_PI_2])));
    ticks.message(message(0, "roadside", &[10.0]));
    let Tick { frame, .. } = ticks.next(0).unwrap();
    let detection = frame.detections[0];
    assert!((detection.x_m - 5.0).abs() < 1e-4 && (detection.y_m - 12.0).abs() < 1e-4, "{detection:?}");
    assert!(frame.ego.is_sensor && frame.ego.position_m == [5.0, 2.0]);
}

#[test]
fn the_target_of_transforms_is_the_world_and_not_the_root() {
    let mut ticks = Ticks::new(world(None));
    ticks.transform(&transform(0, "earth", "map", 9e6, 0.0), true);
    ticks.transform(&transform(0, "map", "base_link", 1_010.0, 0.0), false);
    ticks.message(message(0, "/base_link", &[1.0]));
    assert_eq!(ticks.next(0).unwrap().frame.detections[0].x_m, 11.0);
}

#[test]
fn a_message_waits_for_its_transform_and_is_counted_without_one() {
    let mut ticks = Ticks::new(world(None));
    ticks.transform(&transform(900, "map", "base_link", 1_000.0, 0.0), false);
    ticks.message(message(1_000, "base_link", &[1.0]));
    let at_ns = |ms: u64| ms * MS as u64;
    assert_eq!(ticks.next(at_ns(1_020)), None, "the pose at 1 s is not known yet");
    ticks.transform(&transform(1_000, "map", "base_link", 1_002.0, 0.0), false);
    assert_eq!(ticks.next(at_ns(1_021)).unwrap().frame.detections[0].x_m, 3.0);
    // The newest pose is used if none comes.
    ticks.message(message(1_100, "base_link", &[1.0]));
    assert_eq!(ticks.next(at_ns(1_149)), None);
    assert_eq!(ticks.next(at_ns(1_150)).unwrap().frame.detections[0].x_m, 3.0);
    ticks.message(message(1_200, "radar", &[1.0]));
    assert_eq!(ticks.next(at_ns(1_260)), None);
    assert_eq!(ticks.counts(), Counts { messages: 3, unplaced: 1, ..Counts::default() });
    assert_eq!(ticks.take_problem().unwrap(), "no transform from radar to map in /tf or /tf_static");
}

#[test]
fn transforms_follow_a_clock_that_is_set_back_or_wrong_once() {
    let mut ticks = Ticks::new(world(None));
    let mut add = |stamp_ms: i64, x_m: f64| {
        ticks.transform(&transform(stamp_ms, "map", "base_link", x_m, 0.0), false);
        let found = ticks.transforms.to_world("base_link", "map", stamp_ms * MS).map(|at| at.translation.x);
        (found.unwrap(), ticks.transforms.to_world("base_link", "map", 0).is_ok())
    };
    assert_eq!(add(0, 1.0), (1.0, true));
    // What is older than 10 s is forgotten.
    assert!((1..=12).all(|k| add(k * 1_000, 2.0).0 == 2.0));
    assert_eq!(add(12_500, 3.0), (3.0, false));
    // An hour ahead, and back.
    assert_eq!(add(3_600_000, 4.0), (4.0, false));
    assert_eq!(add(12_600, 5.0), (5.0, false));
    assert_eq!(add(12_700, 6.0), (6.0, false));
    // A bag that begins again.
    assert_eq!(add(100, 7.0), (7.0, true));
}

#[test]
fn every_message_at_the_rate_of_the_ticks_or_below_is_a_tick() {
    for interval_ms in [75, 79, 80, 100, 400] {
        // A jitter of a quarter.
        let stamp_ms = |k: i64| 1_000 + k * interval_ms + [20, 12, -9, 5, -20][k as usize % 5];
        let messages: Vec<Message> = (0..40).map(|k| message(stamp_ms(k), "map", &[1_000.0])).collect();
        let expected: Vec<i64> = (0..40).map(stamp_ms).collect();
        assert_eq!(stamps(&played(messages)), expected, "{interval_ms} ms");
    }
}

#[test]
fn faster_messages_are_thinned_by_whole_ones() {
    // 40 ms: every second one. 33 ms: every third one. 50 ms: every second one.
    for (interval_ms, every) in [(40, 2), (33, 3), (50, 2), (10, 8)] {
        let messages: Vec<Message> =
            (0..80).map(|k| message(1_000 + k * interval_ms, "map", &[1_000.0])).collect();
        let found = stamps(&played(messages));
        let late: Vec<i64> = found.windows(2).map(|pair| pair[1] - pair[0]).skip(10).collect();
        let (last, steady) = late.split_last().unwrap();
        assert!(steady.iter().all(|apart_ms| *apart_ms == every * interval_ms), "{interval_ms}: {found:?}");
        assert!(*last <= every * interval_ms);
    }
}

#[test]
fn detections_of_two_sensors_keep_their_own_times() {
    // 10 Hz each, 30 ms apart, of different places.
    let mut messages = Vec::new();
    for k in 0..20 {
        messages.push(message(1_000 + k * 100, "map", &[1_000.0]));
        messages.push(message(1_030 + k * 100, "map", &[1_500.0]));
    }
    let found = played(messages);
    let both: Vec<&(i64, Vec<i64>)> = found.iter().filter(|(_, own)| own.len() == 2).collect();
    assert!(both.len() >= 16, "{found:?}");
    for (stamp_ms, own_ms) in both {
        let mut own_ms = own_ms.clone();
        own_ms.sort_unstable();
        assert_eq!(own_ms[1], *stamp_ms);
        assert!([30, 70].contains(&(own_ms[1] - own_ms[0])), "{own_ms:?} at {stamp_ms}");
    }
}

#[test]
fn a_gap_does_not_change_the_rate() {
    let stamp_ms = |k: i64| 1_000 + k * 80 + if k >= 20 { 5_000 } else { 0 };
    let messages: Vec<Message> = (0..40).map(|k| message(stamp_ms(k), "map", &[1_000.0])).collect();
    assert_eq!(stamps(&played(messages)), (0..40).map(stamp_ms).collect::<Vec<_>>());
}

#[test]
fn stamps_that_go_back_start_again() {
    for back_ms in [400, 8_000] {
        let stamp_ms = |k: i64| 9_000 + k * 80 - if k >= 20 { back_ms } else { 0 };
        let messages = (0..40).map(|k| Message {
            arrived_ns: k as u64 * 80_000_000,
            ..message(stamp_ms(k), "map", &[1_000.0])
        });
        let played = stamps(&played(messages.collect()));
        let [before, after] = [0..20, 23..40].map(|ticks| ticks.map(stamp_ms).collect::<Vec<_>>());
        assert!(played.starts_with(&before), "{played:?}");
        // The first three frames after the step may be late ones.
        assert!(played.ends_with(&after), "{back_ms}: {played:?}");
    }
}

#[test]
fn other_classes_and_impossible_values_are_counted() {
    let mut ticks = Ticks::new(world(None));
    let mut fast = object(1_000.0, label::CAR);
    fast.kinematics.twist_with_covariance.twist.linear.x = 500.0;
    let objects =
        [object(1_000.0, label::UNKNOWN), fast, object(99e3, label::BUS), object(f64::NAN, label::BUS)];
    let objects = objects.into_iter().chain([object(1_001.0, label::BICYCLE)]).map(Object::from).collect();
    ticks.message(Message { header: header(0, "map"), objects, sensor: 0, arrived_ns: 0 });
    let Tick { frame, .. } = ticks.next(0).unwrap();
    // An impossible speed is unknown; an impossible position loses the object.
    assert_eq!(
        frame
            .detections
            .iter()
            .map(|d| (d.agent_type, d.has(detection_flags::HAS_SPEED)))
            .collect::<Vec<_>>(),
        [(AgentType::Vehicle as u32, false), (AgentType::Cyclist as u32, true)]
    );
    frame.detections.iter().for_each(|detection| detection.check().unwrap());
    let counts = Counts { messages: 1, other: 1, refused: 1, not_finite: 1, unknown: 1, ..Counts::default() };
    assert_eq!(ticks.counts(), counts);
    assert!(ticks.take_problem().is_some_and(|problem| problem.contains("the position (NaN")));
}

#[test]
fn a_tracked_object_has_the_same_number_in_every_process() {
    let tracked = |uuid: [u8; 16]| TrackedObject {
        object_id: Uuid { uuid },
        classification: vec![ObjectClassification { label: label::PEDESTRIAN, probability: 1.0 }],
        ..TrackedObject::default()
    };
    let mut ticks = Ticks::new(world(None));
    let objects = [tracked([7; 16]), tracked(*b"0123456789abcdef")].map(Object::from).to_vec();
    ticks.message(Message { header: header(0, "map"), objects, sensor: 0, arrived_ns: 0 });
    let ids: Vec<u64> =
        ticks.next(0).map(|tick| tick.frame.detections.iter().map(|d| d.id).collect()).unwrap();
    assert_eq!(ids, [1, 0x0808_5351_5751_5351], "0 stands for no identity");
}

#[test]
fn a_full_frame_keeps_the_best_scores() {
    let mut ticks = Ticks::new(world(None));
    let objects = (0..DETECTIONS_MAX + 10).map(|k| {
        let mut object = object(1_000.0 + k as f64, label::CAR);
        object.existence_probability = if k < 5 { 0.1 } else { 0.9 };
        Object::from(object)
    });
    ticks.message(Message { header: header(0, "map"), objects: objects.collect(), sensor: 0, arrived_ns: 0 });
    let Tick { frame, left_out, .. } = ticks.next(0).unwrap();
    assert_eq!((frame.detections.len(), left_out), (DETECTIONS_MAX, 10));
    assert!(frame.detections.iter().all(|detection| detection.score > 0.5));
}

#[test]
fn messages_of_several_topics_name_their_sensor() {
    let mut ticks = Ticks::new(world(None));
    for sensor in [1, 2] {
        let objects = vec![Object::from(object(1_000.0, label::CAR))];
        let header = header(80 * i64::from(sensor), "map");
        ticks.message(Message { header, objects, sensor, arrived_ns: 80_000_000 * u64::from(sensor) });
    }
    let first = ticks.next(80_000_000).unwrap();
    let sensors: Vec<u8> = first.frame.detections.iter().map(|detection| detection.sensor).collect();
    assert_eq!(sensors, [1]);
}
