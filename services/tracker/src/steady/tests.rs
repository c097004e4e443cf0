//! The three motions against an independent implementation in float64, `tests/reference/steady.py`.

use filters::{Bicycle, ConstantVelocity, Kind, Unknown};

use super::*;
use crate::TrackerOptions;

/// Numbers of a line of a reference: the observation, and what is published.
struct Line<'a> {
    time_ms: u64,
    observation: Observation,
    expected: &'a [f64],
}

/// Follows a reference. `line` reads the numbers of a line; `figures` are those of the published motion.
fn follow(
    csv: &str,
    kind: Kind,
    models: &Models,
    line: impl Fn(&[f64]) -> Line<'_>,
    figures: impl Fn(&Filter) -> Vec<f64>,
) {
    let unknown = Unknown { speed_mps: 2.0, slip_rad: 0.2 };
    let mut motions: Option<(Filter, Steady)> = None;
    let (mut last_ms, mut most_likely) = (0, [0; 3]);
    for text in csv.lines().skip(1) {
        let cells: Vec<f64> = text.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let Line { time_ms, observation, expected } = line(&cells);
        let (free, steady) = motions.get_or_insert_with(|| {
            let free = Filter::start(kind, &observation, &unknown);
            (free, Steady::new(&free))
        });
        if last_ms > 0 {
            let dt_ns = (time_ms - last_ms) * 1_000_000;
            steady.predict(free, dt_ns, &models.steady()).expect("a prediction");
            free.predict(dt_ns, models).expect("a prediction");
            steady.update_at(0.0, free, &[(1.0, observation)], &models.steady()).expect("an update");
            free.update(&observation, models).expect("an update");
        }
        last_ms = time_ms;
        steady.updates = UPDATES_MIN;
        let found = figures(&steady.published(free, 1.0)).into_iter().chain(steady.probability);
        assert_eq!(found.clone().count(), expected.len());
        for (found, expected) in found.zip(expected) {
            assert!((found - expected).abs() < 1e-8 * expected.abs().max(1.0), "{found}, {expected}: {text}");
        }
        let most = (0..3).max_by(|&a, &b| steady.probability[a].total_cmp(&steady.probability[b]));
        most_likely[most.expect("three motions")] += 1;
    }
    assert!(
        most_likely.iter().all(|&count| count > 5),
        "each motion is the likeliest at times: {most_likely:?}"
    );
}

#[test]
fn the_motions_of_a_pedestrian_equal_the_reference() {
    fn line(cells: &[f64]) -> Line<'_> {
        let [time_ms, x, y, sigma, ..] = *cells else { panic!("{cells:?}") };
        let observation = Observation::of_position([x, y], sigma * sigma);
        Line { time_ms: time_ms as u64, observation, expected: &cells[4..] }
    }
    let models = Models {
        constant_velocity: ConstantVelocity { density: 0.5 },
        ..TrackerOptions::default().detector.models(wire::AgentType::Pedestrian, 0.5)
    };
    let csv = include_str!("../../tests/reference/steady.csv");
    follow(csv, Kind::ConstantVelocity, &models, line, |published| {
        let Filter::ConstantVelocity(state) = published else { panic!("{published:?}") };
        let covariance = [(0, 0), (0, 1), (2, 2)].map(|entry| state.covariance[entry]);
        state.mean.iter().copied().chain(covariance).collect()
    });
}

#[test]
fn the_motions_of_a_vehicle_equal_the_reference() {
    fn line(cells: &[f64]) -> Line<'_> {
        let [time_ms, x, y, heading, speed, ..] = *cells else { panic!("{cells:?}") };
        let observation = Observation {
            position_m: [x, y],
            position_variance: 0.056_25,
            elongation: [0.033_75, 0.02],
            heading_rad: Some((heading, 0.0025)),
            speed_mps: Some((speed, 0.16)),
        };
        Line { time_ms: time_ms as u64, observation, expected: &cells[5..] }
    }
    let of_vehicle = TrackerOptions::default().detector.models(wire::AgentType::Vehicle, 4.0);
    let models = Models { bicycle: Bicycle { rear_axle_m: 1.6, ..of_vehicle.bicycle }, ..of_vehicle };
    let csv = include_str!("../../tests/reference/steady_bicycle.csv");
    follow(csv, Kind::Bicycle, &models, line, |published| {
        let Filter::Bicycle(state) = published else { panic!("{published:?}") };
        let covariance = [(0, 0), (0, 1), (2, 2), (3, 3)].map(|entry| state.covariance[entry]);
        state.mean.iter().copied().chain(covariance).collect()
    });
}
