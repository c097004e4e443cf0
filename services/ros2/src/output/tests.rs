use bytemuck::Zeroable as _;
use run::{Run, StageRun};
use wire::{Cause, HistoryState, Quality};

use super::*;

fn output(options: &Options, is_built_in: bool) -> Output {
    let source = StageRun::with_options(&source::STAGE, &source::Options::default()).unwrap();
    let source = StageRun { built_in: is_built_in, ..source };
    let run = Run { stages: vec![source], origin_m: [100.0, 0.0], ..Run::default() };
    Output::new(&run, options)
}

fn header(seq: u64) -> Header {
    let mut header = Header {
        step_ns: 400_000_000,
        released_ns: 1_000_000_000,
        flags: flags::SEEN_FROM_EGO,
        ego_m: [1.0, 2.0],
        ..Header::new(1, seq, 1_500_000_000)
    };
    (header.counts.agents_len, header.counts.history_len, header.counts.horizon_len) = (2, 2, 2);
    header
}

/// Two tracks, and their forecasts with these ages in ms.
fn frames(ages_ms: [u64; 2]) -> ([Track; 2], [Forecast; 2]) {
    let track = |id: u64| {
        let mut track = Track { id, x_m: id as f32, ..Track::zeroed() };
        track.history[1] = HistoryState { present: 1, ..HistoryState::default() };
        track
    };
    let forecast = |id: u64, age_ms: u64| {
        let mut forecast = Forecast { id, modes_len: 4, age_ns: age_ms * 1_000_000, ..Forecast::zeroed() };
        (forecast.quality, forecast.cause) = (Quality::Held as u32, Cause::Late as u32);
        forecast.probability[..4].copy_from_slice(&[0.1, 0.2, 0.4, 0.3]);
        forecast
    };
    ([track(1), track(2)], [forecast(1, ages_ms[0]), forecast(2, ages_ms[1])])
}

/// The messages of a tick that was released 20 ms ago.
fn published(options: &Options, ages_ms: [u64; 2]) -> (PredictedObjects, DiagnosticArray) {
    let mut output = output(options, true);
    let (tracks, forecasts) = frames(ages_ms);
    output.tracks(&header(7), &tracks).unwrap();
    match output.forecasts(&header(7), &forecasts, 1_020_000_000) {
        Some(Outgoing::Forecasts(predicted, diagnostics, None)) => (predicted, diagnostics),
        other => panic!("{other:?}"),
    }
}

#[test]
fn paths_are_the_most_probable_ones_and_the_frame_is_the_option() {
    let options = Options { paths: 2, frame: "site".to_owned(), ..Options::default() };
    let (predicted, diagnostics) = published(&options, [0, 0]);
    assert_eq!((predicted.header.frame_id.as_str(), predicted.objects.len()), ("site", 2));
    assert_eq!(diagnostics.header.frame_id, "site");
    let paths = &predicted.objects[0].kinematics.predicted_paths;
    assert_eq!(paths.iter().map(|path| path.confidence).collect::<Vec<_>>(), [0.4, 0.3]);
    assert_eq!(predicted.objects[0].kinematics.initial_pose_with_covariance.pose.position.x, 101.0);
}

#[test]
fn objects_with_old_forecasts_are_left_out_and_counted() {
    let of = |max_age_ms| {
        let options = Options { max_age_ms, ..Options::default() };
        let (predicted, diagnostics) = published(&options, [0, 300]);
        let status = diagnostics.status.iter().find(|status| status.name == "stgdat: ros2").unwrap();
        let left_out = status.values.iter().find(|value| value.key == "left out now").unwrap();
        (predicted.objects.len(), left_out.value.clone(), status.level.0)
    };
    assert_eq!(of(None), (2, "0".to_owned(), 0));
    // The age counts from now: 300 ms at the release and 20 ms since.
    assert_eq!(of(Some(320.0)), (2, "0".to_owned(), 0));
    assert_eq!(of(Some(319.0)), (1, "1".to_owned(), 1));
    assert_eq!(of(Some(19.0)), (0, "2".to_owned(), 1));
}

#[test]
fn predicted_ticks_state_that_there_is_no_input_and_doubts_are_sentences() {
    let mut output = output(&Options::default(), true);
    let (tracks, forecasts) = frames([0, 0]);
    let mut tick = |seq, flag, doubts, now_ms: u64| {
        let mut header = Header { interval_ns: 80_000_000, ..header(seq) };
        header.flags |= flag;
        header.input.doubts = doubts;
        output.tracks(&header, &tracks).unwrap();
        match output.forecasts(&header, &forecasts, now_ms * 1_000_000) {
            Some(Outgoing::Forecasts(_, diagnostics, _)) => {
                (diagnostics.status[0].level.0, diagnostics.status[0].message.clone())
            }
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(tick(1, 0, 0, 1_010).0, 0);
    let (level, message) = tick(2, 0, wire::doubts::HEADINGS_IN_DEGREES, 1_020);
    assert_eq!((level, message.as_str()), (1, "the input looks wrong: headings look like degrees"));
    let (level, message) = tick(3, flags::PREDICTED, 0, 1_200);
    assert_eq!((level, message.as_str()), (1, "no detections arrived: the tracks are predicted"));
    let (level, message) = tick(4, flags::PREDICTED, 0, 4_100);
    assert_eq!((level, message.as_str()), (2, "NO INPUT for 3.1 s: the tracks are predicted"));
}

#[test]
fn the_ego_vehicles_pose_is_published_unless_the_vehicle_does() {
    let has_tf = |tf, is_built_in| {
        let mut output = output(&Options { tf, ..Options::default() }, is_built_in);
        match output.tracks(&header(1), &frames([0, 0]).0) {
            Some(Outgoing::Tracks(_, transforms)) => transforms.is_some(),
            other => panic!("{other:?}"),
        }
    };
    assert!(has_tf(None, true) && !has_tf(None, false));
    assert!(has_tf(Some(true), false) && !has_tf(Some(false), true));
}

#[test]
fn forecasts_without_tracks_and_frames_that_are_no_ticks_have_no_message() {
    let mut output = output(&Options::default(), true);
    let (tracks, forecasts) = frames([0, 0]);
    let warm_up = Header { flags: flags::WARM_UP, ..header(0) };
    assert_eq!(output.tracks(&warm_up, &[]), None);
    assert_eq!(output.tracks(&Header { flags: flags::VOID, ..header(0) }, &[]), None, "not an empty road");
    assert_eq!(output.forecasts(&warm_up, &[], 0), None);
    (1..40).for_each(|seq| drop(output.tracks(&header(seq), &tracks)));
    assert_eq!(output.waiting.len(), WAITING_MAX);
    assert_eq!(output.forecasts(&header(3), &forecasts, 0), None);
    assert_eq!(output.published.unpaired, 1);
    assert!(output.forecasts(&header(39), &forecasts, 0).is_some() && output.waiting.is_empty());
}

#[test]
fn markers_have_the_colour_the_dash_and_the_words_of_the_cause() {
    use interop::messages::marker;
    let options = Options { markers: true, frame: "site".to_owned(), paths: 2, ..Options::default() };
    let mut output = output(&options, true);
    let (tracks, mut forecasts) = frames([0, 0]);
    // 12 m straight on: held because the controls were late, with a dash of 2.5 m and a gap of 1 m.
    forecasts[0].modes[2][..2].copy_from_slice(&[[7.0, 0.0], [13.0, 0.0]]);
    output.tracks(&header(7), &tracks).unwrap();
    let Some(Outgoing::Forecasts(_, _, Some(array))) = output.forecasts(&header(7), &forecasts, 0) else {
        panic!("no markers")
    };
    let [delete, body, path, other, label, ..] = &array.markers[..] else { panic!("{array:?}") };
    assert!(array.markers.iter().all(|marker| marker.header.frame_id == "site"));
    assert_eq!((delete.action, body.r#type, array.markers.len()), (marker::DELETEALL, marker::CUBE, 9));
    let look = wire::vocabulary::look(Cause::Late as u32).unwrap();
    for colored in [body, path, other, label] {
        let bytes =
            [colored.color.r, colored.color.g, colored.color.b].map(|value| (value * 255.0).round() as u8);
        assert_eq!(bytes, look.dark);
    }
    assert_eq!((path.color.a, other.color.a), (1.0, 0.25 + 0.75 * 0.75));
    let ends: Vec<f64> = path.points.iter().map(|point| point.x).collect();
    assert_eq!(ends, [101.0, 103.5, 104.5, 107.0, 108.0, 110.5, 111.5, 113.0].map(|x: f64| x));
    assert_eq!(label.text, format!("vehicle 1\nheld: {}", look.words));
    let mut ids: Vec<i32> = array.markers.iter().map(|marker| marker.id).collect();
    ids.dedup();
    assert_eq!(ids.len(), array.markers.len(), "each marker has its own number");
}
