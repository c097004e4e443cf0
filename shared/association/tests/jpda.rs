//! JPDA against reference values, enumeration and the laws of probability.

use std::path::PathBuf;

use association::Candidate;
use association::assignment::Assigner;
use association::jpda::{Associator, JointAssociation, JpdaFault, SIDE_MAX, Sensor};
use proptest::prelude::*;

const SENSOR: Sensor = Sensor { detection_probability: 0.9, clutter_density: 0.05 };

#[test]
fn probabilities_equal_the_reference() {
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
        let found =
            JointAssociation::new(distance2.len(), distance2[0].len(), &sensor, |track, detection| {
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
fn invalid_inputs_are_refused_or_ignored() {
    let zero = |_, _| Some(0.0);
    let fault = JointAssociation::new(6, 2, &SENSOR, zero).unwrap_err();
    assert_eq!(fault, JpdaFault::TooLarge { track_count: 6, detection_count: 2 });
    for sensor in [
        Sensor { detection_probability: 1.0, ..SENSOR },
        Sensor { clutter_density: 0.0, ..SENSOR },
        Sensor { detection_probability: f64::NAN, ..SENSOR },
    ] {
        assert!(matches!(JointAssociation::new(2, 2, &sensor, zero), Err(JpdaFault::Sensor(_))));
    }
    let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    let found = JointAssociation::new(1, 3, &SENSOR, |_, detection| Some(odd[detection])).unwrap();
    assert_eq!(found.of_track(0), [0.0, 0.0, 0.0, 1.0]);
    // Two tracks that share a detection of overwhelming likelihood.
    let found = JointAssociation::new(2, 1, &SENSOR, |_, _| Some(1e5)).unwrap();
    assert!((found.pair(0, 0) - 0.5).abs() < 1e-12 && (found.of_track(1)[1] - 0.5).abs() < 1e-12);
}

proptest! {
    /// A track's probabilities sum to 1, and a detection's to at most 1. The order of the tracks has no
    /// effect.
    #[test]
    fn probabilities_sum_to_one_in_any_order_of_tracks(
        tracks in 1_usize..6, detections in 0_usize..6,
        logs in proptest::collection::vec(proptest::option::of(-300.0_f64..30.0), 25),
    ) {
        let log = |track: usize, detection: usize| logs[5 * track + detection];
        let found = JointAssociation::new(tracks, detections, &SENSOR, log).unwrap();
        for track in 0..tracks {
            let sum: f64 = found.of_track(track).iter().sum();
            prop_assert!((sum - 1.0).abs() < 1e-12);
        }
        for detection in 0..detections {
            let sum: f64 = (0..tracks).map(|track| found.pair(track, detection)).sum();
            prop_assert!(sum < 1.0 + 1e-12);
        }
        let turned =
            JointAssociation::new(tracks, detections, &SENSOR, |track, d| log(tracks - 1 - track, d)).unwrap();
        for track in 0..tracks {
            prop_assert!((found.of_track(track)[detections] - turned.of_track(tracks - 1 - track)[detections]).abs() < 1e-12);
        }
    }
}

/// A frame's probabilities, `[track][detection]`, with the miss last.
fn associated(mut candidates: Vec<Candidate>, track_count: usize, detection_count: usize) -> Vec<Vec<f64>> {
    let mut associator = Associator::default();
    associator.associate(&mut candidates, track_count, detection_count, miss_cost());
    let of_track = |track| {
        let mut row = vec![0.0; detection_count + 1];
        for share in associator.of_track(track) {
            row[share.detection as usize] = share.probability;
        }
        row[detection_count] = 1.0 - row.iter().sum::<f64>();
        row
    };
    (0..track_count).map(of_track).collect()
}

/// Cost of a miss of [`SENSOR`] if a pair costs −2 ln N.
fn miss_cost() -> f64 {
    -2.0 * ((1.0 - SENSOR.detection_probability) * SENSOR.clutter_density / SENSOR.detection_probability).ln()
}

proptest! {
    #[test]
    fn components_have_the_probabilities_of_the_whole_frame(
        tracks in 1_usize..6, detections in 1_usize..6,
        logs in proptest::collection::vec(proptest::option::of(-30.0_f64..5.0), 25),
    ) {
        let mut candidates = Vec::new();
        for track in 0..tracks {
            for detection in 0..detections {
                if let Some(log) = logs[5 * track + detection] {
                    candidates.push(candidate(track, detection, -2.0 * log));
                }
            }
        }
        let whole = JointAssociation::new(tracks, detections, &SENSOR, |track, d| logs[5 * track + d]).unwrap();
        for (track, row) in associated(candidates, tracks, detections).iter().enumerate() {
            for (found, expected) in row.iter().zip(whole.of_track(track)) {
                prop_assert!((found - expected).abs() < 1e-9, "{} instead of {}", found, expected);
            }
        }
    }
}

fn candidate(track: usize, detection: usize, cost: f64) -> Candidate {
    Candidate { track: track as u32, detection: detection as u32, cost }
}

/// Adds every event that continues from `track` to β. Returns the sum of their weights.
fn accumulate(
    costs: &[Vec<Option<f64>>],
    track: usize,
    taken: u32,
    before: f64,
    beta: &mut [Vec<f64>],
) -> f64 {
    let Some(row) = costs.get(track) else { return 1.0 };
    let mut sum = 0.0;
    for option in 0..=row.len() {
        let bit = 1 << option;
        let cost = if option == row.len() { Some(miss_cost()) } else { row[option] };
        let Some(cost) = cost.filter(|_| option == row.len() || taken & bit == 0) else { continue };
        let weight = (-0.5 * cost).exp();
        let from_here = weight * accumulate(costs, track + 1, taken | bit, before * weight, beta);
        beta[track][option] += before * from_here;
        sum += from_here;
    }
    sum
}

/// A queue of nine agents in which neighbours are within each other's gate. It forms one component, which is
/// too large to enumerate.
#[test]
fn cutting_a_large_component_errs_by_less_than_a_tenth() {
    // Innovations with a standard deviation of 0.5 m. Each detection is near its track.
    let off_m = [0.3, -0.2, 0.4, 0.1, -0.5, 0.2, 0.0, -0.3, 0.4];
    let (spacing_m, sigma_m) = (0.8, 0.5_f64);
    let log_det = 2.0 * std::f64::consts::TAU.ln() + 4.0 * sigma_m.ln();
    let cost = |track: usize, d: usize| {
        let distance = (spacing_m * (d as f64 - track as f64) + off_m[d]) / sigma_m;
        (distance.powi(2) < 9.21).then_some(distance.powi(2) + log_det)
    };
    let costs: Vec<Vec<Option<f64>>> = (0..9).map(|t| (0..9).map(|d| cost(t, d)).collect()).collect();
    let mut exact = vec![vec![0.0; 10]; 9];
    let sum = accumulate(&costs, 0, 0, 1.0, &mut exact);
    let pairs = (0..81).filter_map(|i| Some(candidate(i / 9, i % 9, costs[i / 9][i % 9]?)));
    let mut candidates: Vec<Candidate> = pairs.collect();
    let found = associated(candidates.clone(), 9, 9);
    let mut worst = 0.0_f64;
    for (row, exact) in found.iter().zip(&exact) {
        for (found, exact) in row.iter().zip(exact) {
            worst = worst.max((found - exact / sum).abs());
        }
    }
    println!("a queue of nine: off by {worst:.4} at most");
    assert!(worst < 0.1, "{worst}");

    // The pairs of the assignment remain, and the order of the candidates has no effect.
    let mut paired = [None; 9];
    Assigner::default().solve(&mut candidates.clone(), 9, miss_cost(), &mut paired);
    for (row, detection) in found.iter().zip(paired) {
        assert!(row[detection.unwrap() as usize] > 0.5, "{row:?}");
    }
    candidates.reverse();
    assert_eq!(associated(candidates, 9, 9), found);
}

/// Three hundred tracks and detections with every pair possible, and one distant pair.
#[test]
fn components_are_cut_to_the_bound() {
    let dense = |i: usize| candidate(i / 300, i % 300, ((i * 7919) % 1000) as f64 * 0.02);
    let mut candidates: Vec<Candidate> = (0..90_000).map(dense).collect();
    candidates.push(candidate(300, 300, 1.0));
    candidates.push(candidate(300, 0, f64::NAN));
    let found = associated(candidates, 301, 301);
    for row in &found {
        let options = row[..301].iter().filter(|&&probability| probability > 0.0).count();
        assert!((1..=SIDE_MAX).contains(&options) && row[301] > -1e-12, "{options}");
    }
    for detection in 0..301 {
        let sum: f64 = found.iter().map(|row| row[detection]).sum();
        assert!(sum < 1.0 + 1e-12, "{sum}");
    }
    let alone = JointAssociation::new(1, 1, &SENSOR, |_, _| Some(-0.5)).unwrap();
    assert!((found[300][300] - alone.pair(0, 0)).abs() < 1e-9);
}
