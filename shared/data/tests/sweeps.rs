//! From rows with their own stamps to frames: sensors with offsets, stamps per object, poses, clocks.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use data::{Format, Frame, Input, ReadError, Recording, Role, parse};
use proptest::prelude::*;
use wire::{AgentType, Detection};

const MS: i64 = 1_000_000;
/// Three vehicles and two pedestrians.
const SPEEDS_MPS: [f64; 5] = [10.0, 8.0, 6.0, 1.4, 1.2];

/// A row of a file.
#[derive(Clone, Debug)]
struct Row {
    stamp_ns: i64,
    id: Option<usize>,
    kind: &'static str,
    position_m: [f64; 2],
}

fn agent(id: usize, stamp_ns: i64) -> Row {
    let kind = if SPEEDS_MPS[id % 5] < 2.0 { "pedestrian" } else { "vehicle" };
    let position_m = [SPEEDS_MPS[id % 5] * stamp_ns as f64 * 1e-9, 6.0 * id as f64];
    Row { stamp_ns, id: Some(id), kind, position_m }
}

/// Sweeps of five agents, each `offsets_ns` after the sweep.
fn sweeps(len: i64, interval_ns: i64, offsets_ns: [i64; 5]) -> Vec<Row> {
    let agents = |sweep: i64| (0..5).map(move |id| agent(id, sweep * interval_ns + offsets_ns[id]));
    (0..len).flat_map(agents).collect()
}

fn text(rows: &[Row]) -> String {
    let mut text = "stamp_s,id,type,x_m,y_m\n".to_owned();
    for Row { stamp_ns, id, kind, position_m: [x, y] } in rows {
        let id = id.map_or_else(String::new, |id| id.to_string());
        let seconds = format!("{}.{:09}", stamp_ns / 1_000_000_000, stamp_ns % 1_000_000_000);
        writeln!(text, "{seconds},{id},{kind},{x},{y}").expect("a string takes all");
    }
    text
}

fn try_read(text: &str) -> Result<Recording, ReadError> {
    parse(Format::Csv, &[Input::new(Role::Rows, "own.csv", text)])
}

fn read(rows: &[Row]) -> Recording {
    try_read(&text(rows)).unwrap_or_else(|error| panic!("{error}"))
}

fn without_ids(rows: Vec<Row>) -> Vec<Row> {
    rows.into_iter().map(|row| Row { id: None, ..row }).collect()
}

/// The agents of each frame, identified by their positions, which do not depend on identities.
fn agents(recording: &Recording) -> Vec<Vec<i64>> {
    let lane = |detection: &Detection| (detection.y_m / 6.0).round() as i64;
    let of_frame = |frame: &Frame| {
        let mut lanes: Vec<i64> = frame.detections.iter().map(lane).collect();
        lanes.sort_unstable();
        lanes
    };
    recording.frames.iter().map(of_frame).collect()
}

/// Asserts that every detection is where its agent is at the detection's own time.
fn assert_own_times(recording: &Recording) {
    for frame in &recording.frames {
        let has_id = |d: &&Detection| d.has(wire::detection_flags::HAS_ID);
        let own = frame.detections.iter().filter(has_id).map(|d| (d.id, d.x_m, d.offset_ns));
        assert!(own.eq(frame.truth.iter().map(|truth| (truth.id, truth.x_m, truth.offset_ns))));
        for detection in &frame.detections {
            assert!(detection.offset_ns <= 0, "the stamp is that of the newest");
            let own_s = (frame.stamp_ns + detection.offset_ns) as f64 * 1e-9;
            let speed_mps = SPEEDS_MPS[(detection.y_m / 6.0).round() as usize % 5];
            assert!((f64::from(detection.x_m) - speed_mps * own_s).abs() < 1e-3, "{detection:?} at {own_s}");
        }
    }
}

fn assert_whole(recording: &Recording, len: usize, interval_ns: u64) {
    let all = vec![vec![0, 1, 2, 3, 4]; len];
    assert_eq!(agents(recording), all);
    assert_eq!(recording.interval_ns, interval_ns);
    assert_own_times(recording);
}

#[test]
fn sensors_with_constant_offsets_share_frames() {
    for interval_ms in [10, 33, 50, 80, 100, 500] {
        let share = |percent: i64| interval_ms * MS * percent / 100;
        for [second, third] in [[30, 30], [-30, -30], [45, 45], [15, 40], [-20, 25], [1, 2]] {
            let offsets_ns = [0, 0, 0, share(second), share(third)].map(|ns| ns + interval_ms * MS);
            let rows = sweeps(60, interval_ms * MS, offsets_ns);
            let interval_ns = (interval_ms * MS) as u64;
            assert_whole(&read(&rows), 60, interval_ns);
            assert_whole(&read(&without_ids(rows)), 60, interval_ns);
        }
    }
}

#[test]
fn stamps_by_object_belong_to_their_sweep() {
    for apart_ns in [20 * MS, 15 * MS, 3 * MS, 5_000] {
        let offsets_ns = [0, 1, 2, 3, 4].map(|place| place * apart_ns);
        let rows = sweeps(100, 100 * MS, offsets_ns);
        assert_whole(&read(&rows), 100, 100_000_000);
        assert_whole(&read(&without_ids(rows)), 100, 100_000_000);
    }
}

#[test]
fn dropped_sweeps_shift_no_other() {
    // The first sensor misses every seventh sweep, and the second every fifth.
    let mut rows = sweeps(70, 100 * MS, [0, 0, 0, 30 * MS, 30 * MS]);
    let sweep = |row: &Row| row.stamp_ns / (100 * MS);
    rows.retain(|row| if row.kind == "vehicle" { sweep(row) % 7 != 3 } else { sweep(row) % 5 != 2 });
    for rows in [rows.clone(), without_ids(rows)] {
        let recording = read(&rows);
        for (frame, lanes) in recording.frames.iter().zip(agents(&recording)) {
            let sweep = frame.stamp_ns / (100 * MS);
            let vehicles = (0..3).filter(|_| sweep % 7 != 3);
            let expected: Vec<i64> = vehicles.chain((3..5).filter(|_| sweep % 5 != 2)).collect();
            assert_eq!(lanes, expected, "sweep {sweep}");
        }
        assert_eq!(recording.frames.len(), 68, "two sweeps of 70 were dropped by both");
        assert_own_times(&recording);
    }
}

#[test]
fn sensors_of_other_rates_join_the_fastest() {
    for (slow_ms, fast_ms, offset_ms) in [(200, 100, 0), (200, 100, 30), (100, 80, 7), (400, 100, 10)] {
        let fast =
            (0..80 * fast_ms).step_by(fast_ms).flat_map(|ms| (0..3).map(move |id| agent(id, ms as i64 * MS)));
        let slow = (offset_ms..80 * fast_ms).step_by(slow_ms);
        let slow = slow.flat_map(|ms| (3..5).map(move |id| agent(id, ms as i64 * MS)));
        let rows: Vec<Row> = fast.chain(slow).collect();
        for rows in [rows.clone(), without_ids(rows)] {
            let recording = read(&rows);
            let found = agents(&recording);
            let vehicles = found.iter().filter(|lanes| lanes.starts_with(&[0, 1, 2])).count();
            assert_eq!(vehicles, 80, "{slow_ms} and {fast_ms}");
            let pedestrians = found.iter().filter(|lanes| lanes.ends_with(&[3, 4])).count();
            assert_eq!(pedestrians, (80 * fast_ms - offset_ms).div_ceil(slow_ms), "{slow_ms} and {fast_ms}");
            assert!(found.len() <= 81, "{} frames", found.len());
            assert_eq!(recording.interval_ns, fast_ms as u64 * 1_000_000, "{slow_ms} and {fast_ms}");
            assert_own_times(&recording);
        }
    }
}

#[test]
fn a_type_at_a_lower_rate_is_not_observed_between() {
    let fast = (0..40).flat_map(|sweep| (0..3).map(move |id| agent(id, sweep * 100 * MS)));
    let slow = (0..10).flat_map(|sweep| (3..5).map(move |id| agent(id, sweep * 400 * MS)));
    let recording = read(&fast.chain(slow).collect::<Vec<Row>>());
    assert_eq!(recording.frames.len(), 40);
    for (number, frame) in recording.frames.iter().enumerate() {
        let observes = frame.observed_types & AgentType::Pedestrian.bit() != 0;
        assert_eq!(observes, number % 4 == 0, "frame {number}");
        assert_ne!(frame.observed_types & AgentType::Vehicle.bit(), 0);
    }
}

/// A pedestrian who is often missed, two who are seen for a moment, and one who comes back are no slower sensor.
#[test]
fn a_type_with_gaps_is_observed_all_the_time() {
    let fast = (0..60).flat_map(|sweep| (0..3).map(move |id| agent(id, sweep * 100 * MS)));
    let often_missed: &[i64] = &[0, 3, 5, 7, 10, 11, 12, 13, 14, 18, 21, 22];
    for sweeps in [often_missed, &[20, 22], &[20, 22, 50, 52], &[1, 2, 3, 4, 5, 41, 42, 43, 44]] {
        let slow = sweeps.iter().map(|sweep| agent(3, sweep * 100 * MS));
        let rows: Vec<Row> = fast.clone().chain(slow).collect();
        for rows in [rows.clone(), without_ids(rows)] {
            let recording = read(&rows);
            assert!(recording.frames.iter().all(|frame| frame.observed_types == 7), "{sweeps:?}");
        }
    }
}

/// The rows of a file with poses, of a car that drives at 5 m/s along x and turns over ±π.
fn with_poses(rows: &[Row], poses_ns: impl Iterator<Item = i64>) -> String {
    let mut text = text(rows).replace("y_m\n", "y_m,heading_rad\n");
    text = text
        .lines()
        .map(|line| format!("{line}{}\n", if line.starts_with("stamp") { "" } else { "," }))
        .collect();
    for stamp_ns in poses_ns {
        let s = stamp_ns as f64 * 1e-9;
        let heading_rad =
            (3.0 + 0.1 * s + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
        writeln!(text, "{s:.9},,ego,{},-8,{heading_rad}", 5.0 * s).expect("a string takes all");
    }
    text
}

#[test]
fn poses_make_no_frame_and_are_interpolated() {
    let rows = sweeps(200, 100 * MS, [1_300_000; 5]);
    for apart_ms in [5, 20, 70, 100, 300, 1_000] {
        let recording =
            try_read(&with_poses(&rows, (0..=20_100).step_by(apart_ms).map(|ms| ms as i64 * MS))).unwrap();
        assert_whole(&recording, 200, 100_000_000);
        assert_eq!(recording.poses_missing, 0);
        for frame in &recording.frames {
            let s = frame.stamp_ns as f64 * 1e-9;
            let ego = frame.ego;
            assert!(ego.is_sensor);
            assert!((f64::from(ego.position_m[0]) - 5.0 * s).abs() < 1e-3, "{ego:?} at {s}");
            let off_rad = f64::from(ego.heading_rad) - 3.0 - 0.1 * s;
            assert!(off_rad.sin().abs() < 1e-3 && off_rad.cos() > 0.9, "{ego:?} at {s}");
        }
    }
}

#[test]
fn poses_that_ended_are_not_used() {
    let rows = sweeps(200, 100 * MS, [0; 5]);
    let recording = try_read(&with_poses(&rows, (0..=10_000).step_by(50).map(|ms| ms as i64 * MS))).unwrap();
    assert_eq!(recording.frames.len(), 200);
    // The pose at 10 s is used up to 11 s.
    assert_eq!(recording.poses_missing, 89);
    let is_sensor = recording.frames.iter().map(|frame| frame.ego.is_sensor);
    assert_eq!(is_sensor.filter(|is_sensor| *is_sensor).count(), 111);
    assert_eq!(recording.frames[199].ego.position_m, [50.0, -8.0]);
}

#[test]
fn a_sensor_that_does_not_move_keeps_its_pose() {
    let rows = sweeps(200, 100 * MS, [0; 5]);
    let recording = try_read(&with_poses(&rows, std::iter::once(0))).unwrap();
    assert_eq!(recording.poses_missing, 0);
    assert!(recording.frames.iter().all(|frame| frame.ego.is_sensor && frame.ego.position_m == [0.0, -8.0]));
}

fn refusal(rows: &[Row]) -> String {
    try_read(&text(rows)).expect_err("time goes back").to_string()
}

#[test]
fn a_clock_set_back_is_refused_with_the_line() {
    for back_ms in [150, 3_050, 9_000] {
        let mut rows = sweeps(200, 100 * MS, [20_000 * MS; 5]);
        rows.iter_mut().skip(500).for_each(|row| row.stamp_ns -= back_ms * MS);
        let refusal = refusal(&rows);
        let after_s = 30.0 - back_ms as f64 * 1e-3;
        let expected =
            format!("own.csv:502: time goes back for id 0: {after_s:.3} s after 29.900 s in line 497: ");
        assert!(refusal.starts_with(&expected), "{refusal}");
        assert!(refusal.contains("Cut the file there") && refusal.contains("sort"), "{refusal}");
    }
    for back_ms in [350, 950, 3_050] {
        let mut rows = without_ids(sweeps(200, 100 * MS, [20_000 * MS; 5]));
        rows.iter_mut().skip(500).for_each(|row| row.stamp_ns -= back_ms * MS);
        assert!(refusal(&rows).starts_with("own.csv:502: time goes back: "), "{back_ms}");
    }
    // One row that was written late is sorted in.
    let mut rows = without_ids(sweeps(200, 100 * MS, [20_000 * MS; 5]));
    rows[40..60].rotate_left(1);
    assert_eq!(read(&rows).frames.len(), 200);
}

#[test]
fn a_recording_played_twice_is_refused() {
    for off_ns in [1, MS, 4 * MS, 50 * MS, 100 * MS, -100 * MS] {
        let first = sweeps(100, 100 * MS, [1_000 * MS; 5]);
        let again = first.iter().map(|row| Row { stamp_ns: row.stamp_ns + off_ns, ..row.clone() });
        let rows: Vec<Row> = first.iter().cloned().chain(again).collect();
        assert!(refusal(&rows).starts_with("own.csv:502: time goes back for id 0: "), "{off_ns}");
        let rows = without_ids(rows);
        assert!(refusal(&rows).starts_with("own.csv:502: time goes back: "), "{off_ns}");
    }
}

#[test]
fn files_by_track_or_newest_first_are_in_order() {
    let mut rows = sweeps(50, 100 * MS, [0, 0, 0, 30 * MS, 30 * MS]);
    rows.sort_by_key(|row| row.id);
    assert_whole(&read(&rows), 50, 100_000_000);
    rows.reverse();
    assert_whole(&read(&rows), 50, 100_000_000);
}

#[test]
fn stamps_are_rounded_to_the_nanosecond() {
    let cases = [
        ("0.30000000000000004", 300_000_000),
        ("0.7999999999999999", 800_000_000),
        ("-0.30000000000000004", -300_000_000),
        ("1.7e9", 1_700_000_000_000_000_000),
        ("1700000000.123456789", 1_700_000_000_123_456_789),
        ("1.5E-3", 1_500_000),
        ("1e-12", 0),
        ("+.25", 250_000_000),
        ("12.", 12_000_000_000),
        ("0.0000000015", 2),
        ("4e9", 4_000_000_000_000_000_000),
    ];
    for (stamp, expected_ns) in cases {
        let recording = try_read(&format!("stamp_s,type,x_m,y_m\n{stamp},vehicle,1,2\n")).unwrap();
        assert_eq!(recording.frames[0].stamp_ns, expected_ns, "{stamp}");
    }
    for stamp in
        ["", ".", "-", "e3", "1e", "1e100", "0x10", "1.2.3", "--1", "nan", "inf", "1_000", "4000000000.1"]
    {
        assert!(try_read(&format!("stamp_s,type,x_m,y_m\n{stamp},vehicle,1,2\n")).is_err(), "{stamp}");
    }
}

/// A scene in which agents come and go, and the sensor that sees each.
#[derive(Clone, Debug)]
struct Scene {
    interval_ns: i64,
    /// Whether each agent is present in each sweep.
    present: Vec<Vec<bool>>,
    sensors: Vec<usize>,
    /// In thousandths of the interval, below half of it.
    offsets: [i64; 3],
    seed: u64,
}

fn scene() -> impl Strategy<Value = Scene> {
    (3_usize..8, 20_usize..40).prop_flat_map(|(agents_len, sweep_count)| {
        let spans = prop::collection::vec((0..sweep_count / 4, sweep_count * 3 / 4..sweep_count), agents_len);
        let sensors = prop::collection::vec(0_usize..3, agents_len);
        let offsets = prop::array::uniform3(0_i64..490);
        (spans, sensors, offsets, 10_i64..500, any::<u64>()).prop_map(
            move |(spans, sensors, offsets, interval_ms, seed)| {
                let is_present =
                    |sweep: usize| spans.iter().map(|(from, to)| (*from..=*to).contains(&sweep)).collect();
                let present = (0..sweep_count).map(is_present).collect();
                Scene { interval_ns: interval_ms * MS, present, sensors, offsets, seed }
            },
        )
    })
}

impl Scene {
    fn rows(&self, with_offsets: bool) -> Vec<Row> {
        let mut rows = Vec::new();
        for (sweep, present) in self.present.iter().enumerate() {
            for id in (0..present.len()).filter(|&id| present[id]) {
                let offset = if with_offsets { self.offsets[self.sensors[id]] } else { 0 };
                rows.push(agent(id, sweep as i64 * self.interval_ns + offset * self.interval_ns / 1_000));
            }
        }
        rows
    }

    fn shuffled(&self, mut rows: Vec<Row>) -> Vec<Row> {
        let mut state = self.seed | 1;
        for place in (1..rows.len()).rev() {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            rows.swap(place, (state >> 33) as usize % (place + 1));
        }
        rows
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn sensors_and_the_order_of_rows_do_not_matter(scene in scene()) {
        let expected = read(&scene.rows(false));
        let rows = scene.rows(true);
        let split = read(&scene.shuffled(rows.clone()));
        prop_assert_eq!(agents(&split), agents(&expected));
        assert_own_times(&split);
        prop_assert_eq!(&split, &Recording { sha256: split.sha256.clone(), ..read(&rows) }, "any order");

        let stamps: BTreeMap<(usize, i64), ()> = rows.iter().map(|row| ((row.id.unwrap(), row.stamp_ns), ())).collect();
        let found = split.frames.iter().flat_map(|frame| {
            frame.detections.iter().map(|d| ((d.id as usize, frame.stamp_ns + d.offset_ns), ()))
        });
        prop_assert_eq!(found.collect::<BTreeMap<_, _>>(), stamps, "own times are exact");
    }

    #[test]
    fn without_identities_no_measurement_is_lost(scene in scene()) {
        let split = read(&without_ids(scene.shuffled(scene.rows(true))));
        assert_own_times(&split);
        let found: usize = split.frames.iter().map(|frame| frame.detections.len()).sum();
        prop_assert_eq!(found, scene.rows(true).len());
    }
}
