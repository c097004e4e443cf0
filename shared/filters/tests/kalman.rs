//! Kalman filters against reference runs of an independent implementation, and under stress.

use std::path::PathBuf;

use filters::{
    Bicycle, ConstantAcceleration, ConstantTurnRate, ConstantVelocity, Filter, FilterFault, Gaussian,
    Integrator, Kind, Models, Observation, Process, Unknown, reversed, wrapped,
};
use nalgebra::{SMatrix, SVector, Vector5};
use proptest::prelude::*;

use crate::support::bicycle::BICYCLE;
use crate::support::state::is_sound;

const STEP_NS: u64 = 80_000_000;

fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

/// The numbers of a CSV file, without its header line.
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

/// Mean, upper triangle of the covariance row by row, and NIS, as in the reference files.
fn figures<const N: usize>(state: &Gaussian<N>, nis: f64) -> Vec<f64> {
    let upper = (0..N).flat_map(|row| (row..N).map(move |column| state.covariance[(row, column)]));
    state.mean.iter().copied().chain(upper).chain([nis]).collect()
}

/// Largest deviation of a run from the reference. It is relative for numbers above 1 and circular for angles.
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
        let heading_rad = with_heading.then_some((m[6], sigma_psi.powi(2)));
        let position = Observation::of_position([m[4], m[5]], 0.1_f64.powi(2));
        let observed = Observation { heading_rad, ..position };
        let found = if m[1] == 0.0 {
            first(filter.insert(start(&observed, m[6])))
        } else {
            let running = filter.as_mut().expect("started at tick 0");
            step(running, (m[3] == 1.0).then_some(&observed))
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
    let model = Bicycle {
        rear_axle_m: all["rear_axle_m"].as_f64().expect("a number"),
        integrator: Integrator::Euler,
        acceleration_mps2: number("sig_a"),
        slip_rate_radps: number("sig_bd"),
        slip_decay_per_s: 0.0,
        floor: floor.try_into().expect("five variances"),
        slip_max_rad: 3.0,
    };
    let (speed_variance, slip_variance) = (number("Pv0"), number("Pb0"));
    let heading_variance = number("sig_psi").powi(2);
    run(
        name,
        Some(2),
        with_heading,
        |observed, heading| {
            let [x, y] = observed.position_m;
            let var = observed.position_variance;
            Gaussian::new(
                [x, y, heading, 0.0, 0.0],
                [var, var, heading_variance, speed_variance, slip_variance],
            )
        },
        |filter, observed| {
            filter.predict(STEP_NS, &model).expect("finite");
            let nis =
                observed.map_or(f64::NAN, |observed| filter.update(observed, &model).expect("finite").nis);
            figures(filter, nis)
        },
        |filter| figures(filter, f64::NAN),
    )
}

#[test]
fn bicycle_equals_the_reference() {
    for (name, key, with_heading) in
        [("ekf_bic_heading.csv", "ekf_bic_heading", true), ("ekf_bic_posonly.csv", "ekf_bic_posonly", false)]
    {
        let worst = bicycle_deviation(name, key, with_heading);
        println!("{name}: {worst:e}");
        assert!(worst < 1e-9, "{name} deviates by {worst:e}");
    }
}

#[test]
fn constant_velocity_equals_the_reference() {
    let all = parameters();
    let process = ConstantVelocity { density: all["cv"]["q"].as_f64().unwrap() };
    let velocity_variance = all["initial_velocity_variance"].as_f64().unwrap();
    let worst = run(
        "cv_kf.csv",
        None,
        false,
        |observed, _| {
            let ([x, y], var) = (observed.position_m, observed.position_variance);
            Gaussian::new([x, y, 0.0, 0.0], [var, var, velocity_variance, velocity_variance])
        },
        |filter, observed| {
            filter.predict(STEP_NS, &process).unwrap();
            let nis = observed.map_or(f64::NAN, |observed| filter.update(observed, &process).unwrap().nis);
            figures(filter, nis)
        },
        |filter| figures(filter, f64::NAN),
    );
    println!("cv_kf.csv: {worst:e}");
    assert!(worst < 1e-9, "deviates by {worst:e}");
}

#[test]
fn constant_acceleration_equals_the_reference() {
    let all = parameters();
    let process = ConstantAcceleration { density: all["ca"]["q"].as_f64().unwrap() };
    let velocity_variance = all["initial_velocity_variance"].as_f64().unwrap();
    let acceleration_variance = all["initial_acceleration_variance"].as_f64().unwrap();
    let worst = run(
        "ca_kf.csv",
        None,
        false,
        |observed, _| {
            let ([x, y], p) = (observed.position_m, observed.position_variance);
            let (v, a) = (velocity_variance, acceleration_variance);
            Gaussian::new([x, y, 0.0, 0.0, 0.0, 0.0], [p, p, v, v, a, a])
        },
        |filter, observed| {
            filter.predict(STEP_NS, &process).unwrap();
            let nis = observed.map_or(f64::NAN, |observed| filter.update(observed, &process).unwrap().nis);
            figures(filter, nis)
        },
        |filter| figures(filter, f64::NAN),
    );
    println!("ca_kf.csv: {worst:e}");
    assert!(worst < 1e-9, "deviates by {worst:e}");
}

/// The covariance of a step without noise is J P Jᵀ.
#[test]
fn bicycle_jacobian_equals_the_reference() {
    let text = std::fs::read_to_string(golden("unit/jacobian.json")).unwrap();
    let all: serde_json::Value = serde_json::from_str(&text).unwrap();
    let numbers = |value: &serde_json::Value| -> SVector<f64, 5> {
        SVector::from_iterator(value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()))
    };
    let rear_axle_m = all["LR"].as_f64().unwrap();
    let moving = Bicycle { rear_axle_m, slip_max_rad: 3.0, ..BICYCLE };
    let still = Bicycle { integrator: Integrator::Euler, ..moving.noiseless() };
    let cases = all["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 50);
    for case in cases {
        let rows: Vec<SVector<f64, 5>> = case["J"].as_array().unwrap().iter().map(numbers).collect();
        let jacobian = SMatrix::<f64, 5, 5>::from_fn(|row, column| rows[row][column]);
        let (state, expected) = (numbers(&case["s"]), numbers(&case["f"]));
        for column in 0..5 {
            let mut from = Gaussian::new(state.into(), [0.0; 5]);
            from.covariance[(column, column)] = 1.0;
            let moved = still.step(&from, all["DT"].as_f64().unwrap());
            let mut off = moved.mean - expected;
            off[2] = wrapped(off[2]);
            assert!(off.amax() < 1e-9, "{off}");
            let square = jacobian.column(column) * jacobian.column(column).transpose();
            assert!((moved.covariance - square).amax() < 1e-9, "{case}");
        }
    }
}

/// Central differences of a constant turn rate's arc, through the limit of a straight course.
#[test]
fn arc_jacobian_equals_finite_differences() {
    let dt_s = 0.08;
    for turn_rate in [-2.0, -0.3, -0.025_000_1, -1e-5, 0.0, 1e-12, 1e-4, 0.024_999_9, 0.7, 40.0] {
        for heading in [-3.0, 0.4, 2.5] {
            let state = Vector5::new(3.0, -4.0, heading, 9.0, turn_rate);
            let (_, jacobian) = ConstantTurnRate::arc(&state, dt_s);
            for column in 0..5 {
                let mut nudge = Vector5::zeros();
                nudge[column] = 1e-5;
                let (above, _) = ConstantTurnRate::arc(&(state + nudge), dt_s);
                let (below, _) = ConstantTurnRate::arc(&(state - nudge), dt_s);
                let difference = (above - below) / 2e-5;
                assert!((difference - jacobian.column(column)).amax() < 1e-8, "ω = {turn_rate}, {column}");
            }
        }
    }
    // A quarter of a circle of radius 2 m, and the straight line.
    let quarter = Vector5::new(0.0, 0.0, 0.0, 2.0, 1.0);
    let (end, _) = ConstantTurnRate::arc(&quarter, std::f64::consts::FRAC_PI_2);
    assert!((end - Vector5::new(2.0, 2.0, std::f64::consts::FRAC_PI_2, 2.0, 1.0)).amax() < 1e-12);
    let (end, _) = ConstantTurnRate::arc(&Vector5::new(1.0, 1.0, 0.0, 5.0, 0.0), 0.08);
    assert!((end - Vector5::new(1.4, 1.0, 0.0, 5.0, 0.0)).amax() < 1e-15);
}

/// NIS and likelihood against the density of the Gaussian written out.
#[test]
fn evidence_equals_the_density_of_the_innovation() {
    let mut state = Gaussian::new([0.0, 0.0, 1.0, 0.0], [0.3, 0.5, 0.2, 0.2]);
    let process = ConstantVelocity { density: 1.0 };
    let observed = Observation::of_position([0.6, -0.7], 0.2);
    let (xx, yy) = (0.3 + 0.2, 0.5 + 0.2_f64);
    let nis: f64 = 0.36 / xx + 0.49 / yy;
    let density = (-0.5 * nis).exp() / (std::f64::consts::TAU * f64::sqrt(xx * yy));
    let evidence = state.update(&observed, &process).unwrap();
    assert!((evidence.nis - nis).abs() < 1e-12);
    assert!((evidence.log_likelihood - density.ln()).abs() < 1e-12);
    assert_eq!(evidence.measured_count, 2);
}

/// Each kind is updated by positions with any subset of heading and speed.
#[test]
fn every_kind_tracks_a_circle() {
    let (radius_m, speed_mps) = (20.0, 8.0);
    let turn_rate = speed_mps / radius_m;
    for kind in KINDS {
        for measured in 0..4_u32 {
            let observed = |k: u32| {
                let angle = turn_rate * 0.08 * f64::from(k);
                let heading = wrapped(angle + std::f64::consts::FRAC_PI_2);
                Observation {
                    position_m: [radius_m * angle.cos(), radius_m * angle.sin()],
                    position_variance: 0.01,
                    elongation: [0.0; 2],
                    heading_rad: (measured & 1 != 0).then_some((heading, 0.01)),
                    speed_mps: (measured & 2 != 0).then_some((speed_mps, 0.04)),
                }
            };
            let mut filter = Filter::start(kind, &observed(0), &UNKNOWN);
            for k in 1..100 {
                filter.predict(STEP_NS, &MODELS).unwrap();
                let evidence = filter.update(&observed(k), &MODELS).unwrap();
                assert!(evidence.log_likelihood.is_finite() && (2..=4).contains(&evidence.measured_count));
                if filter.kind() != kind && filter.course_sigma_rad() < 0.3 {
                    filter = filter.into_kind(kind, &UNKNOWN);
                }
            }
            assert_eq!(filter.kind(), kind);
            let motion = filter.motion();
            let [x, y] = observed(99).position_m;
            let off_m = (motion.position_m[0] - x).hypot(motion.position_m[1] - y);
            let across = [-y / radius_m * speed_mps, x / radius_m * speed_mps];
            let off_mps = (motion.velocity_mps[0] - across[0]).hypot(motion.velocity_mps[1] - across[1]);
            assert!(
                off_m < 0.15 && off_mps < 0.8,
                "{} {measured}: {off_m} m, {off_mps} m/s",
                format_args!("{kind:?}")
            );
        }
    }
}

#[test]
fn a_long_prediction_equals_several_short_ones() {
    let start = Gaussian::new([1.0, 2.0, 0.5, -0.25], [0.1, 0.1, 1.0, 1.0]);
    let process = ConstantVelocity { density: 0.7 };
    let (mut long, mut short) = (start, start);
    long.predict(5 * STEP_NS, &process).unwrap();
    for _ in 0..5 {
        short.predict(STEP_NS, &process).unwrap();
    }
    assert!((long.mean - short.mean).amax() < 1e-12);
    assert!((long.covariance - short.covariance).amax() < 1e-12);
}

const MODEL: Bicycle =
    Bicycle { integrator: Integrator::Euler, acceleration_mps2: 3.0, slip_rate_radps: 0.3, ..BICYCLE };

const MODELS: Models = Models { constant_velocity: ConstantVelocity { density: 4.0 }, bicycle: MODEL };

const KINDS: [Kind; 2] = [Kind::ConstantVelocity, Kind::Bicycle];

const UNKNOWN: Unknown = Unknown { speed_mps: 10.0, slip_rad: 0.1 };

/// Variances of the measurements from 1e-12 to 1e6.
#[test]
fn covariances_stay_positive_for_a_million_steps() {
    let position = Observation::of_position([30.0, 0.0], 1.0);
    let start = Observation { heading_rad: Some((1.5, 0.01)), ..position };
    let mut all = KINDS.map(|kind| Filter::start(kind, &start, &UNKNOWN));
    let (acceleration, turn_rate) = (
        ConstantAcceleration { density: 4.0 },
        ConstantTurnRate { acceleration_density: 2.0, yaw_density: 0.1 },
    );
    let mut accelerated = Gaussian::new([30.0, 0.0, 0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 100.0, 100.0, 9.0, 9.0]);
    let mut turned = Gaussian::new([30.0, 0.0, 1.5, 0.0, 0.0], [1.0, 1.0, 0.01, 100.0, 0.25]);
    for k in 0..1_000_000_u32 {
        let time_s = f64::from(k) * 0.08;
        let exponent = -12.0 + f64::from(k * 7 % 19);
        let variance = 10_f64.powf(exponent);
        let observed = Observation {
            position_m: [30.0 * (time_s / 10.0).cos(), 30.0 * (time_s / 10.0).sin()],
            position_variance: variance,
            elongation: [0.0; 2],
            heading_rad: (k % 3 == 0).then_some((time_s / 10.0 + std::f64::consts::FRAC_PI_2, variance)),
            speed_mps: (k % 5 == 0).then_some((3.0, variance)),
        };
        for filter in &mut all {
            filter.predict(STEP_NS, &MODELS).unwrap();
            filter.update(&observed, &MODELS).unwrap();
            let sound = match filter {
                Filter::ConstantVelocity(state) => is_sound(state),
                Filter::Bicycle(state) => is_sound(state),
            };
            assert!(sound, "step {k}, R = 1e{exponent}: {filter:?}");
        }
        accelerated.predict(STEP_NS, &acceleration).unwrap();
        accelerated.update(&observed, &acceleration).unwrap();
        turned.predict(STEP_NS, &turn_rate).unwrap();
        turned.update(&observed, &turn_rate).unwrap();
        assert!(is_sound(&accelerated) && is_sound(&turned), "step {k}, R = 1e{exponent}");
    }
}

#[test]
fn a_failed_update_restores_the_state() {
    let mut bicycle = Gaussian::new([0.0, 0.0, 0.3, 5.0, 0.0], [1.0, 1.0, 0.01, 4.0, 0.01]);
    let before = bicycle;
    let observed = |position_variance| Observation::of_position([0.1, 0.2], position_variance);
    assert_eq!(bicycle.update(&observed(-5.0), &MODEL), Err(FilterFault::NotPositive));
    assert_eq!(bicycle, before);
    assert_eq!(bicycle.update(&observed(f64::NAN), &MODEL), Err(FilterFault::NotPositive));
    assert_eq!(bicycle, before);
    assert_eq!(bicycle.predict(u64::MAX, &MODEL), Err(FilterFault::TooLong(u64::MAX)));
    assert_eq!(bicycle, before);
}

proptest! {
    #[test]
    fn reversing_front_and_back_keeps_the_motion(
        heading in -3.0_f64..3.0, speed in -15.0_f64..15.0, slip in -0.4_f64..0.4,
    ) {
        let start = Gaussian::new([3.0, 4.0, heading, speed, slip], [0.2, 0.3, 0.02, 1.5, 0.01]);
        let turned = reversed(&start);
        let (a, b) = (Filter::Bicycle(start).motion(), Filter::Bicycle(turned).motion());
        prop_assert!((a.velocity_mps[0] - b.velocity_mps[0]).abs() < 1e-9);
        prop_assert!((a.velocity_mps[1] - b.velocity_mps[1]).abs() < 1e-9);
        let back = reversed(&turned);
        prop_assert!((back.covariance - start.covariance).amax() < 1e-9);

        // The noise depends on the end of the step, so only the motion is compared.
        let still =
            Bicycle { acceleration_mps2: 0.0, slip_rate_radps: 0.0, floor: [0.0; 5], ..MODEL };
        let (mut start, mut turned) = (start, turned);
        start.predict(4 * STEP_NS, &still).unwrap();
        turned.predict(4 * STEP_NS, &still).unwrap();
        let (a, b) = (Filter::Bicycle(start), Filter::Bicycle(turned));
        let ((pa, ca), (pb, cb)) = (a.position(), b.position());
        prop_assert!((pa[0] - pb[0]).abs() < 1e-9 && (pa[1] - pb[1]).abs() < 1e-9);
        prop_assert!(ca.iter().zip(cb).all(|(x, y)| (x - y).abs() < 1e-9));
    }

    #[test]
    fn converting_to_another_kind_and_back_keeps_the_motion(vx in -9.0_f64..9.0, vy in 0.5_f64..9.0) {
        let start = Gaussian::new([3.0, 4.0, vx, vy], [0.2, 0.3, 0.5, 0.7]);
        for kind in KINDS {
            let there = Filter::ConstantVelocity(start).into_kind(kind, &UNKNOWN);
            prop_assert_eq!(there.kind(), kind);
            let Filter::ConstantVelocity(back) = there.into_kind(Kind::ConstantVelocity, &UNKNOWN) else { panic!() };
            prop_assert!((back.mean - start.mean).amax() < 1e-9);
            // The course has the uncertainty of the slip.
            let speed2 = vx * vx + vy * vy;
            let slip = if kind == Kind::Bicycle { UNKNOWN.slip_rad.powi(2) } else { 0.0 };
            let mut expected = start.covariance;
            let across = [-vy, vx];
            for i in 0..2 {
                for j in 0..2 {
                    expected[(2 + i, 2 + j)] += slip * across[i] * across[j];
                }
            }
            prop_assert!((back.covariance - expected).amax() < 1e-9 * (1.0 + speed2));
        }
    }
}

/// The update in the textbook's form, with dense matrices.
#[test]
fn errors_longer_in_one_direction_update_as_in_the_textbook() {
    let (mean, covariance_m2) = ([3.0, -1.0, 0.4, 2.0], [0.5, 0.7, 0.2, 0.3]);
    let model = ConstantVelocity { density: 0.5 };
    let mut filter = Gaussian::<4>::new(mean, covariance_m2);
    filter.predict(STEP_NS, &model).expect("finite");
    for elongation in [[0.3, 0.0], [-0.2, 0.25], [0.0, -0.39]] {
        let observed = Observation {
            position_m: [3.4, -0.2],
            position_variance: 0.4,
            elongation,
            heading_rad: None,
            speed_mps: None,
        };
        let [xx, xy, yy] = observed.position_covariance();
        let r = SMatrix::<f64, 2, 2>::new(xx, xy, xy, yy);
        let h = SMatrix::<f64, 2, 4>::identity();
        let residual = SVector::<f64, 2>::new(3.4, -0.2) - h * filter.mean;
        let s = h * filter.covariance * h.transpose() + r;
        let inverse = s.try_inverse().expect("positive definite");
        let gain = filter.covariance * h.transpose() * inverse;
        let expected = Gaussian {
            mean: filter.mean + gain * residual,
            covariance: filter.covariance - gain * h * filter.covariance,
        };
        let nis = (residual.transpose() * inverse * residual)[0];
        let mut updated = filter;
        let evidence = updated.update(&observed, &model).expect("finite");
        assert!((updated.mean - expected.mean).norm() < 1e-12, "{updated:?} {expected:?}");
        assert!((updated.covariance - expected.covariance).norm() < 1e-12, "{updated:?} {expected:?}");
        let log_likelihood = -0.5 * (nis + s.determinant().ln() + 2.0 * std::f64::consts::TAU.ln());
        assert!((evidence.nis - nis).abs() < 1e-12, "{evidence:?} {nis}");
        assert!((evidence.log_likelihood - log_likelihood).abs() < 1e-12, "{evidence:?} {log_likelihood}");
    }
}
