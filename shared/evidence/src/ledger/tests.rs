use super::*;
use crate::MotionNow;

const STEP_NS: i64 = 400_000_000;
const AGENT: Agent = Agent { id: 7, agent_type: AgentType::Vehicle, speed_mps: 10.0, course: [1.0, 0.0] };

/// An agent at a constant 10 m/s. The network predicts `factor` times the distance, with all modes there;
/// levels are `level`. Returns the final state.
fn drive(steps: i64, factor: f32, level: f64) -> Evidence {
    drive_by(steps, |_| [1.0, factor, 1.0], level)
}

/// A position without error.
const fn known(position_m: [f32; 2]) -> Observed {
    Observed { position_m, covariance_m2: [0.0; 3] }
}

/// As [`drive`]. At each step the three factors scale the distances of constant velocity, the network and the
/// blend.
fn drive_by(steps: i64, factors: impl Fn(i64) -> [f32; 3], level: f64) -> Evidence {
    let evidence = Evidence::new(12, STEP_NS as u64, &Prior::default());
    drive_with(evidence, steps, factors, level)
}

/// As [`drive_by`], starting from earlier evidence.
fn drive_with(mut evidence: Evidence, steps: i64, factors: impl Fn(i64) -> [f32; 3], level: f64) -> Evidence {
    let covariances_m2 = [[[1.0, 0.0, 1.0]; HORIZON_MAX]; MODES_MAX];
    for step in 0..steps {
        let x_m = 4.0 * step as f32;
        evidence.observe_with(step * STEP_NS, [(AGENT.id, known([x_m, 0.0]))], |_| level);
        let now = MotionNow { position_m: [x_m, 0.0], velocity_mps: [10.0, 0.0], ..MotionNow::default() };
        let mut taken = [[0.0; 2]; HORIZON_MAX];
        now.steady(0.4, &mut taken);
        let [velocity, network, blend] =
            factors(step).map(|factor| taken.map(|[x, y]| [x_m + factor * (x - x_m), y]));
        let mut experts = [velocity; EXPERTS];
        experts[0] = network;
        let modes_m = [network; MODES_MAX];
        let mixture = Mixture {
            probability: &[0.05; MODES_MAX],
            modes_m: &modes_m,
            covariances_m2: &covariances_m2,
            widths: &[1.0; HORIZON_MAX],
            network_m: &modes_m,
            fan: &evidence.fan(&AGENT, &velocity, &blend),
        };
        let paths = Paths { velocity, experts };
        evidence.store(step * STEP_NS, &AGENT, (&paths, &blend), Some(mixture));
    }
    evidence
}

/// The fan of an agent that stands or moves 8 m along and 2 m across.
fn fan(evidence: &Evidence) -> Fan {
    evidence.fan(&AGENT, &[[0.0; 2]; HORIZON_MAX], &[[8.0, 2.0]; HORIZON_MAX])
}

/// The selection from the fan and from twenty modes at a spacing of one metre across the course.
fn choose(evidence: &Evidence) -> Choice {
    let network_m: [_; MODES_MAX] = std::array::from_fn(|mode| [[0.0, mode as f32 - 9.5]; HORIZON_MAX]);
    let probability = [0.05; MODES_MAX];
    evidence.choose(&AGENT, (&network_m, &probability), &fan(evidence))
}

#[test]
fn a_network_that_is_wrong_loses_its_modes_to_the_fan() {
    let of_network = |evidence: &Evidence| {
        let choice = choose(evidence);
        (0..MODES_MAX).filter_map(|mode| choice.of_network(mode)).sum::<f32>()
    };
    let [wrong, before, right] =
        [(60, 1.5), (0, 1.0), (60, 1.0)].map(|(steps, factor)| of_network(&drive(steps, factor, 0.5)));
    assert!(wrong < 0.1 && (0.3..0.7).contains(&before) && right > 0.9, "{wrong} {before} {right}");
}

#[test]
fn a_network_that_knows_the_road_is_believed_before_its_last_steps_matured() {
    let mut doubt = crate::Statistics::doubting();
    (doubt.targets[0], doubt.len) = (0.2, 1.0);
    let mut prior = Prior::default();
    prior.0.as_flattened_mut().iter_mut().for_each(|context| context.blend = [doubt; KNOTS]);
    // Constant velocity or the network goes too far, for 3.2 s of 4.8.
    let [before, known, strange] =
        [(0, 1.3, 1.0), (8, 1.3, 1.0), (8, 1.0, 1.3)].map(|(steps, velocity, network)| {
            let evidence = Evidence::new(12, STEP_NS as u64, &prior);
            let factors = |_| [velocity, network, 1.0];
            drive_with(evidence, steps, factors, 0.5).weights(AGENT.agent_type, AGENT.speed_mps)[11][0]
        });
    assert!(strange < before && before < 0.25 && known > 0.4, "{strange} {before} {known}");
}

#[test]
fn an_absurd_forecast_is_outlived_and_one_out_of_the_world_is_nothing() {
    let prior = Prior::default();
    let network_after = |absurd: f32, steps: i64| {
        // Constant velocity goes too far. The network is right except once, when it predicts kilometres.
        let factors = |step| if step == 3 { [1.3, absurd, 1.0] } else { [1.3, 1.0, 1.0] };
        let evidence = Evidence::new(12, STEP_NS as u64, &prior);
        drive_with(evidence, steps, factors, 0.5).weights(AGENT.agent_type, AGENT.speed_mps)[11][0]
    };
    let [soon, later] = [17, 300].map(|steps| network_after(500.0, steps));
    assert!(soon < 0.1 && later > 0.9, "{soon} {later}");
    let without = network_after(1.0, 17);
    for out_of_the_world in [1e7, f32::INFINITY, f32::NAN] {
        let found = network_after(out_of_the_world, 17);
        assert!((found - without).abs() < 0.05, "{out_of_the_world}: {found}, {without}");
    }
}

#[test]
fn knots_of_any_horizon_are_in_time_order() {
    assert_eq!(knots(12), [0, 2, 5, 11]);
    for horizon_len in 1..=HORIZON_MAX {
        let knots = knots(horizon_len);
        assert!(knots.is_sorted() && knots[KNOTS - 1] == horizon_len - 1, "{knots:?}");
    }
}

#[test]
fn regions_widen_where_they_miss_and_narrow_where_they_never_do() {
    let widths = |level| drive(120, 1.0, level).widths(AGENT.agent_type, AGENT.speed_mps)[11];
    assert!(widths(1.0) > 2.0 && widths(0.1) < 0.5, "{} {}", widths(1.0), widths(0.1));
}

#[test]
fn misses_at_one_speed_widen_the_regions_of_all_speeds_of_the_type_for_a_while() {
    let mut evidence = drive(40, 1.0, 1.0);
    let before = drive(0, 1.0, 1.0);
    let ratio = |evidence: &Evidence, agent_type: AgentType, speed_mps: f32| {
        evidence.widths(agent_type, speed_mps)[11] / before.widths(agent_type, speed_mps)[11]
    };
    let [own, slow] = [10.0, 0.5].map(|speed_mps| ratio(&evidence, AgentType::Vehicle, speed_mps));
    assert!(own > slow && slow > 1.2, "{own} {slow}");
    assert_eq!(ratio(&evidence, AgentType::Pedestrian, 0.8), 1.0);
    evidence.observe(40 * STEP_NS + 600_000_000_000, []);
    let [own, slow] = [10.0, 0.5].map(|speed_mps| ratio(&evidence, AgentType::Vehicle, speed_mps));
    assert!(own > 1.2 && (slow - 1.0).abs() < 1e-3, "{own} {slow}");
}

#[test]
fn what_the_correction_widened_is_no_width_that_lasts() {
    // All regions are published twice as wide as they should be. The correction at that time contains a part
    // of that factor, or nothing.
    let lasting = |corrected: bool| {
        let mut known = Evidence::new(12, STEP_NS as u64, &Prior::default());
        if corrected {
            known = drive_with(known, 40, |_| [1.0; 3], 1.0);
        }
        let of_type = &known.of_types[AGENT.agent_type.index()];
        let corrections = of_type.corrections.map(|of| of.log());
        let widths = [2.0; HORIZON_MAX];
        let path_m = [[0.0; 2]; HORIZON_MAX];
        let mixture = Mixture {
            probability: &[1.0],
            modes_m: &[path_m; MODES_MAX],
            covariances_m2: &[[[1.0, 0.0, 1.0]; HORIZON_MAX]; MODES_MAX],
            widths: &widths,
            network_m: &[path_m],
            fan: &fan(&known),
        };
        let mut kept = Kept::empty();
        kept.fill(known.knots, &mixture, &[[0.0; 2]; KNOTS], &Default::default(), &corrections);
        let due = kept.due(Context::new(AGENT.agent_type, AGENT.speed_mps), KNOTS - 1, [0.0; 2]);
        (due.factor, corrections[KNOTS - 1])
    };
    assert_eq!(lasting(false), (2.0, 0.0));
    let (factor, correction) = lasting(true);
    assert!(correction > 0.1 && (factor - 2.0 * (-correction).exp()).abs() < 1e-5, "{factor} {correction}");
}

#[test]
fn a_fan_lies_halfway_to_the_blend_or_at_it_where_that_has_been_nearer() {
    let middle = |evidence: &Evidence| {
        let fan = fan(evidence);
        let (residual_m, [x, y]) = (fan.residual_m(2, 11), fan.position_m(2, 11));
        assert!(residual_m[0].hypot(residual_m[1]) > 0.01, "{residual_m:?}");
        let [x, y] = [x - residual_m[0], y - residual_m[1]];
        assert!((x - 4.0 * y).abs() < 1e-4, "on the line from constant velocity to the blend: {x} {y}");
        x / 8.0
    };
    // Constant velocity is off by up to half of the way, to either side. The blend is right, or off by the
    // same distance to the other side.
    let [before, halfway, blend] = [(0, 1.0), (120, -1.0), (120, 0.0)].map(|(steps, of_blend)| {
        let wrong = |step: i64| (0.618 * step as f32).fract() - 0.5;
        let factors = |step| [1.0 + wrong(step), 1.0, 1.0 + of_blend * wrong(step)];
        middle(&drive_by(steps, factors, 0.5))
    });
    assert!((0.45..0.55).contains(&before) && (0.45..0.55).contains(&halfway), "{before} {halfway}");
    assert!(blend > 0.85, "{blend}");
}

#[test]
fn agents_that_keep_to_the_blend_have_a_narrow_fan() {
    let [along_m, across_m] = fan(&drive(200, 1.0, 0.5)).steps_m[11];
    assert!(along_m < 2.0 && across_m < 1.0, "{along_m} {across_m}");
}

#[test]
fn what_is_learned_is_the_same_by_its_numbers() {
    let mut evidence = drive(60, 1.5, 0.95);
    let mut numbers = vec![0.0; crate::NUMBERS_LEN];
    evidence.write_numbers(&mut numbers);
    let mut other = Evidence::new(12, STEP_NS as u64, &Prior::default());
    assert_eq!(other.resume(&numbers[1..]), Err("number of the sums"));
    assert_eq!(other.resume(&numbers), Ok(()));
    let learned = |evidence: &Evidence| {
        let (agent_type, speed_mps) = (AGENT.agent_type, AGENT.speed_mps);
        let widths = evidence.widths(agent_type, speed_mps);
        (evidence.weights(agent_type, speed_mps), widths, fan(evidence), choose(evidence))
    };
    assert_eq!(learned(&other), learned(&evidence));
    assert_eq!((other.matured_count(), other.now_ns), (evidence.matured_count(), evidence.now_ns));
    assert!(other.matured_count() > 40.0 && other.traces.is_empty());
    let mut again = vec![0.0; crate::NUMBERS_LEN];
    other.write_numbers(&mut again);
    assert!(numbers.iter().map(|n| n.to_bits()).eq(again.iter().map(|n| n.to_bits())));
    numbers[40] = f64::NAN;
    assert!(other.resume(&numbers).is_err() && other.matured_count() > 40.0);
}

#[test]
fn what_is_learned_outlasts_a_session_and_its_agents_do_not() {
    let mut evidence = drive(60, 1.5, 0.5);
    let (weights, free) = (evidence.weights(AGENT.agent_type, 10.0), evidence.free.len());
    evidence.end_session();
    assert_eq!(evidence.weights(AGENT.agent_type, 10.0), weights);
    assert!(free < MIXTURES_MAX && evidence.free.len() == MIXTURES_MAX && evidence.traces.is_empty());
    assert!(!evidence.wants(0, AGENT.id));
}

#[test]
fn a_fan_begins_with_the_pattern_of_the_nearest_speed() {
    let mut prior = Prior::default();
    for (band, along) in [(2, 1.0), (3, 3.0)] {
        prior.0[AGENT.agent_type.index()][band].pattern.points = [[[along, 0.5]; KNOTS]; MODES_MAX];
    }
    let evidence = Evidence::new(12, STEP_NS as u64, &prior);
    // The values at 6 and 11 m/s are known.
    for (speed_mps, along) in [(8.0, 1.0), (9.0, 3.0)] {
        let still = [[0.0; 2]; HORIZON_MAX];
        let fan = evidence.fan(&Agent { speed_mps, ..AGENT }, &still, &still);
        assert_eq!(fan.points[7][..12], [[along, 0.5]; 12]);
    }
}

#[test]
fn what_is_known_of_agents_that_stay_away_for_days_lasts() {
    let known = |evidence: &Evidence| {
        let fan = fan(evidence);
        (fan.steps_m[11], fan.centre_m[11], choose(evidence))
    };
    let mut evidence = drive(120, 1.0, 0.99);
    let before = known(&evidence);
    let mut pass = |minutes: std::ops::RangeInclusive<i64>| {
        for minute in minutes {
            evidence.observe(120 * STEP_NS + minute * 60_000_000_000, []);
        }
        (known(&evidence), evidence.widths(AGENT.agent_type, AGENT.speed_mps)[11])
    };
    // The correction of the widths covers the last minute.
    let (_, width) = pass(1..=60);
    let (after, width_after) = pass(61..=2 * 1440);
    assert!((width_after / width - 1.0).abs() < 1e-6, "{width_after} {width}");
    let near =
        |after: [f32; 2], before: [f32; 2]| (0..2).all(|axis| (after[axis] - before[axis]).abs() < 1e-3);
    assert!(near(after.0, before.0) && near(after.1, before.1), "{after:?} after {before:?}");
    let [after, before] =
        [after.2, before.2].map(|choice| (0..MODES_MAX).filter_map(|mode| choice.of_fan(mode)).sum::<f32>());
    assert!((after - before).abs() < 1e-3, "{after} {before}");
}

#[test]
fn time_that_does_not_pass_teaches_nothing() {
    let mut evidence = drive(40, 1.5, 0.5);
    let before = evidence.weights(AGENT.agent_type, 10.0);
    evidence.observe(39 * STEP_NS, [(AGENT.id, known([1e6, 0.0]))]);
    evidence.observe(0, [(AGENT.id, known([1e6, 0.0]))]);
    assert_eq!(evidence.weights(AGENT.agent_type, 10.0), before);
}

#[test]
fn weights_between_the_knots_are_between_theirs() {
    let evidence = drive(60, 1.2, 0.5);
    let at = evidence.between_knots(&[[0.0], [2.0], [5.0], [11.0]]);
    assert!(at.iter().enumerate().all(|(step, [value])| (value - step as f32).abs() < 1e-5), "{at:?}");
}

#[test]
fn the_sigma_points_have_the_mean_and_the_covariance_of_the_estimate() {
    for covariance_m2 in [[0.5, 0.3, 0.4], [1.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.2, -0.2, 0.2]] {
        let observed = Observed { position_m: [0.0; 2], covariance_m2 };
        let points = [0, 1, 2, 3].map(|number| observed.sigma_point([3.0, -2.0], number));
        let mean = |of: &dyn Fn(&[f32; 2]) -> f32| points.iter().map(of).sum::<f32>() / 4.0;
        let of_centre = [mean(&|[x, _]| x - 3.0), mean(&|[_, y]| y + 2.0)];
        let [xx, xy, yy] = [
            mean(&|[x, _]| (x - 3.0).powi(2)),
            mean(&|[x, y]| (x - 3.0) * (y + 2.0)),
            mean(&|[_, y]| (y + 2.0).powi(2)),
        ];
        let off = |a: f32, b: f32| (a - b).abs();
        assert!(of_centre.iter().all(|x| x.abs() < 1e-6), "{of_centre:?}");
        let seen = [xx, xy, yy];
        assert!(seen.iter().zip(covariance_m2).all(|(a, b)| off(*a, b) < 1e-5), "{seen:?} {covariance_m2:?}");
    }
}

#[test]
fn a_forecast_that_meets_an_uncertain_estimate_may_have_missed_the_truth() {
    let deviations_m = |variance_m2: f32| {
        let mut evidence = Evidence::new(12, STEP_NS as u64, &Prior::default());
        let path = [[0.0; 2]; HORIZON_MAX];
        for step in 0..200 {
            let observed = Observed { position_m: [0.0; 2], covariance_m2: [variance_m2, 0.0, 0.0] };
            evidence.observe(step * STEP_NS, [(AGENT.id, observed)]);
            let paths = Paths { velocity: path, experts: [path; EXPERTS] };
            evidence.store(step * STEP_NS, &AGENT, (&paths, &path), None);
        }
        evidence.fan(&AGENT, &path, &path).steps_m[0]
    };
    let ([sharp_m, _], [along_m, across_m]) = (deviations_m(0.0), deviations_m(0.25));
    assert!(along_m > sharp_m + 0.3 && across_m < along_m - 0.3, "{sharp_m} {along_m} {across_m}");
}
