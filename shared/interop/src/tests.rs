use bytemuck::Zeroable as _;
use recording::{About, Event, Frame, Happened, Message};
use scene::MapBuilder;
use wire::{Forecast, ForecastsTopic, Header, HistoryState, Hop, Quality, Topic, Track, TracksTopic, flags};

use crate::cdr::{Cdr, from_bytes, to_bytes};
use crate::messages::{
    DetectedObjects, DiagnosticArray, MarkerArray, PredictedObjects, TfMessage, TrackedObjects, label,
};
use crate::{GRID_TOPIC, Target, ViewOptions, views};

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
    // `tests/interop/markers_by_rosbags.py` wrote this one.
    let markers: MarkerArray = golden(include_bytes!("golden/MarkerArray.cdr"));
    let [first, second] = &markers.markers[..] else { panic!("{markers:?}") };
    assert_eq!((first.header.stamp.sec, first.color.a, second.uv_coordinates.len()), (1, 21.0 / 8.0, 2));
    assert!(second.mesh_use_embedded_materials != first.mesh_use_embedded_materials);
}

fn frame<T: Topic>(seq: u64, elements: &[T::Element]) -> Message {
    let mut header = Header {
        step_ns: 400_000_000,
        flags: flags::SEEN_FROM_EGO,
        ego_m: [1.0, 2.0],
        ..Header::new(1, seq, 1_500_000_000)
    };
    header.counts.agents_len = elements.len() as u32;
    (header.counts.history_len, header.counts.horizon_len) = (2, 2);
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
        noise_m: 0.25,
        noise_heading_rad: 0.5,
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
    viewed_within(targets, None, messages)
}

fn viewed_within(
    targets: &[Target],
    max_age_ns: Option<u64>,
    messages: &[Message],
) -> Vec<(&'static str, Vec<u8>)> {
    let mut about = About { clock_offset_ns: 1_000, ..About::default() };
    about.run.origin_m = [1e6, 5e6];
    let mut view = views(ViewOptions { targets, paths_max: 2, max_age_ns, map: None }, &about).unwrap();
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
    assert_eq!((agent.level.0, agent.message.as_str()), (1, "held"));
    let tick = diagnostics.status.iter().find(|status| status.name == "stgdat: tick").unwrap();
    let noise = tick.values.iter().filter(|value| value.key.starts_with("noise"));
    let noise: Vec<_> = noise.map(|value| (value.key.as_str(), value.value.as_str())).collect();
    assert_eq!(noise, [("noise: cyclist position_m", "0.25"), ("noise: cyclist heading_rad", "0.5")]);
}

#[test]
fn forecasts_older_than_the_limit_are_left_out_of_the_predicted_objects() {
    let tracks = [track(), Track { id: 6, source_id: 42, ..track() }];
    let forecasts = [forecast(), Forecast { id: 6, age_ns: 100_000_000, ..forecast() }];
    let with_times = |message: Message| {
        let Message::Frame(frame) = message else { return message };
        let mut header = *frame.header();
        header.released_ns = 1_000_000_000;
        header.push_hop(Hop { sent_ns: 1_050_000_000, ..Hop::default() });
        Message::Frame(Frame::of::<ForecastsTopic>(&header, &forecasts, 1_060_000_000))
    };
    let messages = [frame::<TracksTopic>(3, &tracks), with_times(frame::<ForecastsTopic>(3, &forecasts))];
    // The ages are 50 and 150 ms when the forecasts are sent.
    for (max_age_ms, expected) in [(None, 2), (Some(150), 2), (Some(149), 1), (Some(50), 1), (Some(49), 0)] {
        let max_age_ns = max_age_ms.map(|age_ms: u64| age_ms * 1_000_000);
        let found = viewed_within(&[Target::Autoware, Target::Foxglove], max_age_ns, &messages);
        let of = |wanted: &str| found.iter().find(|(topic, _)| *topic == wanted).unwrap().1.clone();
        let predicted: PredictedObjects = from_bytes(&of("/perception/object_recognition/objects")).unwrap();
        assert_eq!(predicted.objects.len(), expected, "{max_age_ms:?}");
        let diagnostics: DiagnosticArray = from_bytes(&of("/diagnostics")).unwrap();
        let agents = diagnostics.status.iter().filter(|status| status.name.starts_with("stgdat: agent"));
        assert_eq!(agents.count(), 2, "the diagnostics have all forecasts");
    }
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

#[test]
fn a_refused_tick_is_not_an_empty_road() {
    let refused = |flags| {
        let header = Header { flags, ..Header::new(1, 3, 1_500_000_000) };
        let tracks = Message::Frame(Frame::of::<TracksTopic>(&header, &[], 7));
        let forecasts = Message::Frame(Frame::of::<ForecastsTopic>(&header, &[], 7));
        viewed(&[Target::Autoware], &[tracks, forecasts]).len()
    };
    assert_eq!((refused(0), refused(flags::VOID)), (3, 0));
}

#[test]
fn a_fixed_map_is_sent_once_as_a_grid() {
    let mut map = MapBuilder::new([-3.0, 4.0], 2, 3).unwrap();
    assert!(map.visit([-0.5, 5.5], [2.0, -1.0]));
    let mut about = About::default();
    about.run.origin_m = [1e6, 5e6];
    let options = |map| ViewOptions { targets: &[Target::Foxglove], paths_max: 1, max_age_ns: None, map };
    let mut view = views(options(Some(map.build())), &about).unwrap();
    let place = view.channels().iter().position(|channel| channel.topic == GRID_TOPIC).unwrap();
    let mut grids = Vec::new();
    for seq in 3..6 {
        view.add(&frame::<TracksTopic>(seq, &[track()]), &mut |channel, bytes| {
            if usize::from(channel) == place {
                grids.push(bytes.to_vec());
            }
        });
    }
    let [grid] = &grids[..] else { panic!("{} grids", grids.len()) };
    // Six cells of three numbers at the end; the visited one is the last.
    let numbers =
        grid[grid.len() - 6 * 12..].chunks(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()));
    let numbers: Vec<f32> = numbers.collect();
    assert!(numbers[..15].iter().all(|number| *number == 0.0), "{numbers:?}");
    assert!((numbers[15] - 2_f32.ln()).abs() < 1e-6, "the mean density");
    assert_eq!(numbers[16..], [2.0, -1.0]);
    let corner: Vec<u8> = [1e6 - 3.0, 5e6 + 4.0_f64].into_iter().flat_map(f64::to_le_bytes).collect();
    assert!(
        grid.windows(8).any(|bytes| bytes == &corner[..8])
            && grid.windows(8).any(|bytes| bytes == &corner[8..])
    );
    assert!(
        views(options(None), &about).unwrap().channels().iter().all(|channel| channel.topic != GRID_TOPIC)
    );
}
