//! Trajectories and windows: histories never depend on later rows.

use data::{
    Format, Input, Recording, Role, Window, WindowOptions, parse, tracks, tracks_from_positions, windows,
};
use proptest::prelude::*;
use wire::{AgentType, detection_flags};

const STEP_NS: i64 = 400_000_000;

fn read(format: Format, text: &str) -> Recording {
    let input = Input::new(Role::Rows, "a.csv", text);
    parse(format, &[input]).unwrap_or_else(|error| panic!("{error}"))
}

fn csv(rows: &str) -> Recording {
    read(Format::Csv, &format!("stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n{rows}"))
}

/// Pedestrians that wander at 2.5 Hz. `steps[k][i]` is the displacement of agent i in frame k, or `None` if
/// it is absent.
fn wandering(steps: &[Vec<Option<[f32; 2]>>]) -> Recording {
    let mut text = String::new();
    let agents_len = steps.first().map_or(0, Vec::len);
    let mut positions = vec![[0.0_f32; 2]; agents_len];
    for (frame, moves) in steps.iter().enumerate() {
        for (id, displacement) in moves.iter().enumerate() {
            if let Some([dx, dy]) = displacement {
                positions[id] = [positions[id][0] + dx, positions[id][1] + dy];
                text += &format!("{}\t{id}\t{}\t{}\n", frame * 10, positions[id][0], positions[id][1]);
            }
        }
    }
    read(Format::EthUcy, &text)
}

fn steps() -> impl Strategy<Value = Vec<Vec<Option<[f32; 2]>>>> {
    let step = prop::option::weighted(0.9, prop::array::uniform2(-0.8_f32..0.8));
    prop::collection::vec(prop::collection::vec(step, 3), 4..24)
        .prop_filter("somebody is seen in the first frame", |steps| steps[0].iter().any(Option::is_some))
}

fn histories(windows: &[Window], until_ns: i64) -> String {
    let known = windows.iter().filter(|window| window.stamp_ns <= until_ns);
    let described =
        known.flat_map(|window| &window.agents).map(|agent| (agent.id, agent.reported, &agent.history));
    format!("{:?}", described.collect::<Vec<_>>())
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn histories_do_not_depend_on_later_rows(steps in steps(), now in 1_usize..20, kick in -30.0_f32..30.0) {
        let now = now.min(steps.len() - 1);
        let mut changed = steps.clone();
        for displacement in changed.iter_mut().skip(now + 1).flatten().flatten() {
            displacement[0] += kick;
        }
        let now_ns = now as i64 * STEP_NS;
        for step_ns in [STEP_NS, 300_000_000, 500_000_000] {
            let options = WindowOptions { gap_max_ns: 800_000_000, ..WindowOptions::new(4, 6, step_ns) };
            let [a, b] = [&steps, &changed].map(|steps| histories(&windows(&wandering(steps), &options), now_ns));
            prop_assert_eq!(a, b);
        }
    }

    #[test]
    fn steps_at_recorded_times_are_the_recorded_rows(steps in steps()) {
        let recording = wandering(&steps);
        let row = |stamp_ns: i64, id: u64| {
            let frame = recording.frames.iter().find(|frame| frame.stamp_ns == stamp_ns)?;
            frame.detections.iter().find(|detection| detection.id == id).map(|d| [d.x_m, d.y_m])
        };
        for window in windows(&recording, &WindowOptions::new(3, 4, STEP_NS)) {
            for agent in window.agents {
                for (k, state) in agent.history.iter().enumerate() {
                    let stamp_ns = window.stamp_ns + (k as i64 - 2) * STEP_NS;
                    prop_assert_eq!(state.map(|state| state.position_m), row(stamp_ns, agent.id));
                }
                for (k, position_m) in agent.future.iter().enumerate() {
                    prop_assert_eq!(*position_m, row(window.stamp_ns + (k as i64 + 1) * STEP_NS, agent.id));
                }
            }
        }
    }
}

#[test]
fn velocities_are_backward_differences() {
    let recording = csv("0,1,pedestrian,0,0,,\n0.4,1,pedestrian,0.4,0,,\n0.8,1,pedestrian,0.4,0.8,,\n");
    let track = &tracks(&recording)[0];
    let velocities: Vec<[f32; 2]> = track.states.iter().map(|(_, state)| state.velocity_mps).collect();
    assert_eq!(velocities, [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]]);
    assert_eq!(track.states[2].1.heading_rad, std::f32::consts::FRAC_PI_2);

    let windows = windows(&recording, &WindowOptions::new(3, 1, STEP_NS));
    let first_known =
        |window: &Window| window.agents[0].history.iter().flatten().next().map(|s| s.velocity_mps);
    assert_eq!(first_known(&windows[0]), Some([0.0, 0.0]));
    assert_eq!(first_known(&windows[1]), Some([1.0, 0.0]));
    assert_eq!(first_known(&windows[2]), Some([1.0, 0.0]));
}

#[test]
fn the_heading_stays_during_a_stop() {
    let recording = csv("0,1,pedestrian,0,0,,\n0.4,1,pedestrian,0,1,,\n0.8,1,pedestrian,0,1.01,,\n");
    let headings: Vec<f32> =
        tracks(&recording)[0].states.iter().map(|(_, state)| state.heading_rad).collect();
    assert_eq!(headings, [0.0, std::f32::consts::FRAC_PI_2, std::f32::consts::FRAC_PI_2]);
}

#[test]
fn recorded_motion_is_used_unless_disabled() {
    let recording = csv("0,1,vehicle,0,0,1.5,3\n0.1,1,vehicle,0.4,0,1.5,3\n");
    let given = tracks(&recording)[0].states[1].1;
    assert_eq!((given.heading_rad, given.velocity_mps), (1.5, [3.0 * 1.5_f32.cos(), 3.0 * 1.5_f32.sin()]));
    let differenced = tracks_from_positions(&recording)[0].states[1].1;
    assert_eq!((differenced.heading_rad, differenced.velocity_mps), (0.0, [4.0, 0.0]));
}

#[test]
fn states_are_interpolated_over_short_gaps_only() {
    let rows =
        "0,1,vehicle,0,0,3.1,1\n0.3,1,vehicle,3,0,-3.1,2\n0.6,1,vehicle,6,0,-3.1,2\n3.6,1,vehicle,9,0,0,0\n";
    let options = WindowOptions::new(4, 4, 200_000_000);
    let windows = windows(&csv(rows), &options);
    let at_600 = windows.iter().find(|window| window.stamp_ns == 600_000_000).unwrap();
    let x_m: Vec<Option<f32>> = at_600.agents[0].history.iter().map(|s| s.map(|s| s.position_m[0])).collect();
    // 0.2 s and 0.4 s are in gaps of 0.3 s, which are longer than a step but not longer than the recording's
    // interval.
    assert_eq!(x_m, [Some(0.0), Some(2.0), Some(4.0), Some(6.0)]);
    // If the frame of 0.3 s is missing, the gap is two intervals.
    let without = |options: &WindowOptions| {
        let rows = "0,1,vehicle,0,0,,\n0.6,1,vehicle,6,0,,\n0.9,1,vehicle,9,0,,\n1.2,1,vehicle,12,0,,\n";
        let windows = data::windows(&csv(rows), options);
        let window = windows.into_iter().find(|window| window.stamp_ns == 600_000_000).unwrap();
        window.agents[0].history.iter().map(Option::is_some).collect::<Vec<_>>()
    };
    assert_eq!(without(&options), [true, false, false, true]);
    let longer = WindowOptions { gap_max_ns: 600_000_000, ..options };
    assert_eq!(without(&longer), [true; 4]);

    let agent = &windows.iter().find(|window| window.stamp_ns == 600_000_000).unwrap().agents[0];
    let state = agent.history[1].unwrap();
    assert!((state.position_m[0] - 2.0).abs() < 1e-6);
    // The short way from 3.1 to −3.1 passes π.
    assert!(
        (state.heading_rad.abs()
            - (3.1 + (std::f32::consts::TAU - 6.2) * 2.0 / 3.0 - std::f32::consts::TAU).abs())
        .abs()
            < 1e-5
    );
    assert_eq!(agent.future, [None; 4]);
}

/// A vehicle and a pedestrian on curved paths, recorded at a rate from 0 s to 20 s.
fn recorded_at(hertz: f64, has_motion: bool) -> Recording {
    let mut rows = String::new();
    for frame in 0..=(20.0 * hertz) as usize {
        let at_s = frame as f64 / hertz;
        for (id, kind, speed_mps) in [(1, "vehicle", 9.0), (2, "pedestrian", 1.3)] {
            let heading_rad = 0.1 * at_s;
            let radius_m = speed_mps / 0.1;
            let [x_m, y_m] = [radius_m * heading_rad.sin(), radius_m * (1.0 - heading_rad.cos())];
            let motion = if has_motion { format!("{heading_rad},{speed_mps}") } else { ",".to_owned() };
            rows += &format!("{at_s:.9},{id},{kind},{x_m},{y_m},{motion}\n");
        }
    }
    csv(&rows)
}

/// Rates, and the number of windows in 20 s: steps of 0.4 s, to the nearest frame.
const RATES_HZ: [(f64, usize); 9] = [
    (2.0, 41),
    (2.5, 51),
    (3.0, 61),
    (4.0, 41),
    (10.0, 51),
    (12.5, 51),
    (23.98, 48),
    (25.0, 51),
    (29.97, 50),
];

#[test]
fn windows_of_any_rate_have_whole_histories_and_futures() {
    for (hertz, expected_len) in RATES_HZ {
        for has_motion in [true, false] {
            let recording = recorded_at(hertz, has_motion);
            let windows = windows(&recording, &WindowOptions::new(8, 12, STEP_NS));
            assert_eq!(windows.len(), expected_len, "{hertz} Hz");
            let inner = |window: &&Window| (2_800_000_000..=15_000_000_000).contains(&window.stamp_ns);
            for window in windows.iter().filter(inner) {
                assert_eq!(window.agents.len(), 2, "{hertz} Hz");
                assert!(window.agents.iter().all(|agent| agent.is_complete()), "{hertz} Hz");
                // Between frames a chord is at most 0.28 m from the vehicle's path.
                let vehicle = &window.agents[0];
                for (step, position_m) in vehicle.future.iter().enumerate() {
                    let at_s = window.stamp_ns as f64 * 1e-9 + 0.4 * (step + 1) as f64;
                    let [x_m, y_m] = position_m.unwrap().map(f64::from);
                    let expected_m = [90.0 * (0.1 * at_s).sin(), 90.0 * (1.0 - (0.1 * at_s).cos())];
                    assert!(
                        (x_m - expected_m[0]).hypot(y_m - expected_m[1]) < 0.03,
                        "{hertz} Hz at {at_s} s"
                    );
                }
            }
        }
    }
}

#[test]
fn histories_of_any_rate_do_not_depend_on_later_frames() {
    for (hertz, _) in RATES_HZ {
        for has_motion in [true, false] {
            let whole = recorded_at(hertz, has_motion);
            let options = WindowOptions::new(8, 12, STEP_NS);
            let all = windows(&whole, &options);
            for window in all.iter().step_by(7) {
                let mut cut = whole.clone();
                cut.frames.retain(|frame| frame.stamp_ns <= window.stamp_ns);
                let last = windows(&cut, &options).pop().unwrap();
                assert_eq!(last.stamp_ns, window.stamp_ns, "{hertz} Hz");
                let of = |window: &Window| histories(std::slice::from_ref(window), i64::MAX);
                assert_eq!(of(&last), of(window), "{hertz} Hz at {}", window.stamp_ns);
            }
        }
    }
}

#[test]
fn rates_that_divide_the_step_are_not_interpolated() {
    for hertz in [2.5, 5.0, 10.0, 12.5, 25.0] {
        let recording = recorded_at(hertz, true);
        let row = |stamp_ns: i64, id: u64| {
            let frame = recording.frames.iter().find(|frame| frame.stamp_ns == stamp_ns)?;
            frame.detections.iter().find(|detection| detection.id == id).map(|d| [d.x_m, d.y_m])
        };
        for window in windows(&recording, &WindowOptions::new(3, 4, STEP_NS)) {
            assert_eq!(window.stamp_ns % STEP_NS, 0);
            for agent in &window.agents {
                for (step, state) in agent.history.iter().enumerate() {
                    let at_ns = window.stamp_ns + (step as i64 - 2) * STEP_NS;
                    assert_eq!(state.map(|state| state.position_m), row(at_ns, agent.id), "{hertz} Hz");
                }
            }
        }
    }
}

#[test]
fn windows_are_where_every_type_was_observed() {
    let riders = "track_id,frame_id,timestamp_ms,agent_type,x,y\n".to_owned()
        + &[4, 8, 12].map(|k| format!("P1,{k},{k}00,pedestrian/bicycle,{k},5\n")).concat();
    let input = |role, text: String| Input::new(role, "a.csv", text);
    let inputs = [input(Role::Vehicles, vehicles(1..=12)), input(Role::Pedestrians, riders)];
    let recording = parse(Format::Interaction, &inputs).unwrap();
    let stamps: Vec<i64> = windows(&recording, &WindowOptions::new(2, 1, STEP_NS))
        .iter()
        .map(|w| w.stamp_ns / 100_000_000)
        .collect();
    assert_eq!(stamps, [4, 8, 12]);
    assert_eq!(recording.frames[0].observed_types, AgentType::Vehicle.bit());
    assert_eq!(recording.frames[3].observed_types.count_ones(), 3);
    assert!(recording.frames[3].detections[0].has(detection_flags::HAS_SIZE));
    assert_eq!(recording.frames[3].detections[1].id, 1_000_000_001);
}

/// Rows at 10 Hz, from 0.3 s to 1.7 s, of a pedestrian, a cyclist at 5 m/s and a standing pedestrian, as
/// published.
fn published_pedestrians() -> String {
    let rows = (3..=17).flat_map(|frame| {
        let t_s = f64::from(frame) * 0.1;
        let row = |id: u32, [x, y]: [f64; 2], [vx, vy]: [f64; 2]| {
            format!("P{id},{frame},{frame}00,pedestrian/bicycle,{x:.3},{y:.3},{vx},{vy}\n")
        };
        [
            row(1, [0.0, 5.0 + 1.5 * t_s], [0.0, 1.5]),
            row(2, [3.0 * t_s, 4.0 * t_s], [3.0, 4.0]),
            row(3, [7.0, 7.0], [0.03, 0.0]),
        ]
    });
    "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy\n".to_owned() + &rows.collect::<String>()
}

fn vehicles(frames: std::ops::RangeInclusive<u32>) -> String {
    "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n".to_owned()
        + &frames.map(|frame| format!("1,{frame},{frame}00,car,{frame},0,10,0,0,4,2\n")).collect::<String>()
}

#[test]
fn published_interaction_takes_velocities_from_the_file() {
    let inputs = [Input::new(Role::Pedestrians, "p.csv", published_pedestrians())];
    let recording = parse(Format::Interaction, &inputs).unwrap();
    assert_eq!((recording.interval_ns, recording.frames.len()), (100_000_000, 15));
    let first = &recording.frames[0];
    assert_eq!((first.stamp_ns, first.detections.len()), (300_000_000, 3));
    let motion = |index: usize| {
        let detection: wire::Detection = first.detections[index];
        let has = |flag| detection.has(flag).then_some(());
        (
            has(detection_flags::HAS_SPEED).map(|()| detection.speed_mps),
            has(detection_flags::HAS_HEADING).map(|()| detection.heading_rad),
        )
    };
    assert_eq!(motion(0), (Some(1.5), Some(std::f32::consts::FRAC_PI_2)));
    assert_eq!(motion(1), (Some(5.0), Some(4.0_f32.atan2(3.0))));
    assert_eq!(motion(2), (Some(0.03), None));
    // Velocities are known from the first row on, and classify the cyclist after 1.2 s.
    let types = |index: usize| {
        recording.frames.iter().map(move |frame| {
            let id = 1_000_000_001 + index as u64;
            frame.detections.iter().find(|detection| detection.id == id).map(|detection| detection.agent_type)
        })
    };
    assert!(types(0).chain(types(2)).all(|kind| kind == Some(AgentType::Pedestrian as u32)));
    let rides: Vec<bool> = types(1).map(|kind| kind == Some(AgentType::Cyclist as u32)).collect();
    assert_eq!(rides, [[false; 12].as_slice(), &[true; 3]].concat());
}

#[test]
fn published_interaction_observes_pedestrians_in_every_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("vehicle_tracks_000.csv");
    std::fs::write(&path, vehicles(1..=20)).unwrap();
    // The published file of a recording has priority over a thinned one.
    let thinned =
        "track_id,frame_id,timestamp_ms,agent_type,x,y\nP1,4,400,pedestrian/bicycle,0,5\n".to_owned();
    std::fs::write(folder.path().join("pedestrian_tracks_000_2.5hz.csv"), &thinned).unwrap();
    let observed = |path: &std::path::Path| {
        let recording = data::open(path, None).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((recording.interval_ns, recording.frames.len()), (100_000_000, 20));
        recording.frames.iter().map(|frame| frame.observed_types.count_ones()).collect::<Vec<_>>()
    };
    assert_eq!(observed(&path), [1, 1, 1, 3].repeat(5));
    std::fs::write(folder.path().join("pedestrian_tracks_000.csv"), published_pedestrians()).unwrap();
    assert_eq!(observed(&path), [3; 20]);
}

#[test]
fn a_cyclist_counts_as_pedestrian_until_classified() {
    let riders = "track_id,frame_id,timestamp_ms,agent_type,x,y\n".to_owned()
        + &(0..6).map(|k| format!("P1,{k},{}00,pedestrian/bicycle,{},5\n", 4 * k, 2 * k)).collect::<String>();
    let inputs = [Input::new(Role::Pedestrians, "a.csv", riders)];
    let recording = parse(Format::Interaction, &inputs).unwrap();
    let track = &tracks(&recording)[0];
    let types = [0, 1, 2, 3, 5].map(|k| track.reported_at(k * STEP_NS).agent_type);
    use AgentType::{Cyclist, Pedestrian};
    assert_eq!(types, [Pedestrian, Pedestrian, Pedestrian, Cyclist, Cyclist]);
}

#[test]
fn windows_of_two_sensors_are_those_of_one() {
    // A car at 10 m/s measured at the stamps, and a pedestrian at 1.5 m/s 30 ms before or after.
    let scene = |offset_ms: i64| {
        let mut rows = String::new();
        for sweep in 1..30_i64 {
            let ms = [sweep * 100, sweep * 100 + offset_ms];
            let [car_m, walker_m] = [10.0 * ms[0] as f64 * 1e-3, 1.5 * ms[1] as f64 * 1e-3];
            rows += &format!("{}.{:03},1,vehicle,{car_m},0,,\n", ms[0] / 1000, ms[0] % 1000);
            rows += &format!("{}.{:03},2,pedestrian,{walker_m},6,,\n", ms[1] / 1000, ms[1] % 1000);
        }
        csv(&rows)
    };
    let options = WindowOptions::new(4, 3, STEP_NS);
    for offset_ms in [-30, 30, 45] {
        let recording = scene(offset_ms);
        let windows = windows(&recording, &options);
        let complete = windows.iter().filter(|window| window.agents.len() == 2);
        let complete = complete.filter(|window| window.agents.iter().all(|agent| agent.is_complete()));
        assert!(complete.clone().count() >= 1, "{offset_ms}");
        for window in complete {
            for agent in &window.agents {
                let speed_mps = if agent.id == 1 { 10.0 } else { 1.5 };
                let at_m = |stamp_ns: i64| speed_mps * stamp_ns as f32 * 1e-9;
                for (step, state) in agent.history.iter().flatten().enumerate() {
                    let expected_m = at_m(window.stamp_ns + (step as i64 - 3) * STEP_NS);
                    assert!((state.position_m[0] - expected_m).abs() < 1e-3, "{agent:?} {offset_ms}");
                }
                for (step, position_m) in agent.future.iter().flatten().enumerate() {
                    let expected_m = at_m(window.stamp_ns + (step as i64 + 1) * STEP_NS);
                    assert!((position_m[0] - expected_m).abs() < 1e-3, "{agent:?} {offset_ms}");
                }
            }
        }
    }
}
