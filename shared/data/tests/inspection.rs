//! Findings of an inspection in typical recordings, with rows, share and line, and none in clean recordings.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

use audit::Found;
use data::{Format, Input, Role, inspect, parse};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};
use testing::public_recording;

/// An agent at one time, before it is written in some unit.
#[derive(Clone, Copy)]
struct Row {
    stamp_s: f64,
    id: usize,
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
    speed_mps: f64,
    length_m: f64,
}

/// Six cars that drive in all directions on circles of 60 m, at 6 to 11 m/s, for 20 s.
fn drive(rate_hz: f64) -> Vec<Row> {
    let steps = (20.0 * rate_hz) as usize;
    let row = |step: usize, id: usize| {
        let (stamp_s, speed_mps) = (step as f64 / rate_hz, 6.0 + id as f64);
        let angle = id as f64 * TAU / 6.0 + speed_mps / 60.0 * stamp_s;
        let (sin, cos) = angle.sin_cos();
        let heading_rad = (angle + PI / 2.0 + PI).rem_euclid(TAU) - PI;
        Row {
            stamp_s,
            id,
            x_m: 150.0 + 60.0 * cos,
            y_m: 90.0 + 60.0 * sin,
            heading_rad,
            speed_mps,
            length_m: 4.5,
        }
    };
    (0..steps).flat_map(|step| (0..6).map(move |id| row(step, id))).collect()
}

/// The findings in these rows, written as a CSV.
fn found(rows: impl IntoIterator<Item = Row>) -> Vec<Found> {
    let mut text = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m\n".to_owned();
    for Row { stamp_s, id, x_m, y_m, heading_rad, speed_mps, length_m } in rows {
        writeln!(
            text,
            "{stamp_s:.6},{id},vehicle,{x_m:.3},{y_m:.3},{heading_rad:.4},{speed_mps:.3},{length_m:.2},{:.2}",
            0.4 * length_m
        )
        .unwrap();
    }
    let input = Input::new(Role::Rows, "mine.csv", text);
    inspect(&parse(Format::Csv, &[input]).unwrap()).findings
}

/// The findings in a CSV.
fn findings(text: &str) -> Vec<Found> {
    inspect(&parse(Format::Csv, &[Input::new(Role::Rows, "mine.csv", text)]).unwrap()).findings
}

/// The only finding, which must be a doubt of this kind.
fn only(kind: &str, rows: impl IntoIterator<Item = Row>) -> Found {
    let found = found(rows);
    let [doubt] = &found[..] else { panic!("{kind}: {found:#?}") };
    assert_eq!((doubt.kind.as_str(), doubt.doubtful), (kind, true), "{doubt}");
    doubt.clone()
}

fn degrees(row: Row) -> Row {
    Row { heading_rad: row.heading_rad.to_degrees(), ..row }
}

#[test]
fn clean_recordings_of_any_rate_are_not_doubted() {
    for rate_hz in [2.0, 5.0, 10.0, 12.5, 25.0, 30.0] {
        assert_eq!(found(drive(rate_hz)), [], "{rate_hz} Hz");
    }
    // Full turns are counted in the headings, which is unusual but right.
    let counted = drive(10.0).into_iter().map(|row| Row { heading_rad: row.heading_rad + TAU, ..row });
    assert_eq!(found(counted), []);
}

#[test]
fn headings_in_degrees_are_named_with_the_first_line() {
    for rate_hz in [2.0, 10.0, 30.0] {
        let doubt = only("headings_in_degrees", drive(rate_hz).into_iter().map(degrees));
        assert_eq!(doubt.sentence, "headings look like degrees: divide them by 57.29578");
        assert_eq!(doubt.first.as_deref(), Some("mine.csv:2"), "{rate_hz} Hz");
        assert!(doubt.share > Some(0.95), "{doubt}");
    }
    let turn = |row: Row| Row { heading_rad: row.heading_rad.to_degrees().rem_euclid(360.0), ..row };
    only("headings_in_degrees", drive(10.0).into_iter().map(turn));
    let compass =
        |row: Row| Row { heading_rad: (90.0 - row.heading_rad.to_degrees()).rem_euclid(360.0), ..row };
    let doubt = only("headings_in_degrees", drive(10.0).into_iter().map(compass));
    assert_eq!(
        doubt.sentence,
        "headings look like degrees clockwise from north (+y): divide them by 57.29578, then write π/2 − heading"
    );
    let some = |row: Row| if row.id == 4 { degrees(row) } else { row };
    let doubt = only("headings_in_degrees", drive(10.0).into_iter().map(some));
    assert_eq!(doubt.first.as_deref(), Some("mine.csv:6"));
    assert!((0.15..0.17).contains(&doubt.share.unwrap()), "{doubt}");
}

#[test]
fn headings_of_other_conventions_are_named() {
    type Written = fn(f64) -> f64;
    let cases: [(&str, Written); 5] = [
        ("headings_from_north", |heading| PI / 2.0 - heading),
        ("headings_mirrored", |heading| -heading),
        ("headings_turned", |heading| heading + PI),
        ("headings_turned", |heading| heading - PI / 2.0),
        ("headings_unrelated", |heading| 40.0 * heading),
    ];
    for (kind, written) in cases {
        let rows =
            drive(10.0).into_iter().map(|row| Row { heading_rad: written(row.heading_rad) % TAU, ..row });
        only(kind, rows);
    }
    let swapped = drive(10.0).into_iter().map(|row| Row { x_m: row.y_m, y_m: row.x_m, ..row });
    only("headings_from_north", swapped);
    let flipped = drive(10.0).into_iter().map(|row| Row { y_m: -row.y_m, ..row });
    only("headings_mirrored", flipped);
    let flipped = drive(10.0).into_iter().map(|row| Row { x_m: 300.0 - row.x_m, ..row });
    assert!(
        only("headings_mirrored", flipped).sentence.ends_with("x is flipped: write π − heading, or negate x")
    );
}

#[test]
fn speeds_in_other_units_are_named() {
    for (kind, factor) in [("speeds_in_kmh", 3.6), ("speeds_in_mph", 2.236_94), ("speeds_differ", 1.6)] {
        let faster = |row: Row| Row { speed_mps: row.speed_mps * factor, ..row };
        let doubt = only(kind, drive(10.0).into_iter().map(faster));
        assert_eq!((doubt.share, doubt.first.as_deref()), (Some(1.0), Some("mine.csv:2")), "{doubt}");
        let some = |row: Row| if row.id == 3 { faster(row) } else { row };
        if factor > 2.0 {
            assert!((0.1..0.2).contains(&only(kind, drive(10.0).into_iter().map(some)).share.unwrap()));
        }
    }
}

#[test]
fn lengths_and_widths_that_are_swapped_are_named() {
    let text = |wide: bool| {
        let size = if wide { "1.9,4.5" } else { "4.5,1.9" };
        let row = |row: Row| {
            let Row { stamp_s, id, x_m, y_m, heading_rad, speed_mps, .. } = row;
            format!("{stamp_s:.1},{id},vehicle,{x_m:.3},{y_m:.3},{heading_rad:.4},{speed_mps:.3},{size}\n")
        };
        let rows: String = drive(10.0).into_iter().map(row).collect();
        format!("stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m\n{rows}")
    };
    assert!(findings(&text(false)).is_empty());
    let found = findings(&text(true));
    let [doubt] = &found[..] else { panic!("{found:?}") };
    assert_eq!((doubt.kind.as_str(), doubt.share), ("sizes_swapped", Some(1.0)));
    assert_eq!(doubt.sentence, "vehicles are wider than they are long: swap length and width");
}

#[test]
fn feet_and_pixels_are_named() {
    let feet = |row: Row| Row { x_m: row.x_m * 3.280_84, y_m: row.y_m * 3.280_84, ..row };
    let doubt = only("feet", drive(10.0).into_iter().map(feet));
    assert_eq!(doubt.sentence, "positions of vehicles look like feet: multiply them by 0.3048");
    let sized = |row: Row| Row { length_m: row.length_m * 3.280_84, ..row };
    let doubt = only("feet", drive(10.0).into_iter().map(sized));
    assert_eq!(doubt.sentence, "vehicles are 14.8 long at the median, as in feet: multiply them by 0.3048");
    // A bus has this length in metres.
    let bus = |t: f64| format!("{t:.1},1,vehicle,{:.2},0,0,6,12,2.5\n", 6.0 * t);
    let buses: String = (0..200).map(|step| bus(f64::from(step) * 0.1)).collect();
    let header = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps,length_m,width_m\n";
    assert_eq!(findings(&format!("{header}{buses}")), []);
    let pixels = |row: Row| Row { x_m: row.x_m.round(), y_m: row.y_m.round(), ..row };
    let found = found(drive(10.0).into_iter().map(pixels));
    assert!(found.iter().any(|found| found.kind == "pixels" && found.share == Some(1.0)), "{found:#?}");
}

#[test]
fn positions_in_centimetres_and_rounded_stamps_are_named() {
    let scaled = drive(10.0).into_iter().map(|row| Row { x_m: 100.0 * row.x_m, y_m: 100.0 * row.y_m, ..row });
    let sentence =
        "many positions are out of their agent's reach: are positions in metres, and stamps in seconds?";
    assert!(found(scaled).iter().any(|found| found.sentence == sentence));
    let mut rounded = "stamp_s,id,type,x_m,y_m\n".to_owned();
    for Row { stamp_s, x_m, y_m, .. } in drive(10.0) {
        writeln!(rounded, "{:.0},,vehicle,{x_m:.3},{y_m:.3}", stamp_s.floor()).unwrap();
    }
    let found = findings(&rounded);
    assert!(found.iter().any(|found| found.sentence.contains("all stamps are whole seconds")), "{found:?}");
}

#[test]
fn stamps_in_other_units_are_named() {
    for (words, per_s) in [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)] {
        for rate_hz in [2.0, 10.0, 25.0] {
            // Stamps are limited to four billion.
            let rows = drive(rate_hz).into_iter().filter(|row| row.stamp_s * per_s < 3.9e9);
            let rows = rows.map(|row| Row { stamp_s: (row.stamp_s * per_s).round(), ..row });
            let doubt = only("stamps_in_other_unit", rows);
            assert!(doubt.sentence.contains(&format!("look like {words}")), "{rate_hz} Hz: {doubt}");
            assert_eq!(doubt.share, Some(1.0));
        }
    }
    let numbered = drive(10.0).into_iter().map(|row| Row { stamp_s: (row.stamp_s * 10.0).round(), ..row });
    let found = found(numbered);
    assert!(found.iter().any(|found| found.kind == "stamps_are_frames" && found.doubtful), "{found:#?}");
}

#[test]
fn repeated_rows_count_as_repeated_while_the_agent_moves() {
    // A detector of 5 Hz that is sent at 10 Hz. The first repeated row has no motion before it.
    let clean = drive(10.0);
    let held = |row: &Row| {
        let index = (row.stamp_s * 10.0).round() as usize / 2 * 2 * 6 + row.id;
        Row { stamp_s: row.stamp_s, ..clean[index] }
    };
    let doubt = only("repeated", clean.iter().map(held));
    assert!(doubt.share > Some(0.48), "{doubt}");
    let some = clean.iter().map(|row| if row.id == 2 { held(row) } else { *row });
    let doubt = only("repeated", some);
    assert_eq!((doubt.rows, doubt.first.as_deref()), (Some(98), Some("mine.csv:22")));
    // Parked.
    let parked = clean.iter().map(|row| Row { stamp_s: row.stamp_s, ..clean[row.id] });
    assert_eq!(found(parked), []);
}

#[test]
fn a_detector_that_hangs_to_the_end_repeats_its_last_frame() {
    let clean = drive(10.0);
    let hung = clean.iter().enumerate().map(|(nth, row)| match nth / 6 {
        0..=100 => *row,
        _ => Row { stamp_s: row.stamp_s, ..clean[600 + nth % 6] },
    });
    assert_eq!(only("repeated", hung).first.as_deref(), Some("mine.csv:608"));
    // Cars that brake stand still too.
    let braking = clean.iter().map(|row| {
        let to_s = row.stamp_s.min(10.0);
        let along_s = to_s - to_s * to_s / 20.0;
        let angle = row.id as f64 * TAU / 6.0 + row.speed_mps / 60.0 * along_s;
        Row {
            x_m: 150.0 + 60.0 * angle.cos(),
            y_m: 90.0 + 60.0 * angle.sin(),
            heading_rad: (angle + PI / 2.0 + PI).rem_euclid(TAU) - PI,
            speed_mps: row.speed_mps * (1.0 - to_s / 10.0),
            ..*row
        }
    });
    assert_eq!(found(braking), []);
}

#[test]
fn slow_agents_on_a_coarse_grid_repeat_nothing() {
    // Steps of 7 to 15 cm on grids of pixels.
    let slow = drive(30.0).into_iter().map(|row| Row {
        x_m: row.x_m / 2.5,
        y_m: row.y_m / 2.5,
        speed_mps: row.speed_mps / 2.5,
        ..row
    });
    for grid_m in [0.12, 0.25] {
        let on_grid = |x_m: f64| (x_m / grid_m).round() * grid_m;
        let rows: Vec<Row> =
            slow.clone().map(|row| Row { x_m: on_grid(row.x_m), y_m: on_grid(row.y_m), ..row }).collect();
        let held =
            rows.iter().zip(&rows[6..]).filter(|(row, next)| (row.x_m, row.y_m) == (next.x_m, next.y_m));
        assert!(held.count() > rows.len() / 20, "{grid_m} m");
        assert_eq!(found(rows), [], "{grid_m} m");
    }
}

#[test]
fn outliers_placeholders_and_jumps_are_told_apart() {
    let clean = drive(10.0);
    let with = |id: usize, every: usize, position_m: fn(&Row) -> [f64; 2]| {
        clean.iter().map(move |row| {
            let step = (row.stamp_s * 10.0).round() as usize;
            match row.id == id && step > 0 && step.is_multiple_of(every) {
                true => {
                    let [x_m, y_m] = position_m(row);
                    Row { x_m, y_m, ..*row }
                }
                false => *row,
            }
        })
    };
    let doubt = only("outliers", with(3, 10, |row| [row.x_m + 40.0, row.y_m]));
    assert_eq!((doubt.rows, doubt.first.as_deref()), (Some(19), Some("mine.csv:65")));
    let doubt = only("placeholders", with(3, 10, |_| [0.0, 0.0]));
    assert_eq!((doubt.rows, doubt.first.as_deref()), (Some(19), Some("mine.csv:65")));
    only("placeholders", with(3, 10, |_| [-1.0, -1.0]));
    let swapped = clean.iter().map(|row| match row.id {
        id @ 0..2 if row.stamp_s > 9.95 => Row { id: 1 - id, ..*row },
        _ => *row,
    });
    let found = found(swapped);
    let [note] = &found[..] else { panic!("{found:#?}") };
    assert_eq!((note.kind.as_str(), note.rows, note.doubtful), ("identities_jump", Some(2), false));
}

#[test]
fn nan_in_a_column_means_unknown_and_is_counted() {
    let text =
        "stamp_s,type,x_m,y_m,speed_mps,length_m,width_m\n0,vehicle,1,2,NaN,nan,nan\n1,vehicle,3,2,4,,\n";
    let recording = parse(Format::Csv, &[Input::new(Role::Rows, "mine.csv", text)]).unwrap();
    assert_eq!(recording.frames[0].detections[0].flags, 0);
    assert_eq!(recording.left_out[0].row_count, 3);
    let text =
        "stamp_s,type,x_m,y_m,length_m,width_m,sigma_m\n0,vehicle,1,2,-1,-1,-1\n1,vehicle,3,2,4,2,0.1\n";
    let recording = parse(Format::Csv, &[Input::new(Role::Rows, "mine.csv", text)]).unwrap();
    let first = recording.frames[0].detections[0];
    assert_eq!((first.flags, first.sigma_m, recording.left_out[0].row_count), (0, 0.0, 3));
}

#[test]
fn sensors_are_read_and_written() {
    let text = "stamp_s,type,x_m,y_m,sensor\n0,vehicle,1,2,8\n0,vehicle,9,2,\n0,vehicle,20,2,1.0\n";
    let read = |text: &[u8]| parse(Format::Csv, &[Input::new(Role::Rows, "mine.csv", text)]);
    let recording = read(text.as_bytes()).unwrap();
    let sensors = |recording: &data::Recording| {
        recording.frames[0].detections.iter().map(|detection| detection.sensor).collect::<Vec<_>>()
    };
    assert_eq!(sensors(&recording), [8, 0, 1]);
    let mut written = Vec::new();
    data::write_frames(&mut written, &recording.frames).unwrap();
    assert_eq!(sensors(&read(&written).unwrap()), [8, 0, 1]);
    for wrong in ["9", "-1", "lidar"] {
        let error = read(text.replace(",8", &format!(",{wrong}")).as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with(&format!("mine.csv:2:15: sensor = {wrong:?}: ")), "{error}");
    }
}

/// Two cars along +x and one along -y, for 10 s, with these headings and speeds as text.
fn crossing(has_id: bool, heading_rad: &str, speed_mps: &str) -> data::Recording {
    let mut text = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n".to_owned();
    for step in 0..100 {
        let t = f64::from(step) * 0.1;
        for (id, [x_m, y_m]) in [[9.0 * t, 0.0], [7.0 * t, 7.0], [90.0, 90.0 - 6.0 * t]].iter().enumerate() {
            let id = if has_id { id.to_string() } else { String::new() };
            writeln!(text, "{t:.1},{id},vehicle,{x_m:.3},{y_m:.3},{heading_rad},{speed_mps}").unwrap();
        }
    }
    parse(Format::Csv, &[Input::new(Role::Rows, "mine.csv", text)]).unwrap()
}

#[test]
fn numbers_that_the_motion_contradicts_are_unknown_and_a_doubt() {
    for has_id in [true, false] {
        for (heading, speed, kind, words) in [
            ("", "0", "speeds_differ", "speeds are 0 while"),
            ("", "-1", "speeds_differ", "speeds are -1 while"),
            ("", "99.9", "speeds_differ", "speeds are 99.9"),
            ("0.0", "", "headings_unrelated", "headings are 0 while"),
            ("1.57", "", "headings_unrelated", "headings are 1.57"),
            ("-9", "", "headings_unrelated", "headings are -9 while"),
        ] {
            let recording = crossing(has_id, heading, speed);
            let flags = recording.frames.iter().flat_map(|frame| &frame.detections).map(|d| d.flags);
            assert!(flags.clone().all(|flags| flags == u32::from(has_id)), "{heading},{speed}");
            let found = inspect(&recording).findings;
            let found = found.iter().find(|found| found.doubtful && found.kind == kind).unwrap();
            assert!(found.sentence.contains(words), "{}", found.sentence);
            assert_eq!(data::findings(&recording), inspect(&recording).findings);
        }
    }
}

#[test]
fn a_car_that_reverses_most_of_the_time_has_right_headings() {
    let mut text = "stamp_s,id,type,x_m,y_m,heading_rad\n".to_owned();
    for step in 0..200 {
        let t = f64::from(step) * 0.1;
        let x_m = if t < 5.0 { 3.0 * t } else { 24.0 - 1.8 * t };
        let heading_rad = 1e-3 * f64::from(step % 3);
        writeln!(text, "{t:.1},1,vehicle,{x_m:.3},0,{heading_rad}").unwrap();
    }
    assert_eq!(findings(&text), []);
    // Along y, reversing looks like mirrored headings. With a negative speed, it is no contradiction.
    let [mut along_y, mut signed] =
        ["stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n".to_owned(), String::new()];
    signed.clone_from(&along_y);
    for step in 0..200 {
        let t = f64::from(step) * 0.1;
        let y_m = if t < 5.0 { 3.0 * t } else { 24.0 - 1.8 * t };
        writeln!(along_y, "{t:.1},1,vehicle,0,{y_m:.3},1.5708,\n{t:.1},2,vehicle,{:.3},-20,0,", 8.0 * t)
            .unwrap();
        writeln!(signed, "{t:.1},1,vehicle,{:.3},0,0,-2", -2.0 * t).unwrap();
    }
    assert_eq!(findings(&along_y), []);
    assert_eq!(findings(&signed), []);
}

/// Cars along x with the headings and speeds that `written` makes of the step.
fn along_x(agent_type: &str, speed_mps: f64, written: impl Fn(u32) -> String) -> Vec<Found> {
    let mut text = "stamp_s,id,type,x_m,y_m,heading_rad,speed_mps\n".to_owned();
    for step in 0..200 {
        let t = f64::from(step) * 0.1;
        for id in 0..3 {
            let x_m = (speed_mps + f64::from(id)) * t;
            writeln!(text, "{t:.1},{id},{agent_type},{x_m:.3},{},{}", 7 * id, written(step)).unwrap();
        }
    }
    findings(&text)
}

#[test]
fn zeros_with_noise_flipped_headings_and_wrong_types_are_named() {
    let near_zero = along_x("vehicle", 9.0, |step| format!("0,{:.3}", 0.04 * f64::from(step).sin()));
    assert!(near_zero[0].sentence.starts_with("speeds are 0 while agents move"), "{near_zero:?}");
    let flipped = along_x("vehicle", 9.0, |step| format!("{},", [0.0, 0.0, PI][step as usize * 7 % 3]));
    assert!(flipped.iter().all(|found| found.kind == "headings_unrelated"), "{flipped:?}");
    let wrong_type = along_x("pedestrian", 15.0, |_| ",".to_owned());
    assert!(wrong_type[0].sentence.contains("faster than pedestrians can"), "{wrong_type:?}");
    assert!(wrong_type[0].doubtful);
}

#[test]
fn a_trajectory_may_repeat_the_initial_state() {
    let state = |tag: &str, x_m: f64, time: usize| {
        format!(
            "<{tag}><position><point><x>{x_m}</x><y>1</y></point></position><time><exact>{time}</exact></time></{tag}>"
        )
    };
    let read = |again_m: f64| {
        let text = format!(
            "<?xml version='1.0'?>\n<commonRoad timeStepSize='0.1'><dynamicObstacle id='10'><type>car</type>{}\
             <trajectory>{}{}</trajectory></dynamicObstacle></commonRoad>",
            state("initialState", 2.0, 0),
            state("state", again_m, 0),
            state("state", 3.0, 1)
        );
        parse(Format::CommonRoad, &[Input::new(Role::Rows, "a.xml", text)])
    };
    assert_eq!(read(2.0).unwrap().frames.len(), 2);
    assert!(read(2.5).is_err());
}

/// Two sensors that see the same agents on a road, without identities and with 0.2 m of noise. One clock is 3 s ahead.
#[test]
fn two_noisy_sensors_with_different_clocks_are_named() {
    const AGENTS: [(&str, f64); 5] =
        [("vehicle", 9.0), ("vehicle", 7.0), ("cyclist", 5.0), ("pedestrian", 1.4), ("pedestrian", 1.2)];
    let noise_m = Normal::new(0.0, 0.2).unwrap();
    // The second sensor's stamps are between those of the first one, or equal to them.
    for ahead_s in [3.03, 3.0] {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut rows = Vec::new();
        for t in (0..400).map(|step| f64::from(step) * 0.1) {
            for stamp_s in [t, t + ahead_s] {
                for (y_m, (agent_type, speed_mps)) in (0..).step_by(7).zip(AGENTS) {
                    let [x_m, y_m] = [speed_mps * t, f64::from(y_m)].map(|m| m + noise_m.sample(&mut random));
                    rows.push((stamp_s, format!("{stamp_s:.2},,{agent_type},{x_m:.3},{y_m:.3}\n")));
                }
            }
        }
        rows.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let rows: String = rows.into_iter().map(|(_, row)| row).collect();
        let found = findings(&format!("stamp_s,id,type,x_m,y_m\n{rows}"));
        assert!(found[0].sentence.contains("the same paths again 3.0 s later"), "{ahead_s}: {found:?}");
        assert!(found[0].doubtful && found.len() == 1, "{ahead_s}: {found:?}");
    }
}

/// People who cross a street in a crowd follow each other.
#[test]
fn no_crowd_is_seen_twice() {
    let Some(folder) = public_recording("vci_dut") else { return };
    for number in ["04", "06", "08"] {
        let path = folder.join(format!("intersection_{number}_traj_ped_filtered.csv"));
        assert_eq!(inspect(&data::open(&path, None).unwrap()).findings, [], "{number}");
    }
}
