//! Forecasts of other systems in bags.

use data::{PredictedFrame, predicted_objects};
use interop::cdr::to_bytes;
use interop::messages::{
    Duration, ObjectClassification, Point, Pose, PredictedObject, PredictedObjects, PredictedPath, Uuid,
    label,
};
use wire::{AgentType, WorldOrigin};

use crate::rosbags::{bag, header, tf};

fn pose(x: f64) -> Pose {
    Pose { position: Point { x, ..Point::default() }, ..Pose::default() }
}

/// An object that goes 1 m in each step, on paths of these confidences.
fn object(class: u8, step_ns: u32, confidences: &[f32]) -> PredictedObject {
    let mut object = PredictedObject {
        object_id: Uuid { uuid: [7; 16] },
        classification: vec![
            ObjectClassification { label: label::UNKNOWN, probability: 0.1 },
            ObjectClassification { label: class, probability: 0.9 },
        ],
        ..PredictedObject::default()
    };
    object.kinematics.initial_pose_with_covariance.pose = pose(5.0);
    object.kinematics.predicted_paths = confidences
        .iter()
        .map(|&confidence| PredictedPath {
            path: (0..4).map(|step| pose(5.0 + f64::from(step))).collect(),
            time_step: Duration { sec: 0, nanosec: step_ns },
            confidence,
        })
        .collect();
    object
}

fn message(sec: i32, frame: &str, objects: &[PredictedObject]) -> (&'static str, &'static str, Vec<u8>) {
    let message = PredictedObjects { header: header(sec, frame), objects: objects.to_vec() };
    ("/objects", PredictedObjects::DEFINITION.name, to_bytes(&message))
}

fn read(messages: &[(&str, &str, Vec<u8>)], origin: WorldOrigin) -> Result<Vec<PredictedFrame>, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.mcap");
    std::fs::write(&path, bag(messages)).expect("a bag");
    predicted_objects(&path, origin).map_err(|error| error.to_string())
}

#[test]
fn paths_are_moved_to_the_root_less_the_origin() {
    let car = object(label::TRUCK, 500_000_000, &[0.2, 0.8]);
    let messages = [
        tf(10, "map", "base_link", 100.0),
        message(10, "base_link", &[car.clone(), object(label::UNKNOWN, 1, &[1.0])]),
        message(11, "map", &[car]),
    ];
    let frames = read(&messages, WorldOrigin::new([100.0, 0.0]).unwrap()).unwrap();
    assert_eq!((frames.len(), frames[0].stamp_ns, frames[0].other_len), (2, 10_000_000_000, 1));
    let truck = &frames[0].objects[0];
    assert_eq!(truck.agent_type, AgentType::Vehicle);
    // The frame is turned to the left, so ahead is +y.
    let near = |[x, y]: [f32; 2], [a, b]: [f32; 2]| (x - a).abs() < 1e-4 && (y - b).abs() < 1e-4;
    assert!(near(truck.position_m, [0.0, 5.0]), "{truck:?}");
    let [first, second] = &truck.paths[..] else { panic!("{truck:?}") };
    assert_eq!((first.confidence, second.confidence, first.duration_ns()), (0.2, 0.8, 1_500_000_000));
    let at = |after_ns| second.at(after_ns);
    assert!(near(at(1_250_000_000).unwrap(), [0.0, 7.5]), "between two points");
    assert_eq!((at(1_500_000_001), at(1_500_000_000).is_some()), (None, true));
    assert_eq!(frames[1].objects[0].position_m, [-95.0, 0.0]);
}

#[test]
fn errors_name_the_message_and_the_value() {
    let origin = WorldOrigin::default();
    let error = read(&[message(1, "map", &[object(label::CAR, 0, &[1.0])])], origin).unwrap_err();
    assert!(error.ends_with("drive.mcap: message 1: a time_step of 0 ns"), "{error}");
    let error = read(&[message(1, "base_link", &[])], origin).unwrap_err();
    assert!(error.contains("message 1: objects in the frame base_link, and no transform"), "{error}");
    let error = read(&[tf(1, "map", "base_link", 0.0)], origin).unwrap_err();
    assert!(error.ends_with("has no autoware_perception_msgs/msg/PredictedObjects"), "{error}");
    let mut far = object(label::CAR, 1, &[1.0]);
    far.kinematics.predicted_paths[0].path[1] = pose(f64::NAN);
    let error = read(&[message(1, "map", &[far])], origin).unwrap_err();
    assert!(error.contains("message 1: a position of NaN, NaN"), "{error}");
    let mut other = message(1, "map", &[]);
    other.0 = "/others";
    let error = read(&[message(1, "map", &[]), other], origin).unwrap_err();
    assert!(error.contains("objects on several topics: /objects, /others"), "{error}");
}
