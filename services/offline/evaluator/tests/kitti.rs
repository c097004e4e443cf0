//! Trackers on a detector's output: their choice of thresholds and the evaluated sequences.
#![expect(clippy::unwrap_used, reason = "a test that can't write its files has failed")]

use std::path::Path;

use data::Recording;
use evaluator::tracking::{Contender, Published, PublishedTrack};
use evaluator::{ForecastLines, Options, WeightsChoice};

const CALIBRATION: &str = "P2: 721.5 0 609.5 44.8 0 721.5 172.8 0.2 0 0 1 0.003\nR_rect 1 0 0 0 1 0 0 0 1\n\
    Tr_velo_cam 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27\nTr_imu_velo 1 0 0 -0.81 0 1 0 0.32 0 0 1 -0.8\n";
const EGO_MOTION: &str = "49.0 8.4 112.8 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0.1 0.1 4 10 4 4 0\n";
const LABELS: &str = "0 0 Car 0 0 0 500 100 600 200 1.5 1.8 4.2 0 1.65 20 0\n";

/// A sequence of one frame: the car with a high score and a false detection.
fn write_sequence(root: &Path, name: &str, score_of_ghost: f32) {
    let detections = format!(
        "0,2,500,100,600,200,9.5,1.5,1.8,4.2,0,1.65,20,0,0\n\
         0,2,300,100,400,200,{score_of_ghost},1.5,1.8,4.2,-3,1.65,20,0,0\n"
    );
    let files = [
        ("calib", CALIBRATION),
        ("oxts", EGO_MOTION),
        ("label", LABELS),
        ("detection/Car", detections.as_str()),
    ];
    for (folder, text) in files {
        let folder = root.join("kitti_tracking").join(folder);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(format!("{name}.txt")), text).unwrap();
    }
}

/// Writes one sequence per part. Returns the options to evaluate them.
fn options(root: &Path) -> Options {
    write_sequence(root, "0000", 2.5);
    write_sequence(root, "0016", 0.5);
    let weights = WeightsChoice { folder: root.to_owned(), ..WeightsChoice::default() };
    Options { data: root.to_owned(), weights, threads: 2, ..Options::default() }
}

/// A tracker that publishes every detection as a track.
fn credulous(recording: &Recording) -> Published {
    let tracks = |frame: &data::Frame| {
        let track = |(id, detection): (u64, &wire::Detection)| PublishedTrack {
            id,
            agent_type: detection.agent_type().unwrap(),
            position_m: [detection.x_m, detection.y_m].map(f64::from),
        };
        (1..).zip(&frame.detections).map(track).collect()
    };
    recording.frames.iter().map(tracks).collect()
}

#[test]
fn scores_are_chosen_on_one_part_for_the_other() {
    let root = tempfile::tempdir().unwrap();
    let options = options(root.path());
    let contender = Contender { name: "credulous", track: Box::new(|recording| Ok(credulous(recording))) };
    let file = tempfile::NamedTempFile::new().unwrap();
    let lines = std::sync::Arc::new(ForecastLines::to(file.reopen().unwrap()));
    let options = Options { lines: Some(lines.clone()), ..options };
    let report = evaluator::tracking::kitti(&options, vec![contender], |_| ()).unwrap().json;
    lines.finish().unwrap();
    let figure = |sequences: &str, tracker: &str, measure: &str| {
        let wanted = |of: &&serde_json::Value| {
            of["sequences"] == sequences && of["tracker"] == tracker && of["class"] == "car"
        };
        let found = report["tables"][0]["rows"].as_array().unwrap().iter().find(wanted).unwrap();
        let figure = found[measure].get("misses").unwrap_or(&found[measure]);
        (figure.as_f64().unwrap(), found["score threshold"].as_str().unwrap().to_owned())
    };
    // Thresholds from 1 on remove the ghost of 0016, thresholds from 3 on the ghost of 0000.
    assert_eq!(figure("0000 to 0000", "credulous", "false"), (1.0, "1".to_owned()));
    assert_eq!(figure("0016 to 0016", "credulous", "false"), (0.0, "3".to_owned()));
    assert_eq!(figure("all", "credulous", "MOTA"), (0.5, "1, 3".to_owned()));
    // A single frame does not confirm a track.
    assert_eq!(figure("all", "nearest neighbours", "misses").0, 2.0);
    // The lines give the same counts: the car is matched, and each further track is false.
    let text = std::fs::read_to_string(file.path()).unwrap();
    let lines: Vec<serde_json::Value> =
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    for tracker in ["credulous", "nearest neighbours"] {
        for sequences in ["0000 to 0000", "0016 to 0016"] {
            let is_of = |line: &&serde_json::Value| {
                line["part"] == sequences && line["tracker"] == tracker && line["class"] == "car"
            };
            let len = |key: &str| -> usize {
                lines.iter().filter(is_of).map(|line| line[key].as_array().unwrap().len()).sum()
            };
            let (truths, tracks) = (len("truths"), len("tracks"));
            assert_eq!(figure(sequences, tracker, "misses").0, truths.saturating_sub(tracks) as f64);
            assert_eq!(figure(sequences, tracker, "false").0, tracks.saturating_sub(truths) as f64);
        }
    }
}

#[test]
fn a_tracker_that_fails_is_named() {
    let root = tempfile::tempdir().unwrap();
    let options = options(root.path());
    let contender = Contender { name: "lost", track: Box::new(|_| Err("no idea".into())) };
    let error = evaluator::tracking::kitti(&options, vec![contender], |_| ()).unwrap_err();
    assert_eq!(error.to_string(), "Car/0000: the tracker \"lost\": no idea");
}
