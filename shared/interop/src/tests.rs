use bytemuck::Zeroable as _;
use recording::{About, Event, Frame, Happened, Message};
use wire::{Forecast, ForecastsTopic, Header, HistoryState, Quality, Topic, Track, TracksTopic, flags};

use crate::cdr::{Cdr, from_bytes, to_bytes};
use crate::messages::{DetectedObjects, DiagnosticArray, PredictedObjects, TfMessage, TrackedObjects, label};
use crate::{Target, views};

/// Reads Cyclone's bytes, writes them again, and returns the message.
fn golden<M: Cdr>(bytes: &[u8]) -> M {
    let message = from_bytes(bytes).unwrap();
    assert!(to_bytes(&message) == bytes, "other bytes than Cyclone's");
    message
}

/// `tests/interop/cdr_by_cyclonedds.py` wrote the files: every field has another value.
#[test]
fn messages_have_the_bytes_of_cyclone() {
    let predicted: PredictedObjects = golden(include_bytes!("golden/PredictedObjects.cdr"));
    let [first, second] = &predicted.objects[..] else { panic!("{predicted:?}") };
    assert_eq!((predicted.header.stamp.sec, predicted.header.frame_id.as_str()), (1, "é"));
    assert_eq!((first.object_id.uuid[0], first.object_id.uuid[15]), (4, 19));
    assert_eq!((first.existence_probability, first.classification[1].label), (20.0 / 8.0, 23));
    let pose = &second.kinematics.predicted_paths[1].path[1];
    assert_eq!(pose.orientation.w, pose.position.x + 6.0 / 8.0);
    let tracked: TrackedObjects = golden(include_bytes!("golden/TrackedObjects.cdr"));
    assert_eq!(tracked.objects.len(), 2);
    let detected: DetectedObjects = golden(include_bytes!("golden/DetectedObjects.cdr"));
    assert_eq!(detected.objects[0].existence_probability, 4.0 / 8.0);
    let tf: TfMessage = golden(include_bytes!("golden/TFMessage.cdr"));
    assert_eq!(tf.transforms.len(), 2);
    let diagnostics: DiagnosticArray = golden(include_bytes!("golden/DiagnosticArray.cdr"));
    assert_eq!(diagnostics.status[1].values.len(), 2);
}

fn frame<T: Topic>(seq: u64, elements: &[T::Element]) -> Message {
    let mut header = Header {
        step_ns: 400_000_000,
        flags: flags::SEEN_FROM_EGO,
        ego_m: [1.0, 2.0],
        ..Header::new(1, seq, 1_500_000_000)
    };
    (header.counts.agents_len, header.counts.history_len, header.counts.horizon_len) = (1, 2, 2);
    Message::Frame(Frame::of::<T>(&header, elements, 7))
}

fn track() -> Track {
    let mut track = Track {
        id: 5,
        source_id: 41,
        x_m: 3.0,
        heading_rad: std::f32::consts::FRAC_PI_2,
        vy_mps: 2.0,
        existence: 0.5,
        type_probability: [0.25, 0.75, 0.0],
        agent_type: 1,
        state_len: 4,
        ..Track::zeroed()
    };
    // Variances of x, y, vx and vy.
    (0..4).for_each(|row| track.covariance[row * 5] = row as f32 + 1.0);
    track.history[1] = HistoryState { present: 1, ..HistoryState::default() };
    track
}

fn forecast() -> Forecast {
    let mut forecast = Forecast { id: 5, modes_len: 3, quality: Quality::Held as u32, ..Forecast::zeroed() };
    forecast.probability[..3].copy_from_slice(&[0.2, 0.5, 0.3]);
    forecast.modes[1][..2].copy_from_slice(&[[3.0, 4.0], [6.0, 4.0]]);
    forecast.modes[2][..2].copy_from_slice(&[[4.0, 0.0], [4.0, 0.0]]);
    forecast
}

/// The messages that follow from these, by channel.
fn viewed(targets: &[Target], messages: &[Message]) -> Vec<(&'static str, Vec<u8>)> {
    let mut about = About { clock_offset_ns: 1_000, ..About::default() };
    about.run.origin_m = [1e6, 5e6];
    let mut view = views(targets, 2, &about).unwrap();
    let topics: Vec<&str> = view.channels().iter().map(|channel| channel.topic).collect();
    let mut found = Vec::new();
    for message in messages {
        view.add(message, &mut |channel, bytes| found.push((topics[usize::from(channel)], bytes.to_vec())));
    }
    found
}

#[test]
fn objects_hold_the_published_numbers_in_the_recordings_own_frame() {
    let messages = [frame::<TracksTopic>(3, &[track()]), frame::<ForecastsTopic>(3, &[forecast()])];
    let found = viewed(&[Target::Autoware], &messages);
    let names: Vec<&str> = found.iter().map(|(topic, _)| *topic).collect();
    let objects = "/perception/object_recognition/objects";
    assert_eq!(names, ["/perception/object_recognition/tracking/objects", "/tf", objects, "/diagnostics"]);

    let predicted: PredictedObjects = from_bytes(&found[2].1).unwrap();
    assert_eq!((predicted.header.stamp.sec, predicted.header.stamp.nanosec), (1, 500_000_000));
    let [object] = &predicted.objects[..] else { panic!("{predicted:?}") };
    let [first, second] = &object.kinematics.predicted_paths[..] else { panic!("{object:?}") };
    assert_eq!((first.confidence, second.confidence, first.time_step.nanosec), (0.5, 0.3, 400_000_000));
    let points: Vec<[f64; 2]> = first.path.iter().map(|pose| [pose.position.x, pose.position.y]).collect();
    assert_eq!(points, [[1e6 + 3.0, 5e6], [1e6 + 3.0, 5e6 + 4.0], [1e6 + 6.0, 5e6 + 4.0]]);
    // The last step is along +x.
    assert_eq!((first.path[2].orientation.z, first.path[2].orientation.w), (0.0, 1.0));
    assert_eq!(object.classification[0].label, label::BICYCLE);
    let twist = &object.kinematics.initial_twist_with_covariance;
    assert!((twist.twist.linear.x - 2.0).abs() < 1e-6 && twist.twist.linear.y.abs() < 1e-6, "{twist:?}");

    let tracked: TrackedObjects = from_bytes(&found[0].1).unwrap();
    assert_eq!(tracked.objects[0].object_id, object.object_id);
    assert_eq!(tracked.objects[0].existence_probability, 0.5);
    let tf: TfMessage = from_bytes(&found[1].1).unwrap();
    assert_eq!(tf.transforms[0].transform.translation.x, 1e6 + 1.0);
    let diagnostics: DiagnosticArray = from_bytes(&found[3].1).unwrap();
    let agent = diagnostics.status.iter().find(|status| status.name == "stgdat: agent 41").unwrap();
    assert_eq!((agent.level.0, agent.message.as_str()), (1, "held: none"));
}

#[test]
fn covariances_are_along_and_across_the_agent() {
    let found = viewed(&[Target::Autoware], &[frame::<TracksTopic>(3, &[track()])]);
    let tracked: TrackedObjects = from_bytes(&found[0].1).unwrap();
    let kinematics = &tracked.objects[0].kinematics;
    let pose = kinematics.pose_with_covariance.covariance.0;
    assert_eq!((pose[0], pose[7], pose[1]), (1.0, 2.0, 0.0));
    // The heading is +y: along it is the variance of vy.
    let twist = kinematics.twist_with_covariance.covariance.0;
    assert!((twist[0] - 4.0).abs() < 1e-6 && (twist[7] - 3.0).abs() < 1e-6, "{:?}", &twist[..8]);
}

#[test]
fn forecasts_without_their_tracks_and_control_frames_have_no_view() {
    let messages = [frame::<TracksTopic>(3, &[track()]), frame::<ForecastsTopic>(4, &[forecast()])];
    assert!(viewed(&[Target::Foxglove], &messages).iter().all(|(topic, _)| *topic == "/stgdat/tf"));
    let events = [Message::Event(Event { at_ns: 5, what: Happened::Linked })];
    let found = viewed(&[Target::Foxglove], &events);
    assert_eq!(found[0].0, "/stgdat/log");
    assert!(found[0].1.ends_with(b"\x22\x0asupervisor"), "{:?}", found[0].1);
}
