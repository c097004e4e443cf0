//! The three motions against an independent implementation in float64, `tests/reference/steady.py`.

use filters::Unknown;

use super::*;
use crate::TrackerOptions;

#[test]
fn the_motions_equal_the_reference() {
    let models = Models {
        constant_velocity: filters::ConstantVelocity { density: 0.5 },
        ..TrackerOptions::default().detector.models(wire::AgentType::Pedestrian, 0.5)
    };
    let unknown = Unknown { speed_mps: 2.0, slip_rad: 0.0 };
    let mut motions: Option<(Filter, Steady)> = None;
    let (mut last_ms, mut most_likely) = (0, [0; 3]);
    for line in include_str!("../../tests/reference/steady.csv").lines().skip(1) {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let [time_ms, x, y, sigma, expected @ ..] = cells.as_slice() else { panic!("{line}") };
        let observation = Observation {
            position_m: [*x, *y],
            position_variance: sigma * sigma,
            heading_rad: None,
            speed_mps: None,
        };
        let time_ms = *time_ms as u64;
        let (free, steady) = motions.get_or_insert_with(|| {
            let free = Filter::start(filters::Kind::ConstantVelocity, &observation, &unknown);
            (free, Steady::new(&free))
        });
        if last_ms > 0 {
            let dt_ns = (time_ms - last_ms) * 1_000_000;
            steady.predict(free, dt_ns, &models.steady()).expect("a prediction");
            free.predict(dt_ns, &models).expect("a prediction");
            steady.update_at(0.0, free, &[(1.0, observation)], &models.steady()).expect("an update");
            free.update(&observation, &models).expect("an update");
        }
        last_ms = time_ms;
        steady.updates = UPDATES_MIN;
        let Filter::ConstantVelocity(published) = steady.published(free, 1.0) else { panic!("{line}") };
        let (mean, covariance) = (&published.mean, &published.covariance);
        let found = mean
            .iter()
            .copied()
            .chain([covariance[(0, 0)], covariance[(0, 1)], covariance[(2, 2)]])
            .chain(steady.probability);
        for (found, expected) in found.zip(expected) {
            assert!((found - expected).abs() < 1e-8 * expected.abs().max(1.0), "{found}, {expected}: {line}");
        }
        let most = (0..3).max_by(|&a, &b| steady.probability[a].total_cmp(&steady.probability[b]));
        most_likely[most.expect("three motions")] += 1;
    }
    assert!(
        most_likely.iter().all(|&count| count > 5),
        "each motion is the likeliest at times: {most_likely:?}"
    );
}
