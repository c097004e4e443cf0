//! Frame rates that files do not contain, and signs of a wrong one.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use std::path::Path;

use data::sets::{DataSet, Part};
use data::{Format, FrameRate, Input, OpenOptions, Recording, Role, findings, open_with, parse, parse_at};
use testing::{public_recording, recordings_folder};

/// Ten pedestrians in VCI's layout who walk at 1.4 m/s for ten seconds, filmed at 29.97 frames a second.
fn citr() -> Vec<Input> {
    let mut text = "id,frame,label,x_est,y_est,vx_est,vy_est\n".to_owned();
    for id in 0..10 {
        for frame in 0..300 {
            let x_m = 1.4 * f64::from(frame) / 29.97;
            text += &format!("{id},{frame},ped,{x_m:.4},{id}.0,1.4,0.0\n");
        }
    }
    vec![Input::new(Role::Pedestrians, "citr.csv", text)]
}

fn doubts(recording: &Recording) -> Vec<audit::Found> {
    findings(recording).into_iter().filter(|found| found.doubtful).collect()
}

fn rate(text: &str) -> FrameRate {
    text.parse().unwrap()
}

/// A walk or ride in the project's own format, 10 Hz for 5 s: five agents of a type without reported speeds.
fn moving(agent_type: &str, speed_mps: f64) -> Recording {
    let mut text = "stamp_s,id,type,x_m,y_m\n".to_owned();
    for step in 0..50 {
        for id in 0..5 {
            let x_m = 0.25 + speed_mps * f64::from(step) / 10.0;
            text += &format!("{}.{},{id},{agent_type},{x_m},{id}\n", step / 10, step % 10);
        }
    }
    let input = Input::new(Role::Rows, "own.csv", text);
    parse(Format::Csv, &[input]).unwrap()
}

#[test]
fn a_given_frame_rate_sets_stamps_and_interval() {
    let usual = parse(Format::VciDut, &citr()).unwrap();
    assert_eq!((usual.interval_ns, usual.frame_rate), (41_701_417, Some(rate("23.98"))));
    let given = parse_at(Format::VciDut, &citr(), Some(rate("29.97"))).unwrap();
    assert_eq!((given.interval_ns, given.frame_rate), (33_366_700, Some(rate("29.97"))));
    assert_eq!(given.frames[299].stamp_ns, 9_976_643_310);
    assert_eq!(given.sha256, usual.sha256, "the files are the same");
    assert_eq!(parse_at(Format::VciDut, &citr(), Some(rate("23.98"))).unwrap(), usual);
}

#[test]
fn every_format_with_frame_numbers_takes_a_frame_rate() {
    let two_frames = |format: Format| match format {
        Format::EthUcy => "0\t1\t0\t0\n10\t1\t1\t0\n",
        Format::Obsmat => "0 1 0 0 0 0 0 0\n6 1 1 0 0 0 0 0\n",
        _ => "0 1 0 0\n12 1 1 0\n",
    };
    for format in [Format::EthUcy, Format::Obsmat, Format::SddTrajnet] {
        let input = [Input::new(Role::Rows, "a", two_frames(format))];
        let usual = parse(format, &input).unwrap();
        assert_eq!((usual.frames[1].stamp_ns, usual.interval_ns), (400_000_000, 400_000_000), "{format}");
        let half = FrameRate::new(format.frame_rate().unwrap().hertz() / 2.0).unwrap();
        let slow = parse_at(format, &input, Some(half)).unwrap();
        assert_eq!((slow.frames[1].stamp_ns, slow.interval_ns), (800_000_000, 800_000_000), "{format}");
    }
}

#[test]
fn a_frame_rate_is_refused_where_files_have_their_times() {
    let input = Input::new(Role::Rows, "own.csv", "stamp_s,id,type,x_m,y_m\n0,1,vehicle,0,0\n");
    let error = parse_at(Format::Csv, &[input], Some(rate("25"))).unwrap_err().to_string();
    assert_eq!(
        error,
        "own.csv: csv has a time for every frame, and takes no frame rate: that is for eth-ucy, obsmat, \
         sdd-trajnet, sdd-raw, vci-dut"
    );
    let late = Input::new(Role::Rows, "a", "9000000000 1 0 0\n");
    let error = parse_at(Format::EthUcy, &[late], Some(rate("1"))).unwrap_err().to_string();
    assert_eq!(error, "a:1:1: frame = \"9000000000\": beyond 4000000000 s at 1 Hz");
}

#[test]
fn positions_slower_than_reported_speeds_name_the_rate_that_fits() {
    let [doubt] = &doubts(&parse(Format::VciDut, &citr()).unwrap())[..] else { panic!("one doubt") };
    assert_eq!(
        doubt.sentence,
        "the positions of pedestrians move 0.80 times as fast as their reported speeds: at 29.97 frames a second \
         instead of 23.98 they agree (--fps)"
    );
    assert_eq!((doubt.share, doubt.first.as_deref()), (Some(1.0), Some("citr.csv:2")));
    let right = parse_at(Format::VciDut, &citr(), Some(rate("29.97"))).unwrap();
    assert_eq!(doubts(&right), []);
}

#[test]
fn unusual_speeds_are_reported_by_type() {
    for (agent_type, usual_mps) in
        [("pedestrian", 1.4), ("cyclist", 5.0), ("vehicle", 40.0), ("vehicle", 0.0)]
    {
        assert_eq!(doubts(&moving(agent_type, usual_mps)), [], "{agent_type} {usual_mps}");
    }
    for (name, speed_mps) in [("pedestrian", 4.6), ("pedestrian", 0.4), ("cyclist", 18.0), ("vehicle", 66.0)]
    {
        let found = doubts(&moving(name, speed_mps));
        let [doubt] = &found[..] else { panic!("{name} {speed_mps}: {found:?}") };
        assert_eq!(doubt.kind, "speeds_unusual");
        let words = format!("{name}s that move have a median speed of {speed_mps:.1} m/s");
        assert!(doubt.sentence.starts_with(&words), "{doubt}");
    }
    assert_eq!(
        doubts(&moving("pedestrian", 4.6))[0].sentence,
        "pedestrians that move have a median speed of 4.6 m/s and a 95th percentile of 4.6 m/s; usual are 0.5 to \
         2 m/s and up to 6 m/s: are positions in metres, times in seconds, and is the type right?"
    );
}

#[test]
fn published_recordings_raise_doubt_where_they_are_fast() {
    if public_recording("vci_dut").is_none() {
        return;
    }
    let root = recordings_folder();
    let sets = [
        DataSet::EthUcy,
        DataSet::SddTrajnet,
        DataSet::SddRaw,
        DataSet::Interaction,
        DataSet::VciDut,
        DataSet::KittiLabels,
    ];
    let mut doubted = Vec::new();
    for set in sets {
        for part in [Part::Train, Part::Validation, Part::Test] {
            for file in set.files(&root, part).unwrap() {
                let recording = data::open(&file, Some(set.format())).unwrap();
                let speeds = doubts(&recording).into_iter().filter(|doubt| doubt.kind == "speeds_unusual");
                doubted.extend(speeds.map(|_| recording.name.clone()));
            }
        }
    }
    // ETH is published 1.67 times too fast, and the TrajNet split marks the quad's cyclists as pedestrians.
    let expected = ["train/biwi_eth_train", "val/biwi_eth_val", "test/quad_2", "test/quad_3"];
    assert_eq!(doubted, expected);
}

/// VCI-DUT as if it were CITR.
#[test]
fn a_wrong_frame_rate_of_the_campus_is_noticed() {
    let Some(folder) = public_recording("vci_dut") else { return };
    let path: &Path = &folder.join("intersection_01_traj_veh_filtered.csv");
    let fast = OpenOptions { fps: Some(rate("29.97")), ..OpenOptions::default() };
    let found = doubts(&open_with(path, fast).unwrap());
    assert!(
        found.iter().any(|doubt| doubt.kind == "speeds_differ" && doubt.sentence.contains(" 1.2")),
        "{found:?}"
    );
}
