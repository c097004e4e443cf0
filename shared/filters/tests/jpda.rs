//! Joint association probabilities against reference values and their own laws.

use std::path::PathBuf;

use filters::jpda::{Association, JpdaFault, Sensor};
use proptest::prelude::*;

const SENSOR: Sensor = Sensor { detection_probability: 0.9, clutter_density: 0.05 };

#[test]
fn probabilities_agree_with_the_reference() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden/unit/jpda.json");
    let all: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let matrix = |value: &serde_json::Value| -> Vec<Vec<f64>> {
        let row =
            |row: &serde_json::Value| row.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        value.as_array().unwrap().iter().map(row).collect()
    };
    let cases = all["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 4);
    for case in cases {
        let number = |key: &str| case[key].as_f64().unwrap();
        let (distance2, expected) = (matrix(&case["d2"]), matrix(&case["beta"]));
        let sensor = Sensor { detection_probability: number("PD"), clutter_density: number("clutter") };
        let log_det = (std::f64::consts::TAU * number("S_scalar")).ln();
        let gate = number("gate");
        let found = Association::new(distance2.len(), distance2[0].len(), &sensor, |track, detection| {
            let d2 = distance2[track][detection];
            (d2 <= gate).then_some(-0.5 * d2 - log_det)
        })
        .unwrap();
        for (track, expected) in expected.iter().enumerate() {
            for (found, expected) in found.of_track(track).iter().zip(expected) {
                assert!((found - expected).abs() < 1e-9, "track {track}: {found} instead of {expected}");
            }
        }
    }
}

#[test]
fn impossible_inputs_are_refused_or_left_out() {
    let zero = |_, _| Some(0.0);
    let fault = Association::new(6, 2, &SENSOR, zero).unwrap_err();
    assert_eq!(fault, JpdaFault::TooLarge { tracks_len: 6, detections_len: 2 });
    for sensor in [
        Sensor { detection_probability: 1.0, ..SENSOR },
        Sensor { clutter_density: 0.0, ..SENSOR },
        Sensor { detection_probability: f64::NAN, ..SENSOR },
    ] {
        assert!(matches!(Association::new(2, 2, &sensor, zero), Err(JpdaFault::Sensor(_))));
    }
    let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    let found = Association::new(1, 3, &SENSOR, |_, detection| Some(odd[detection])).unwrap();
    assert_eq!(found.of_track(0), [0.0, 0.0, 0.0, 1.0]);
    // Two tracks that both lie on one detection, told with all the certainty there is.
    let found = Association::new(2, 1, &SENSOR, |_, _| Some(1e5)).unwrap();
    assert!((found.pair(0, 0) - 0.5).abs() < 1e-12 && (found.miss(1) - 0.5).abs() < 1e-12);
}

proptest! {
    /// A track's probabilities sum to 1, a detection's to no more, and the order of the tracks does not matter.
    #[test]
    fn probabilities_keep_their_laws(
        tracks in 1_usize..6, detections in 0_usize..6,
        logs in proptest::collection::vec(proptest::option::of(-300.0_f64..30.0), 25),
    ) {
        let log = |track: usize, detection: usize| logs[5 * track + detection];
        let found = Association::new(tracks, detections, &SENSOR, log).unwrap();
        for track in 0..tracks {
            let sum: f64 = found.of_track(track).iter().sum();
            prop_assert!((sum - 1.0).abs() < 1e-12);
        }
        for detection in 0..detections {
            let sum: f64 = (0..tracks).map(|track| found.pair(track, detection)).sum();
            prop_assert!(sum < 1.0 + 1e-12);
        }
        let turned =
            Association::new(tracks, detections, &SENSOR, |track, d| log(tracks - 1 - track, d)).unwrap();
        for track in 0..tracks {
            prop_assert!((found.miss(track) - turned.miss(tracks - 1 - track)).abs() < 1e-12);
        }
    }
}
