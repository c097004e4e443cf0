//! Properties of the equations of motion for any state and control.

use kinematics::{
    Belief, Bicycle, BicycleState, ControlGaussian, ControlLimits, Displacement, DisplacementKind,
    DisplacementState, Integrator, Moments, Motion, MotionKind, MotionModel, MotionOptions, MotionStart,
    Normals, Vehicle, advance_particles, initial_slip, mixture, saturate, spread, wrap_angle,
};
use nalgebra::{SVector, Vector2};
use proptest::prelude::*;

const DT_S: f32 = 0.4;

fn vehicle(integrator: Integrator) -> Vehicle {
    Vehicle {
        bicycle: Bicycle { rear_axle_m: 1.2, slip_limit_rad: Some(0.5), integrator },
        limits: ControlLimits { accel_mps2: 6.0, slip_rate_radps: 1.0 },
        dt_s: DT_S,
    }
}

fn integrators() -> impl Strategy<Value = Integrator> {
    prop_oneof![Just(Integrator::Euler), Just(Integrator::Midpoint)]
}

fn states() -> impl Strategy<Value = BicycleState<f64>> {
    [-50.0..50.0, -50.0..50.0, -3.0..3.0, -5.0..25.0, -0.45..0.45_f64].prop_map(BicycleState::from)
}

fn controls() -> impl Strategy<Value = Vector2<f64>> {
    [-6.0..6.0, -1.0..1.0_f64].prop_map(Vector2::from)
}

proptest! {
    #[test]
    fn jacobians_are_the_finite_differences(
        state in states(), control in controls(), integrator in integrators(), limited in any::<bool>(),
    ) {
        let slip_limit_rad = limited.then_some(0.3);
        let bicycle = Bicycle { rear_axle_m: 1.4, slip_limit_rad, integrator };
        // At the limit itself the derivative is one-sided, and a slip outside jumps to the limit. Neither
        // case has a derivative.
        let next = state[4] + control[1] * 0.5;
        prop_assume!(slip_limit_rad.is_none_or(|limit: f64| (next.abs() - limit).abs() > 1e-3));
        let at = bicycle.linearise(&state, &control, 0.5);
        prop_assert_eq!(at.next, bicycle.step(&state, &control, 0.5));
        let h = 1e-5;
        for column in 0..5 {
            let nudge = SVector::<f64, 5>::from_fn(|row, _| if row == column { h } else { 0.0 });
            let [up, down] = [nudge, -nudge].map(|n| bicycle.step(&(state + n), &control, 0.5));
            let off = ((up - down) / (2.0 * h) - at.by_state.column(column)).amax();
            prop_assert!(off < 1e-6, "by state {}: off by {}", column, off);
        }
        for column in 0..2 {
            let nudge = Vector2::from_fn(|row, _| if row == column { h } else { 0.0 });
            let [up, down] = [nudge, -nudge].map(|n| bicycle.step(&state, &(control + n), 0.5));
            let off = ((up - down) / (2.0 * h) - at.by_control.column(column)).amax();
            prop_assert!(off < 1e-6, "by control {}: off by {}", column, off);
        }
    }

    #[test]
    fn covariances_stay_symmetric_and_positive(
        speed in -5.0_f32..25.0, accel in -20.0_f32..20.0, rate in -3.0_f32..3.0, integrator in integrators(),
    ) {
        let control = ControlGaussian::new([accel, rate], [1.0, 0.3, 0.2]);
        let mut belief = Belief::certain(BicycleState::from([3.0, -2.0, 0.7, speed, 0.05]));
        for _ in 0..12 {
            belief.advance(&vehicle(integrator), &control);
            prop_assert_eq!(belief.covariance, belief.covariance.transpose());
            let least = belief.covariance.map(f64::from).symmetric_eigenvalues().min();
            prop_assert!(least > -1e-5 * f64::from(belief.covariance.amax()), "eigenvalue {}", least);
            prop_assert!(belief.mean[4].abs() <= 0.5);
        }
    }

    #[test]
    fn saturation_keeps_its_limit_and_its_slope(value in -100.0_f32..100.0, limit in 0.1_f32..10.0) {
        let (limited, slope) = saturate(value, limit);
        prop_assert!(limited.abs() <= limit);
        let h = 1e-2 * limit;
        let difference = (saturate(value + h, limit).0 - saturate(value - h, limit).0) / (2.0 * h);
        prop_assert!((slope - difference).abs() < 2e-4, "{} {}", slope, difference);
    }

    #[test]
    fn wrapped_angles_point_the_same_way(angle in -50.0_f32..50.0) {
        let wrapped = wrap_angle(angle);
        prop_assert!(wrapped.abs() <= std::f32::consts::PI);
        prop_assert!((wrapped.cos() - angle.cos()).abs() < 1e-4 && (wrapped.sin() - angle.sin()).abs() < 1e-4);
    }
}

#[test]
fn a_steady_turn_keeps_its_circle_under_midpoint() {
    let bicycle = Bicycle { rear_axle_m: 1.5, slip_limit_rad: None, integrator: Integrator::Midpoint };
    let (speed, slip) = (8.0_f64, 0.15_f64);
    let turn_rate = speed * slip.sin() / 1.5;
    let radius_m = speed / turn_rate;
    let mut state = BicycleState::from([0.0, 0.0, -slip, speed, slip]);
    for step in 1..=12 {
        state = bicycle.step(&state, &Vector2::zeros(), 0.1);
        let angle = turn_rate * 0.1 * f64::from(step);
        // The course starts along +x, so the centre of the circle is at (0, radius).
        let expected = Vector2::new(radius_m * angle.sin(), radius_m * (1.0 - angle.cos()));
        assert!((state.xy() - expected).norm() < 5e-3, "step {step}: {state:?}");
    }
}

#[test]
fn initial_slip_makes_the_turn_that_was_observed() {
    let slip = initial_slip(1.3, 9.0, [0.4, 0.4]);
    assert!((9.0 * slip.sin() / 1.3 - 0.4).abs() < 1e-5);
    assert_eq!(initial_slip(1.3, 0.0, [0.4, 0.4]), 0.0);
    assert_eq!(initial_slip(1.3, 0.1, [4.0, 0.0]), 0.45_f32.asin());
    let reversing = initial_slip(1.3, -3.0, [0.2, 0.2]);
    assert!((-3.0 * reversing.sin() / 1.3 - 0.2).abs() < 1e-5, "{reversing}");
}

#[test]
fn displacements_add_to_constant_velocity_in_the_agents_axes() {
    let start = DisplacementState::from([1.0, 2.0, 0.5, -1.0]);
    let control = Vector2::new(0.3, 0.1);
    let residual = Displacement::new(DisplacementKind::Residual, std::f32::consts::FRAC_PI_2, DT_S);
    let next = residual.step(&start, &control);
    assert!((next.xy() - Vector2::new(1.0 + 0.2 - 0.1, 2.0 - 0.4 + 0.3)).norm() < 1e-6);
    let absolute = Displacement::new(DisplacementKind::Absolute, std::f32::consts::FRAC_PI_2, DT_S);
    let next = absolute.step(&start, &control);
    assert!((next.xy() - Vector2::new(0.9, 2.3)).norm() < 1e-6);

    // An uncertain velocity spreads with time. The displacements' own noise adds up in the world's axes.
    let mut belief = Belief::certain(start);
    belief.covariance[(2, 2)] = 0.04;
    for _ in 0..5 {
        belief.advance(&residual, &ControlGaussian::centred([0.2, 0.0]));
    }
    let [xx, xy, yy] = belief.position().covariance;
    assert!((xx - 0.04 * (5.0 * DT_S).powi(2)).abs() < 1e-5, "{xx}");
    assert!((yy - 5.0 * 0.04).abs() < 1e-5 && xy.abs() < 1e-6, "{yy} {xy}");
}

#[test]
fn particles_agree_with_gaussians_in_nearly_linear_motion() {
    let motion = vehicle(Integrator::Midpoint);
    let control = ControlGaussian::new([0.8, 0.001], [0.3, 0.002, 0.004]);
    let mut belief = Belief::certain(BicycleState::from([5.0, -3.0, 0.4, 9.0, 0.01]));
    belief.covariance[(0, 0)] = 0.09;
    belief.covariance[(1, 1)] = 0.04;
    let mut normals = Normals::new(7, 1, 2);
    let mut particles: Vec<_> = (0..20_000).map(|_| belief.sample(&mut normals)).collect();
    for _ in 0..8 {
        belief.advance(&motion, &control);
        advance_particles(&motion, &control, &mut particles, &mut normals);
    }
    let (exact, drawn) = (belief.position(), spread(particles.iter().map(|p| [p[0], p[1]])));
    let scale = exact.covariance[0] + exact.covariance[2];
    for axis in 0..2 {
        assert!((exact.mean[axis] - drawn.mean[axis]).abs() < 0.1 * scale.sqrt(), "{exact:?} {drawn:?}");
    }
    for entry in 0..3 {
        let off = (exact.covariance[entry] - drawn.covariance[entry]).abs();
        assert!(off < 0.08 * scale, "{exact:?} {drawn:?}");
    }
}

#[test]
fn normals_are_standard_and_depend_on_every_part_of_their_key() {
    let mut normals = Normals::new(1, 2, 3);
    let drawn: Vec<f64> = (0..100_000).map(|_| f64::from(normals.draw())).collect();
    let moment = |power: i32| drawn.iter().map(|x| x.powi(power)).sum::<f64>() / drawn.len() as f64;
    assert!(moment(1).abs() < 0.01 && (moment(2) - 1.0).abs() < 0.02 && (moment(4) - 3.0).abs() < 0.1);
    let neighbours: f64 = drawn.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / drawn.len() as f64;
    assert!(neighbours.abs() < 0.01, "{neighbours}");

    let first = |seed, id, seq| Normals::new(seed, id, seq).draw();
    assert_eq!(first(1, 2, 3), first(1, 2, 3));
    for other in [first(2, 2, 3), first(1, 3, 3), first(1, 2, 4), first(2, 1, 3)] {
        assert_ne!(first(1, 2, 3), other);
    }
}

#[test]
fn a_mixture_has_the_moments_of_its_parts_and_of_their_spread() {
    let parts = [
        (0.25, Moments { mean: [0.0, 0.0], covariance: [1.0, 0.5, 1.0] }),
        (0.75, Moments { mean: [4.0, 2.0], covariance: [2.0, 0.0, 1.0] }),
    ];
    let mixed = mixture(parts.into_iter());
    assert_eq!(mixed.mean, [3.0, 1.5]);
    assert_eq!(mixed.covariance, [1.75 + 3.0, 0.125 + 1.5, 1.0 + 0.75]);
    assert_eq!(spread([[1.0, 5.0], [3.0, 5.0]].into_iter()).covariance, [1.0, 0.0, 0.0]);
}

/// A bicycle that turns in reverse, and one agent for each kind of displacement.
fn models() -> [MotionModel; 3] {
    let start = MotionStart {
        position_m: [3.0, -2.0],
        velocity_mps: [-1.8, -1.1],
        heading_rad: 0.6,
        turn_rates_radps: [0.1, 0.2],
        frame_heading_rad: 0.5,
        length_m: Some(4.0),
    };
    let options = MotionOptions::default();
    let absolute = MotionOptions { displacement: DisplacementKind::Absolute, ..options };
    [
        MotionModel::new(MotionKind::Bicycle, &start, &options, DT_S),
        MotionModel::new(MotionKind::Displacement, &start, &options, DT_S),
        MotionModel::new(MotionKind::Displacement, &start, &absolute, DT_S),
    ]
}

#[test]
fn a_model_starts_as_its_history_ends() {
    let [bicycle, displacement, _] = models();
    let MotionModel::Bicycle { motion, start } = bicycle else { panic!("{bicycle:?}") };
    assert_eq!(motion.bicycle.rear_axle_m, 0.26 * 4.0);
    let [x_m, y_m, heading_rad, speed_mps, slip_rad] = start.mean.into();
    assert_eq!([x_m, y_m, heading_rad], [3.0, -2.0, 0.6]);
    assert!((speed_mps + 1.8 * 0.6_f32.cos() + 1.1 * 0.6_f32.sin()).abs() < 1e-6, "{speed_mps}");
    assert_eq!(slip_rad, initial_slip(0.26 * 4.0, speed_mps, [0.1, 0.2]));
    assert_eq!(start.covariance.amax(), 0.0);
    let course = bicycle.with_course_along_heading().frame_heading_rad();
    assert!((course + slip_rad - 0.6).abs() < 1e-6);
    let MotionModel::Displacement { start, .. } = displacement else { panic!("{displacement:?}") };
    assert_eq!(<[f32; 4]>::from(start.mean), [3.0, -2.0, -1.8, -1.1]);
    assert!((displacement.frame_heading_rad() - 0.5).abs() < 1e-6);
    let options = MotionOptions { initial_slip: false, ..MotionOptions::default() };
    assert_eq!(options.start_slip_rad(1.0, 5.0, [0.3, 0.3]), 0.0);
    assert_eq!(options.rear_axle_m(None), 0.26 * 4.5);
}

/// Positions, linearised Gaussians and particles of the same controls. Without uncertainty all three agree.
#[test]
fn trajectories_agree_whichever_way_they_are_made() {
    let means = [[0.8, 0.05], [-0.5, 0.1], [9.0, -0.2], [0.0, 0.0]];
    for model in models() {
        let mut path_m = [[0.0; 2]; 4];
        model.positions(means.into_iter(), &mut path_m);
        for deviation in [0.0, 0.1] {
            let controls = means.map(|mean| ControlGaussian::new(mean, [deviation, 0.0, 0.2 * deviation]));
            let mut moments = [Moments::default(); 4];
            model.moments(controls.iter().map(|control| model.acting(control)), &mut moments);
            assert_eq!(moments.map(|moments| moments.mean), path_m);
            let mut drawn = [Moments::default(); 4];
            model.particle_moments(controls.into_iter(), 32, &mut Normals::new(1, 2, 3), &mut drawn);
            for (exact, drawn) in moments.iter().zip(&drawn) {
                let width_m = (exact.covariance[0] + exact.covariance[2]).sqrt();
                let off_m = [0, 1].map(|axis| (exact.mean[axis] - drawn.mean[axis]).abs());
                assert!(off_m.iter().all(|off_m| *off_m < 0.6 * width_m + 1e-4), "{exact:?} {drawn:?}");
                assert!((deviation > 0.0) == (width_m > 0.0), "{exact:?}");
            }
        }
    }
}

#[test]
fn relative_controls_are_the_same_for_both_displacements() {
    let [bicycle, residual, absolute] = models();
    let (mut residual_m, mut absolute_m) = ([[0.0; 2]; 3], [[0.0; 2]; 3]);
    absolute.positions(std::iter::repeat([0.4, -0.1]), &mut absolute_m);
    let control = ControlGaussian::new([0.4, -0.1], [0.1, 0.02, 0.1]);
    let relative = absolute.relative_to_start(&absolute.acting(&control));
    assert_eq!(relative.cholesky, control.cholesky);
    residual.positions(std::iter::repeat(relative.mean.into()), &mut residual_m);
    for (residual_m, absolute_m) in residual_m.iter().zip(&absolute_m) {
        assert!((0..2).all(|axis| (residual_m[axis] - absolute_m[axis]).abs() < 1e-5), "{residual_m:?}");
    }
    assert_eq!([&bicycle, &residual].map(|model| model.relative_to_start(&control)), [control; 2]);
}

proptest! {
    #[test]
    fn a_bicycle_follows_a_path_that_it_can_take(
        speed_mps in 1.0..40.0_f32, turn in -1.0..1.0_f32,
        controls in prop::array::uniform4((-1.0..1.0_f32, -1.0..1.0_f32)),
    ) {
        // Each control holds for three steps. No control causes reverse motion or more than 8 m/s² across the
        // path.
        let (time_s, most_mps2, rear_axle_m) = (12.0 * DT_S, 3.0, 1.17);
        let slip_rad = turn * (4.0 * rear_axle_m / (speed_mps + time_s * most_mps2).powi(2)).min(0.2);
        let taken = (0..12).map(|step| controls[step / 3]).map(|(effort, turn)| {
            let accel_mps2 = effort * if effort < 0.0 { speed_mps / time_s } else { most_mps2 };
            [accel_mps2, turn * slip_rad.abs() / time_s]
        });
        let start = MotionStart { velocity_mps: [speed_mps, 0.0], ..MotionStart::default() };
        let model = vehicle_from(&start, slip_rad);
        let (mut path_m, mut followed, mut again_m) = ([[0.0; 2]; 12], [[0.0; 2]; 12], [[0.0; 2]; 12]);
        model.positions(taken, &mut path_m);
        model.follow(&path_m, &mut followed);
        model.positions(followed.into_iter(), &mut again_m);
        let straight_m = |step: usize| speed_mps * DT_S * (step + 1) as f32;
        for (step, (again, asked)) in again_m.iter().zip(&path_m).enumerate() {
            let off_m = (again[0] - asked[0]).hypot(again[1] - asked[1]);
            let away_m = (asked[0] - straight_m(step)).hypot(asked[1]);
            prop_assert!(off_m < 0.3 + 0.1 * away_m, "step {step}: off by {off_m} m of {away_m} m");
        }
    }

    #[test]
    fn controls_along_any_path_are_finite_and_within_their_limits(
        speed_mps in -5.0..45.0_f32, slip_rad in -0.5..0.5_f32,
        path_m in prop::array::uniform12(prop::array::uniform2(-300.0..300.0_f32)),
    ) {
        let start = MotionStart { velocity_mps: [speed_mps, 0.0], ..MotionStart::default() };
        let mut controls = [[f32::NAN; 2]; 12];
        let model = vehicle_from(&start, slip_rad);
        model.follow(&path_m, &mut controls);
        for control in controls {
            let acting = model.acting(&ControlGaussian::new(control, [0.0; 3])).mean;
            prop_assert!(acting[0].abs() <= 6.0 && acting[1].abs() <= 1.0, "{control:?}");
        }
    }

    #[test]
    fn displacements_lead_along_any_path(
        heading_rad in -3.0..3.0_f32, absolute in any::<bool>(),
        path_m in prop::array::uniform12(prop::array::uniform2(-30.0..30.0_f32)),
    ) {
        let displacement = if absolute { DisplacementKind::Absolute } else { DisplacementKind::Residual };
        let options = MotionOptions { displacement, ..MotionOptions::default() };
        let start = MotionStart {
            velocity_mps: [1.2, -0.4], frame_heading_rad: heading_rad, ..MotionStart::default()
        };
        let model = MotionModel::new(MotionKind::Displacement, &start, &options, DT_S);
        let (mut controls, mut again_m) = ([[0.0; 2]; 12], [[0.0; 2]; 12]);
        model.follow(&path_m, &mut controls);
        model.positions(controls.into_iter(), &mut again_m);
        for (again, asked) in again_m.as_flattened().iter().zip(path_m.as_flattened()) {
            prop_assert!((again - asked).abs() < 1e-4, "{again} for {asked}");
        }
    }
}

/// A vehicle at the origin with a slip angle.
fn vehicle_from(start: &MotionStart, slip_rad: f32) -> MotionModel {
    let mut model = MotionModel::new(MotionKind::Bicycle, start, &MotionOptions::default(), DT_S);
    if let MotionModel::Bicycle { start, .. } = &mut model {
        start.mean[4] = slip_rad;
    }
    model
}
