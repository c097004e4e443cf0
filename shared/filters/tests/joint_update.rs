//! Compares joint updates with updates by each observation alone. At most one of several observations belongs
//! to the agent.

use association::Candidate;
use association::jpda::{Associator, Share};
use filters::{
    Bicycle, ControlStep, Controlled, Filter, FilterFault, Forecast, Gaussian, Mixture, Models,
    OBSERVATIONS_MAX, Observation, Priors, Process, difference, moments,
};
use nalgebra::{Matrix2, Matrix2x4, Vector2};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::support::bicycle::BICYCLE;
use crate::support::state::{PEDESTRIAN, at, is_sound};

fn pedestrian() -> Gaussian<4> {
    let mut state = Gaussian::new([1.0, 2.0, 0.5, -0.3], [0.3, 0.2, 0.5, 0.4]);
    state.predict(160_000_000, &PEDESTRIAN).expect("a finite state");
    state
}

fn vehicle() -> Gaussian<5> {
    let mut state = Gaussian::new([1.0, 2.0, 3.1, 6.0, 0.02], [0.3, 0.2, 0.2, 1.0, 0.01]);
    state.predict(80_000_000, &BICYCLE).expect("a finite state");
    state
}

fn assert_near<const N: usize>(found: &Gaussian<N>, expected: &Gaussian<N>) {
    let off = (found.mean - expected.mean).amax().max((found.covariance - expected.covariance).amax());
    assert!(off < 1e-9, "{off:e}: {found:?} instead of {expected:?}");
}

/// The formulas of the probabilistic data association filter.
#[test]
fn equal_noise_gives_the_textbook_pda_update() {
    let prior = pedestrian();
    let observed = [(0.5, at(1.3, 2.2, 0.3)), (0.2, at(0.6, 1.5, 0.3)), (0.1, at(2.0, 2.0, 0.3))];
    let missed = 0.2;
    let pick = Matrix2x4::identity();
    let spread: Matrix2<f64> = pick * prior.covariance * pick.transpose() + Matrix2::identity() * 0.09;
    let gain = prior.covariance * pick.transpose() * spread.try_inverse().unwrap();
    let innovation =
        |o: &Observation| Vector2::from(o.position_m) - prior.mean.fixed_rows::<2>(0).into_owned();
    let combined: Vector2<f64> = observed.iter().map(|(beta, o)| innovation(o) * *beta).sum();
    let squares: Matrix2<f64> =
        observed.iter().map(|(beta, o)| innovation(o) * innovation(o).transpose() * *beta).sum();
    let certain = prior.covariance - gain * spread * gain.transpose();
    let expected = Gaussian {
        mean: prior.mean + gain * combined,
        covariance: prior.covariance * missed
            + certain * (1.0 - missed)
            + gain * (squares - combined * combined.transpose()) * gain.transpose(),
    };
    let mut found = prior;
    found.update_jointly(&observed, &PEDESTRIAN).unwrap();
    assert_near(&found, &expected);
}

/// Headings near π, and values that only some of the observations have.
#[test]
fn update_has_the_moments_of_all_posteriors() {
    let prior = vehicle();
    let observed = [
        (0.3, Observation { heading_rad: Some((-3.1, 0.02)), ..at(0.6, 2.1, 0.2) }),
        (0.25, Observation { speed_mps: Some((5.0, 0.25)), ..at(0.3, 1.8, 0.4) }),
        (
            0.2,
            Observation { heading_rad: Some((3.0, 0.1)), speed_mps: Some((8.0, 0.5)), ..at(0.5, 2.4, 0.3) },
        ),
        (0.05, at(0.0, 2.0, 1.0)),
    ];
    let mut posteriors = vec![(0.2, prior)];
    for (probability, observed) in &observed {
        let mut posterior = prior;
        posterior.update(observed, &BICYCLE).unwrap();
        posteriors.push((*probability, posterior));
    }
    let expected = moments(posteriors.iter().map(|(weight, state)| (*weight, state)), Bicycle::ANGLES);
    let mut found = Filter::Bicycle(prior);
    found.update_jointly(&observed, &models()).unwrap();
    let Filter::Bicycle(found) = found else { panic!("another kind: {found:?}") };
    assert_near(&found, &expected);
    assert!(found.mean[2].abs() > 3.0, "the mean of headings about π: {}", found.mean[2]);
    assert!(is_sound(&found));
}

fn models() -> Models {
    Models { constant_velocity: PEDESTRIAN, bicycle: BICYCLE }
}

#[test]
fn one_certain_observation_is_a_plain_update_to_the_bit() {
    let observed = Observation { heading_rad: Some((-3.1, 0.02)), ..at(0.6, 2.1, 0.2) };
    let (mut plain, mut joint) = (vehicle(), vehicle());
    plain.update(&observed, &BICYCLE).unwrap();
    joint.update_jointly(&[(1.0, observed)], &BICYCLE).unwrap();
    assert_eq!(joint, plain);
    let (mut plain, mut joint) = (mixture(), mixture());
    plain.update(&observed).unwrap();
    joint.update_jointly(&[(1.0, observed)]).unwrap();
    assert_eq!(joint.moments(), plain.moments());
    // A second observation of probability 0 changes only the rounding.
    let mut beside = vehicle();
    beside.update_jointly(&[(1.0, observed), (0.0, at(9.0, 9.0, 0.1))], &BICYCLE).unwrap();
    let mut plain = vehicle();
    plain.update(&observed, &BICYCLE).unwrap();
    assert_near(&beside, &plain);
}

#[test]
fn an_update_without_observations_changes_nothing() {
    let mut joint = vehicle();
    joint.update_jointly(&[], &BICYCLE).unwrap();
    assert_eq!(joint, vehicle());
    let mut joint = mixture();
    joint.update_jointly(&[]).unwrap();
    assert_eq!(joint.moments(), mixture().moments());
}

#[test]
fn a_failed_observation_leaves_the_state() {
    let observed = [(0.4, at(0.6, 2.1, 0.2)), (0.3, at(0.6, 2.1, f64::NAN))];
    let mut joint = vehicle();
    assert_eq!(joint.update_jointly(&observed, &BICYCLE), Err(FilterFault::NotPositive));
    assert_eq!(joint, vehicle());
    let mut joint = mixture();
    assert_eq!(joint.update_jointly(&observed), Err(FilterFault::NotPositive));
    assert_eq!(joint.moments(), mixture().moments());
}

/// A mixture of four hypotheses with different controls, and the kinematic component.
#[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
fn mixture_of<P: Controlled<N> + Copy, const N: usize>(process: P, start: Gaussian<N>) -> Mixture<P, N> {
    let priors = Priors { kinematic_weight: 0.2, ..Priors::new(process, process) };
    let mut mixture = Mixture::new(start, priors, 3);
    let controls = [[2.0, 0.1], [2.0, -0.1], [-2.0, 0.1], [-2.0, -0.1]];
    let controls = controls.map(|mean| ControlStep { mean, cholesky: [0.3, 0.0, 0.02] });
    let forecast = Forecast {
        age_ns: 0,
        step_ns: 400_000_000,
        heading_rad: 0.0,
        probability: &[0.4, 0.3, 0.2, 0.1],
        controls: &controls,
    };
    mixture.adopt(&forecast).unwrap();
    mixture.predict(320_000_000).unwrap();
    mixture
}

fn mixture() -> Mixture<Bicycle, 5> {
    mixture_of(BICYCLE, vehicle())
}

/// The moments of a mixture after a joint update, and the moments expected from its updates by each
/// observation. Also asserts the weights.
#[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
fn jointly<P: Controlled<N> + Copy, const N: usize>(
    prior: &Mixture<P, N>,
    observed: &[(f64, Observation)],
) -> (Gaussian<N>, Gaussian<N>) {
    let missed = 1.0 - observed.iter().map(|(probability, _)| probability).sum::<f64>();
    let mut of_each = vec![(missed, prior.clone())];
    for (probability, observed) in observed {
        let mut updated = prior.clone();
        updated.update(observed).unwrap();
        of_each.push((*probability, updated));
    }
    let mut found = prior.clone();
    found.update_jointly(observed).unwrap();
    assert_eq!(found.components().count(), 5);
    for (component, (number, weight, state)) in found.components().enumerate() {
        let expected: f64 =
            of_each.iter().map(|(share, one)| share * one.components().nth(component).unwrap().1).sum();
        assert!((weight - expected).abs() < 1e-12, "{number:?}: {weight} instead of {expected}");
        assert!(is_sound(state));
    }
    let each: Vec<(f64, Gaussian<N>)> =
        of_each.iter().map(|(share, mixture)| (*share, mixture.moments())).collect();
    (found.moments(), moments(each.iter().map(|(share, state)| (*share, state)), P::ANGLES))
}

#[test]
fn mixture_has_the_moments_of_its_updates() {
    let observed = [(0.4, at(1.0, 2.2, 0.5)), (0.25, at(1.2, 1.7, 0.7)), (0.05, at(0.9, 2.0, 0.8))];
    let (found, expected) = jointly(&mixture_of(PEDESTRIAN, pedestrian()), &observed);
    assert_near(&found, &expected);
    let observed = [
        (0.4, Observation { heading_rad: Some((3.1, 0.05)), ..at(-0.8, 2.2, 0.5) }),
        (0.25, at(-1.2, 1.7, 0.7)),
        (0.05, Observation { speed_mps: Some((5.0, 1.0)), ..at(-0.9, 2.0, 0.8) }),
    ];
    // A circular mean of circular means differs slightly from the circular mean of all points at once.
    let (found, expected) = jointly(&mixture(), &observed);
    let off = (found.covariance - expected.covariance).amax();
    assert!(difference(&found.mean, &expected.mean, Bicycle::ANGLES).amax() < 1e-6 && off < 1e-5, "{off:e}");
}

/// Two pedestrians, three detections. All joint events are enumerated here.
#[test]
fn two_agents_have_the_moments_of_all_joint_events() {
    let mut second = pedestrian();
    second.mean += nalgebra::Vector4::new(0.7, -0.2, -0.8, 0.4);
    let priors = [pedestrian(), second];
    let detections = [at(1.2, 1.8, 0.3), at(1.6, 2.0, 0.3), at(1.5, 1.5, 0.3)];
    let (detected, clutter) = (0.8_f64, 0.1_f64);
    let update = |track: usize, option: Option<usize>| -> (f64, Gaussian<4>) {
        let mut posterior = priors[track];
        let Some(d) = option else { return (1.0 - detected, posterior) };
        let evidence = posterior.update(&detections[d], &PEDESTRIAN).unwrap();
        (detected * evidence.log_likelihood.exp() / clutter, posterior)
    };
    let options = [None, Some(0), Some(1), Some(2)];
    let events = || options.into_iter().flat_map(|a| options.map(|b| [a, b]));
    let events: Vec<[Option<usize>; 2]> = events().filter(|[a, b]| a.is_none() || a != b).collect();
    assert_eq!(events.len(), 13);
    let weight = |[a, b]: [Option<usize>; 2]| update(0, a).0 * update(1, b).0;
    let sum: f64 = events.iter().map(|&event| weight(event)).sum();

    let mut candidates = Vec::new();
    for (track, prior) in (0..).zip(&priors) {
        for (detection, observed) in (0..).zip(&detections) {
            let evidence = prior.clone().update(observed, &PEDESTRIAN).unwrap();
            candidates.push(Candidate { track, detection, cost: -2.0 * evidence.log_likelihood });
        }
    }
    let miss_cost = -2.0 * ((1.0 - detected) * clutter / detected).ln();
    let mut associator = Associator::default();
    associator.associate(&mut candidates, 2, 3, miss_cost);
    for (track, prior) in priors.iter().enumerate() {
        let posteriors: Vec<(f64, Gaussian<4>)> =
            events.iter().map(|&event| (weight(event) / sum, update(track, event[track]).1)).collect();
        let expected = moments(posteriors.iter().map(|(weight, state)| (*weight, state)), &[]);
        let mut found = *prior;
        found.update_jointly(&observations(associator.of_track(track), &detections), &PEDESTRIAN).unwrap();
        assert_near(&found, &expected);
    }
}

fn observations(shares: &[Share], detections: &[Observation]) -> Vec<(f64, Observation)> {
    shares.iter().map(|share| (share.probability, detections[share.detection as usize])).collect()
}

/// 10,000 random updates.
#[expect(clippy::unwrap_used, reason = "a failure here is the test's")]
fn assert_stays_sound<P: Process<N>, const N: usize>(process: &P, start: Gaussian<N>) {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut state = start;
    for tick in 0..10_000 {
        state.predict(rng.random_range(0..200_000_000), process).unwrap();
        let mut rest = 1.0;
        let observed: Vec<(f64, Observation)> = (0..rng.random_range(0..=OBSERVATIONS_MAX))
            .map(|_| {
                let probability = rng.random_range(0.0..=rest);
                rest -= probability;
                let mut near = |mean: f64| mean + rng.random_range(-30.0..30.0);
                let (x, y) = (near(state.mean[0]), near(state.mean[1]));
                let sigma_m = 10_f64.powf(rng.random_range(-6.0..3.0));
                let heading_rad = rng.random_bool(0.5).then_some((rng.random_range(-4.0..4.0), 0.01));
                let speed_mps = rng.random_bool(0.5).then_some((rng.random_range(-9.0..9.0), 0.25));
                (probability, Observation { heading_rad, speed_mps, ..at(x, y, sigma_m) })
            })
            .collect();
        state.update_jointly(&observed, process).unwrap();
        assert!(is_sound(&state), "tick {tick}: {state:?}");
    }
}

#[test]
fn random_joint_updates_keep_covariances_sound() {
    assert_stays_sound(&PEDESTRIAN, pedestrian());
    assert_stays_sound(&BICYCLE, vehicle());
}
