//! The filters against reference runs of an independent implementation, and under stress.

use std::path::PathBuf;

use filters::{Bicycle, BicycleModel, ConstantVelocity, Filter, Gaussian, Observation, wrapped};
use proptest::prelude::*;

const STEP_NS: u64 = 80_000_000;

fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

/// The numbers of a CSV file, without its head line.
fn rows(name: &str) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(golden(name)).expect("golden file");
    text.lines()
        .skip(1)
        .map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect())
        .collect()
}

fn parameters() -> serde_json::Value {
    let text = std::fs::read_to_string(golden("parameters.json")).expect("golden file");
    serde_json::from_str(&text).expect("JSON")
}

/// Mean, upper triangle of the covariance row by row, NIS: as in the reference files.
fn told<const N: usize>(state: &Gaussian<N>, nis: f64) -> Vec<f64> {
    let upper = (0..N).flat_map(|row| (row..N).map(move |column| state.covariance[(row, column)]));
    state.mean.iter().copied().chain(upper).chain([nis]).collect()
}

/// Largest deviation of a run from the reference, relative above 1; angles on the circle.
fn deviation(found: &[f64], expected: &[f64], angle: Option<usize>) -> f64 {
    assert_eq!(found.len(), expected.len());
    let mut worst = 0.0_f64;
    for (i, (&f, &e)) in found.iter().zip(expected).enumerate() {
        if e.is_nan() {
            assert!(f.is_nan());
            continue;
        }
        let difference = if Some(i) == angle { wrapped(f - e) } else { f - e };
        worst = worst.max(difference.abs() / e.abs().max(1.0));
    }
    worst
}

/// Runs a filter over the reference measurements and returns its largest deviation.
fn run<F>(
    name: &str,
    angle: Option<usize>,
    with_heading: bool,
    start: impl Fn(&Observation, f64) -> F,
    mut step: impl FnMut(&mut F, Option<&Observation>) -> Vec<f64>,
    first: impl Fn(&F) -> Vec<f64>,
) -> f64 {
    let sigma_psi = 0.05_f64;
    let mut filter = None;
    let mut worst = 0.0_f64;
    let reference = rows(name);
    let measured = rows("meas.csv");
    assert!(measured.len() > 150 && measured.len() == reference.len());
    for (m, expected) in measured.iter().zip(&reference) {
        assert_eq!(m[..2], expected[..2]);
        let seen = Observation {
            position_m: [m[4], m[5]],
            position_variance: 0.1_f64.powi(2),
            heading_rad: with_heading.then_some((m[6], sigma_psi.powi(2))),
            speed_mps: None,
        };
        let found = if m[1] == 0.0 {
            first(filter.insert(start(&seen, m[6])))
        } else {
            let running = filter.as_mut().expect("started at tick 0");
            step(running, (m[3] == 1.0).then_some(&seen))
        };
        worst = worst.max(deviation(&found, &expected[2..], angle));
    }
    worst
}

fn bicycle_deviation(name: &str, key: &str, with_heading: bool) -> f64 {
    let all = parameters();
    let number = |name: &str| all[key][name].as_f64().expect("a number");
    let floor: Vec<f64> = all[key]["q_floor"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|x| x.as_f64().expect("a number"))
        .collect();
    let model = BicycleModel {
        rear_axle_m: all["rear_axle_m"].as_f64().expect("a number"),
        acceleration_mps2: number("sig_a"),
        slip_rate_radps: number("sig_bd"),
        floor: floor.try_into().expect("five variances"),
        slip_max_rad: 3.0,
    };
    let (speed_variance, slip_variance) = (number("Pv0"), number("Pb0"));
    let heading_variance = number("sig_psi").powi(2);
    run(
        name,
        Some(2),
        with_heading,
        |seen, heading| {
            let [x, y] = seen.position_m;
            let var = seen.position_variance;
            Bicycle::new(
                [x, y, heading, 0.0, 0.0],
                [var, var, heading_variance, speed_variance, slip_variance],
            )
        },
        |filter, seen| {
            filter.predict(STEP_NS, &model).expect("finite");
            let nis = seen.map_or(f64::NAN, |seen| filter.update(seen, model.slip_max_rad).expect("finite"));
            told(&filter.state, nis)
        },
        |filter| told(&filter.state, f64::NAN),
    )
}

#[test]
fn the_bicycle_agrees_with_the_reference() {
    for (name, key, with_heading) in
        [("ekf_bic_heading.csv", "ekf_bic_heading", true), ("ekf_bic_posonly.csv", "ekf_bic_posonly", false)]
    {
        let worst = bicycle_deviation(name, key, with_heading);
        println!("{name}: {worst:e}");
        assert!(worst < 1e-9, "{name} deviates by {worst:e}");
    }
}

#[test]
fn constant_velocity_agrees_with_the_reference() {
    let all = parameters();
    let density = all["cv"]["q"].as_f64().unwrap();
    let velocity_variance = all["initial_velocity_variance"].as_f64().unwrap();
    let worst = run(
        "cv_kf.csv",
        None,
        false,
        |seen, _| {
            let ([x, y], var) = (seen.position_m, seen.position_variance);
            ConstantVelocity::new([x, y, 0.0, 0.0], [var, var, velocity_variance, velocity_variance])
        },
        |filter, seen| {
            filter.predict(STEP_NS, density).unwrap();
            let nis = seen.map_or(f64::NAN, |seen| filter.update(seen).unwrap());
            told(&filter.state, nis)
        },
        |filter| told(&filter.state, f64::NAN),
    );
    println!("cv_kf.csv: {worst:e}");
    assert!(worst < 1e-9, "deviates by {worst:e}");
}

#[test]
fn subdivided_steps_are_those_of_shorter_frames() {
    let start = ConstantVelocity::new([1.0, 2.0, 0.5, -0.25], [0.1, 0.1, 1.0, 1.0]);
    let (mut long, mut short) = (start, start);
    long.predict(5 * STEP_NS, 0.7).unwrap();
    for _ in 0..5 {
        short.predict(STEP_NS, 0.7).unwrap();
    }
    assert!((long.state.mean - short.state.mean).amax() < 1e-12);
    assert!((long.state.covariance - short.state.covariance).amax() < 1e-12);
}

const MODEL: BicycleModel = BicycleModel {
    rear_axle_m: 1.2,
    acceleration_mps2: 3.0,
    slip_rate_radps: 0.3,
    floor: [1e-4, 1e-4, 1e-5, 0.0, 0.0],
    slip_max_rad: 0.5,
};

/// A filter's covariance must stay symmetric and positive whatever the noise of the measurements.
#[test]
fn covariances_stay_positive() {
    let mut bicycle = Bicycle::new([0.0, 0.0, 0.3, 0.0, 0.0], [1.0, 1.0, 0.01, 100.0, 0.01]);
    let mut cv = ConstantVelocity::new([0.0; 4], [1.0, 1.0, 100.0, 100.0]);
    for k in 0_u32..100_000 {
        let time_s = f64::from(k) * 0.08;
        let exponent = -12.0 + f64::from(k * 7 % 19);
        let variance = 10_f64.powf(exponent);
        let seen = Observation {
            position_m: [30.0 * (time_s / 10.0).cos(), 30.0 * (time_s / 10.0).sin()],
            position_variance: variance,
            heading_rad: (k % 3 == 0).then_some((time_s / 10.0 + std::f64::consts::FRAC_PI_2, variance)),
            speed_mps: (k % 5 == 0).then_some((3.0, variance)),
        };
        bicycle.predict(STEP_NS, &MODEL).unwrap();
        cv.predict(STEP_NS, 1.0).unwrap();
        bicycle.update(&seen, MODEL.slip_max_rad).unwrap();
        cv.update(&seen).unwrap();
        let p = bicycle.state.covariance;
        assert_eq!(p, p.transpose(), "step {k}");
        assert!(p.cholesky().is_some(), "step {k}, R = 1e{exponent}: {p}");
        assert!(cv.state.covariance.cholesky().is_some(), "step {k}, R = 1e{exponent}");
    }
}

#[test]
fn a_failed_update_restores_the_state() {
    let mut bicycle = Bicycle::new([0.0, 0.0, 0.3, 5.0, 0.0], [1.0, 1.0, 0.01, 4.0, 0.01]);
    let before = bicycle;
    let seen = |position_variance| Observation {
        position_m: [0.1, 0.2],
        position_variance,
        heading_rad: None,
        speed_mps: None,
    };
    assert!(bicycle.update(&seen(-5.0), 0.5).is_err());
    assert_eq!(bicycle, before);
    assert!(bicycle.update(&seen(f64::NAN), 0.5).is_err());
    assert_eq!(bicycle, before);
}

proptest! {
    /// Turning round tells the same motion from the other end, so it can't change how the track moves on.
    #[test]
    fn turning_round_keeps_the_motion(
        heading in -3.0_f64..3.0, speed in -15.0_f64..15.0, slip in -0.4_f64..0.4,
    ) {
        let start = Bicycle::new([3.0, 4.0, heading, speed, slip], [0.2, 0.3, 0.02, 1.5, 0.01]);
        let mut turned = start;
        turned.turn_round();
        let (a, b) = (Filter::Bicycle(start).motion(), Filter::Bicycle(turned).motion());
        prop_assert!((a.velocity_mps[0] - b.velocity_mps[0]).abs() < 1e-9);
        prop_assert!((a.velocity_mps[1] - b.velocity_mps[1]).abs() < 1e-9);
        let mut back = turned;
        back.turn_round();
        prop_assert!((back.state.covariance - start.state.covariance).amax() < 1e-9);

        // The noise is told from one end, so the motion alone is compared.
        let still =
            BicycleModel { acceleration_mps2: 0.0, slip_rate_radps: 0.0, floor: [0.0; 5], ..MODEL };
        let (mut start, mut turned) = (start, turned);
        start.predict(4 * STEP_NS, &still).unwrap();
        turned.predict(4 * STEP_NS, &still).unwrap();
        let (a, b) = (Filter::Bicycle(start), Filter::Bicycle(turned));
        let ((pa, ca), (pb, cb)) = (a.position(), b.position());
        prop_assert!((pa[0] - pb[0]).abs() < 1e-9 && (pa[1] - pb[1]).abs() < 1e-9);
        prop_assert!(ca.iter().zip(cb).all(|(x, y)| (x - y).abs() < 1e-9));
    }

    /// To a bicycle and back is the motion that it was.
    #[test]
    fn the_two_filters_tell_the_same_motion(vx in -9.0_f64..9.0, vy in 0.5_f64..9.0) {
        let start = ConstantVelocity::new([3.0, 4.0, vx, vy], [0.2, 0.3, 0.5, 0.7]);
        let bicycle = Filter::ConstantVelocity(start).into_bicycle(0.0);
        let Filter::ConstantVelocity(back) = bicycle.into_constant_velocity() else { panic!() };
        prop_assert!((back.state.mean - start.state.mean).amax() < 1e-9);
        prop_assert!((back.state.covariance - start.state.covariance).amax() < 1e-9);
    }
}
