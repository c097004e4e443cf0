//! The learned prior in closed loop: forecasts of earlier ticks are the prior of the next.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tracker::{Prior, TrackerOptions};
use wire::{AgentType, Detection, Forecast, Header, MODES_MAX, Quality, Steering, Track, flags};

use crate::support::forecaster::{Controls, HORIZON_LEN, STEP_NS, forecast, forecasts_header};
use crate::support::harness::{Harness, TICK_NS, detected_at, noise, with_heading};

const TICK_S: f64 = TICK_NS as f64 / 1e9;
const STEP_S: f64 = STEP_NS as f64 / 1e9;
/// Rear axle of a vehicle of unknown length.
const REAR_AXLE_M: f64 = 0.26 * 4.5;

fn options(prior: Prior) -> TrackerOptions {
    TrackerOptions { prior, ..TrackerOptions::default() }
}

/// The tracks of a frame, after forecasts of the previous frame.
fn step_after<'a>(run: &'a mut Harness, made: &[Forecast], detections: &[Detection]) -> &'a [Track] {
    run.prior = Some((forecasts_header(run.stamp_ns, made.len()), made.to_vec()));
    run.step(detections)
}

/// A vehicle that moves as a kinematic bicycle.
#[derive(Clone, Copy, Debug)]
struct Driven {
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
    speed_mps: f64,
    slip_rad: f64,
}

impl Driven {
    const START: Self = Self { x_m: -20.0, y_m: 5.0, heading_rad: 0.3, speed_mps: 9.0, slip_rad: 0.0 };

    fn tick(&mut self, [accel_mps2, slip_rate_radps]: [f64; 2]) {
        const PARTS: u32 = 40;
        let dt_s = TICK_S / f64::from(PARTS);
        for _ in 0..PARTS {
            let course = self.heading_rad + self.slip_rad;
            self.x_m += self.speed_mps * course.cos() * dt_s;
            self.y_m += self.speed_mps * course.sin() * dt_s;
            self.heading_rad += self.speed_mps / REAR_AXLE_M * self.slip_rad.sin() * dt_s;
            self.speed_mps += accel_mps2 * dt_s;
            self.slip_rad += slip_rate_radps * dt_s;
        }
    }

    fn detected(&self, rng: &mut ChaCha8Rng, sigma_m: f64) -> Detection {
        let place = detected_at(
            AgentType::Vehicle,
            7,
            self.x_m + noise(rng, sigma_m),
            self.y_m + noise(rng, sigma_m),
        );
        with_heading(place, self.heading_rad + noise(rng, 0.05))
    }

    fn distance_m(&self, track: &Track) -> f64 {
        (f64::from(track.x_m) - self.x_m).hypot(f64::from(track.y_m) - self.y_m)
    }
}

/// Controls from the first tick of the gap.
const MANOEUVRE: [f64; 2] = [-2.5, 0.05];
/// Ticks in which an agent is seen and its forecasts earn their weight.
const EARNING_TICKS: usize = 150;
const SEEN_TICKS: usize = EARNING_TICKS + 25;
const HIDDEN_TICKS: usize = 20;

/// Controls of the forecast vehicle at a time in ticks. It alternately accelerates and brakes, continues
/// unchanged, and then brakes and turns.
fn driven(tick: f64) -> [f64; 2] {
    match tick {
        tick if tick >= SEEN_TICKS as f64 => MANOEUVRE,
        tick if tick >= EARNING_TICKS as f64 => [0.0; 2],
        tick if tick % 50.0 < 25.0 => [2.0, 0.0],
        _ => [-2.0, 0.0],
    }
}

/// Error of a track after 1.6 s in which the vehicle is hidden, brakes and turns, as forecast.
fn error_after_gap_m(prior: Prior, seed: u64) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut run = Harness::new(options(prior), 0);
    let (mut truth, mut made) = (Driven::START, Vec::new());
    for tick in 0..SEEN_TICKS + HIDDEN_TICKS {
        let is_seen = tick < SEEN_TICKS;
        truth.tick(driven(tick as f64));
        let detections: Vec<Detection> = is_seen.then(|| truth.detected(&mut rng, 0.1)).into_iter().collect();
        let tracks = step_after(&mut run, &made, &detections);
        // The first mode has the true controls, the second has none.
        let step = |k: usize| driven(tick as f64 + (k as f64 + 0.5) * STEP_NS as f64 / TICK_NS as f64);
        let knowing: Controls = std::array::from_fn(step);
        made = tracks
            .iter()
            .map(|track| {
                forecast(track, Steering::Bicycle, &[(0.9, knowing), (0.1, [[0.0; 2]; HORIZON_LEN])])
            })
            .collect();
    }
    let track = run.published().first().expect("a track that coasts");
    let expected = if prior == Prior::Learned { Quality::Held } else { Quality::Kinematic };
    assert_eq!(track.prior, expected as u32);
    truth.distance_m(track)
}

#[test]
fn a_forecast_manoeuvre_is_tracked_through_a_gap() {
    let mean_m = |prior| (0..20).map(|seed| error_after_gap_m(prior, seed)).sum::<f64>() / 20.0;
    let (kinematic_m, learned_m) = (mean_m(Prior::Kinematic), mean_m(Prior::Learned));
    println!("after 1.6 s: kinematic {kinematic_m:.2} m, learned {learned_m:.2} m");
    assert!(learned_m < 0.8 * kinematic_m, "learned {learned_m:.2} m, kinematic {kinematic_m:.2} m");
}

/// Controls of a network that treats its history as exact. It infers the slip from the newest headings and
/// removes it.
fn straightening(track: &Track) -> Controls {
    let headings = track.history.map(|state| f64::from(state.heading_rad));
    let [.., oldest, older, newest] = headings;
    let turn_rate = |from: f64, to: f64| filters::wrapped(to - from) / STEP_S;
    let turn_radps = 1.5 * turn_rate(older, newest) - 0.5 * turn_rate(oldest, older);
    let slip_rad = (REAR_AXLE_M * turn_radps / f64::from(track.speed_mps)).clamp(-0.45, 0.45).asin();
    let mut controls = [[0.0; 2]; HORIZON_LEN];
    controls[0][1] = -slip_rad / STEP_S;
    controls
}

/// Error of the track of a vehicle that goes straight. Only positions are measured, and then it is hidden for
/// 1.6 s.
fn straight_on_error_m(options: TrackerOptions, sigma_m: f64, seed: u64) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut run = Harness::new(options, 0);
    let (mut truth, mut made) = (Driven::START, Vec::new());
    for tick in 0..SEEN_TICKS + HIDDEN_TICKS {
        truth.tick([0.0; 2]);
        let [x_m, y_m] = [truth.x_m, truth.y_m].map(|at_m| at_m + noise(&mut rng, sigma_m));
        let place = Detection { sigma_m: sigma_m as f32, ..detected_at(AgentType::Vehicle, 7, x_m, y_m) };
        let detections: Vec<Detection> = (tick < SEEN_TICKS).then_some(place).into_iter().collect();
        made = step_after(&mut run, &made, &detections)
            .iter()
            .map(|track| forecast(track, Steering::Bicycle, &[(1.0, straightening(track))]))
            .collect();
    }
    truth.distance_m(run.published().first().expect("a track that coasts"))
}

#[test]
fn controls_that_undo_noise_are_not_followed() {
    let rms_m = |prior| {
        let squares = (0..100).map(|seed| straight_on_error_m(options(prior), 0.3, seed).powi(2));
        (squares.sum::<f64>() / 100.0).sqrt()
    };
    let (kinematic_m, learned_m) = (rms_m(Prior::Kinematic), rms_m(Prior::Learned));
    println!("after 1.6 s: kinematic {kinematic_m:.2} m, learned {learned_m:.2} m");
    assert!(learned_m < kinematic_m, "learned {learned_m:.2} m, kinematic {kinematic_m:.2} m");
}

/// Error of the track of a pedestrian that turns left while it is hidden.
fn pedestrian_error_m(prior: Prior) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut run = Harness::new(options(prior), 0);
    let (mut x_m, mut y_m, mut made) = (0.0, 0.0, Vec::new());
    // It walks in a wave, straight on, and then to the left.
    let course = |tick: f64| match tick {
        tick if tick >= SEEN_TICKS as f64 => 0.1 * (tick - SEEN_TICKS as f64),
        tick if tick >= EARNING_TICKS as f64 => 0.0,
        tick => 0.6 * (tick * std::f64::consts::TAU / 50.0).sin(),
    };
    for tick in 0..SEEN_TICKS + HIDDEN_TICKS {
        let is_seen = tick < SEEN_TICKS;
        let (sin, cos) = course(tick as f64).sin_cos();
        x_m += 1.4 * TICK_S * cos;
        y_m += 1.4 * TICK_S * sin;
        let place =
            detected_at(AgentType::Pedestrian, 1, x_m + noise(&mut rng, 0.05), y_m + noise(&mut rng, 0.05));
        let detections: Vec<Detection> = is_seen.then_some(place).into_iter().collect();
        let tracks = step_after(&mut run, &made, &detections);
        let step = |k: usize| {
            let (then_sin, then_cos) = course(tick as f64 + (k as f64 + 0.5) * STEP_S / TICK_S).sin_cos();
            [1.4 * STEP_S * (then_cos - cos), 1.4 * STEP_S * (then_sin - sin)]
        };
        let turning: Controls = std::array::from_fn(step);
        made =
            tracks.iter().map(|track| forecast(track, Steering::Displacement, &[(1.0, turning)])).collect();
        for forecast in &mut made {
            forecast.frame_heading_rad = 0.0;
        }
    }
    let track = run.published().first().expect("a track that coasts");
    (f64::from(track.x_m) - x_m).hypot(f64::from(track.y_m) - y_m)
}

/// Number of ticks in which forecasts are right. Later forecasts are the opposite.
const RIGHT_TICKS: usize = 130;
const TICKS: usize = 200;

/// The process model's weight, tick by tick, for a vehicle that alternately accelerates and brakes.
fn kinematic_weights() -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut run = Harness::new(options(Prior::Learned), 0);
    let (mut truth, mut made) = (Driven::START, Vec::new());
    let mut weights = vec![1.0; TICKS];
    let acceleration_mps2 = |tick: f64| if tick % 50.0 < 25.0 { 2.5 } else { -2.5 };
    for (tick, weight) in weights.iter_mut().enumerate() {
        truth.tick([acceleration_mps2(tick as f64), 0.0]);
        let detection = truth.detected(&mut rng, 0.1);
        let tracks = step_after(&mut run, &made, &[detection]);
        if let [track] = tracks {
            *weight = track.prior_weights[MODES_MAX];
        }
        let sign = if tick < RIGHT_TICKS { 1.0 } else { -1.0 };
        let middle = |k: usize| tick as f64 + (k as f64 + 0.5) * STEP_S / TICK_S;
        let controls: Controls = std::array::from_fn(|k| [sign * acceleration_mps2(middle(k)), 0.0]);
        made = tracks.iter().map(|track| forecast(track, Steering::Bicycle, &[(1.0, controls)])).collect();
    }
    weights
}

#[test]
fn forecasts_earn_their_weight_and_lose_it_about_a_second_after_they_fail() {
    let weights = kinematic_weights();
    let after_s = |time_s: f64| weights[RIGHT_TICKS + (time_s / TICK_S) as usize];
    let [right, soon, later] = [0.0, 1.2, 4.0].map(after_s);
    println!("process model: {right:.2} while forecasts are right, then {soon:.2} and {later:.2}");
    assert!(right < 0.35 && soon > 0.5 && later > 0.7, "{weights:?}");
}

#[test]
fn displacements_move_pedestrians_through_a_gap() {
    let (kinematic_m, learned_m) = (pedestrian_error_m(Prior::Kinematic), pedestrian_error_m(Prior::Learned));
    println!("a pedestrian after 1.6 s: kinematic {kinematic_m:.2} m, learned {learned_m:.2} m");
    assert!(learned_m < 0.6 * kinematic_m, "learned {learned_m:.2} m, kinematic {kinematic_m:.2} m");
}

/// One vehicle, detected at every tick. `at_hand` makes the prior of a tick from the forecasts of the
/// previous tick.
fn drive(
    options: TrackerOptions,
    ticks: usize,
    mut at_hand: impl FnMut(usize, Header, Vec<Forecast>) -> Option<(Header, Vec<Forecast>)>,
    mut show: impl FnMut(usize, &Track, usize),
) {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut run = Harness::new(options, 0);
    let (mut truth, mut made) = (Driven::START, Vec::new());
    for tick in 0..ticks {
        truth.tick([1.0, 0.0]);
        let detection = truth.detected(&mut rng, 0.1);
        run.prior = at_hand(tick, forecasts_header(run.stamp_ns, made.len()), made);
        let tracked = run.try_step(&[detection]).expect("a good frame");
        if let Some(track) = run.published().first() {
            show(tick, track, tracked.refused_count);
        }
        let modes = [(0.4, [[1.0, 0.0]; HORIZON_LEN]), (0.6, [[-3.0, 0.0]; HORIZON_LEN])];
        made = run.published().iter().map(|track| forecast(track, Steering::Bicycle, &modes)).collect();
    }
}

#[test]
fn tracks_report_the_prior_that_moved_them() {
    let mut reported = Vec::new();
    drive(options(Prior::Learned), 120, |tick, header, made| (tick < 50).then_some((header, made)), {
        |tick, track, refused_count| {
            assert_eq!(refused_count, 0);
            let sum: f32 = track.prior_weights.iter().sum();
            assert!((sum - 1.0).abs() < 1e-5, "weights sum to {sum}");
            assert!(track.prior_weights[2..MODES_MAX].iter().all(|&weight| weight == 0.0));
            reported.push((tick, track.prior, track.prior_age_ns, track.prior_weights));
        }
    });
    let of = |quality: Quality| reported.iter().filter(move |track| track.1 == quality as u32);
    let last_learned = of(Quality::Learned).next_back().expect("forecasts are taken");
    let last_held = of(Quality::Held).next_back().expect("the last forecast is held");
    // Adopted once per step, then held until the end of its horizon.
    assert!(last_learned.2 <= STEP_NS + TICK_NS as u64 && last_held.2 > 4_500_000_000, "{last_held:?}");
    assert!(reported.windows(2).all(|pair| pair[1].2 <= pair[0].2 + TICK_NS as u64));
    let last = reported.last().expect("tracks");
    assert_eq!((last.1, last.2, last.3[MODES_MAX]), (Quality::Kinematic as u32, 0, 1.0));
    // The vehicle accelerates. The mode that brakes loses, although it was more probable.
    let later = reported.iter().find(|track| track.0 == 65).expect("a track");
    let [before, after] = [last_learned, later].map(|track| track.3[1] / track.3[0]);
    assert!(before > 0.1 && after < 0.1 * before, "{last_learned:?}, {later:?}");
    assert!(of(Quality::Kinematic).all(|track| track.0 < 10 || track.0 > 105));
}

/// A change that makes a forecast, or the header of its frame, invalid.
type Spoil = fn(&mut Header, &mut Forecast);

/// The faults of a forecast, and whether each counts as refused.
fn faults() -> Vec<(&'static str, bool, Spoil)> {
    vec![
        ("of another track", false, |_, forecast| forecast.id += 1),
        ("of another type", false, |_, forecast| forecast.agent_type = AgentType::Cyclist as u32),
        ("kinematic itself", false, |_, forecast| forecast.steering = Steering::None as u32),
        ("by displacements", false, |_, forecast| forecast.steering = Steering::Displacement as u32),
        ("of a time to come", false, |header, _| header.stamp_ns += 10 * TICK_NS),
        ("of a run that has not begun", false, |header, _| header.flags |= flags::WARM_UP),
        ("of no known controls", true, |_, forecast| forecast.steering = 9),
        ("past its horizon", true, |_, forecast| forecast.age_ns = STEP_NS * HORIZON_LEN as u64),
        ("not finite", true, |_, forecast| forecast.controls[1][11].mean[0] = f32::NAN),
        ("impossible", true, |_, forecast| forecast.controls[0][3].mean[1] = 1e9),
        ("without modes", true, |_, forecast| forecast.modes_len = 0),
        ("of too many modes", true, |_, forecast| forecast.modes_len = MODES_MAX as u32 + 1),
        ("improbable", true, |_, forecast| forecast.probability = [0.0; MODES_MAX]),
        ("of negative probability", true, |_, forecast| forecast.probability[1] = -0.6),
        ("without spacing", true, |header, _| header.step_ns = 0),
        ("without steps", true, |header, _| header.counts.horizon_len = 0),
        ("of too many steps", true, |header, _| header.counts.horizon_len = 99),
        ("of another schema", true, |header, _| header.schema += 1),
    ]
}

#[test]
fn an_unusable_forecast_leaves_the_process_model() {
    let alone = |prior: Prior, spoil: Spoil| {
        let (mut tracks, mut refused_count) = (Vec::new(), 0);
        drive(
            options(prior),
            110,
            |_, mut header, mut made| {
                made.iter_mut().for_each(|forecast| spoil(&mut header, forecast));
                Some((header, made))
            },
            |_, track, refused| {
                tracks.push(*track);
                refused_count += refused;
            },
        );
        (tracks, refused_count)
    };
    let (kinematic, _) = alone(Prior::Kinematic, |_, _| ());
    let (good, _) = alone(Prior::Learned, |_, _| ());
    assert_ne!(good, kinematic);
    for (name, counts, spoil) in faults() {
        let (tracks, refused_count) = alone(Prior::Learned, spoil);
        assert!(tracks == kinematic, "a forecast {name}");
        assert_eq!(refused_count > 30, counts, "a forecast {name}: {refused_count} refused");
    }
}

#[test]
fn the_order_of_forecasts_changes_no_bit() {
    let crowd = |reverse: bool| {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut run = Harness::new(options(Prior::Learned), 0);
        let mut all: Vec<Track> = Vec::new();
        let mut made: Vec<Forecast> = Vec::new();
        for tick in 0..60 {
            let detections: Vec<Detection> = (0..12_u32)
                .filter(|i| !(tick + i).is_multiple_of(7))
                .map(|i| {
                    let x_m = f64::from(tick) * 0.5 + noise(&mut rng, 0.1);
                    with_heading(
                        detected_at(AgentType::Vehicle, 0, x_m, f64::from(i) * 6.0),
                        noise(&mut rng, 0.05),
                    )
                })
                .collect();
            if reverse {
                made.reverse();
            }
            let tracks = step_after(&mut run, &made, &detections);
            all.extend(tracks);
            let modes = [(0.5, [[2.0, 0.0]; HORIZON_LEN]), (0.5, [[0.0, 0.1]; HORIZON_LEN])];
            made = tracks.iter().map(|track| forecast(track, Steering::Bicycle, &modes)).collect();
        }
        all
    };
    let forwards = crowd(false);
    assert!(forwards.iter().filter(|track| track.prior == Quality::Learned as u32).count() > 300);
    assert_eq!(forwards, crowd(false));
    assert_eq!(forwards, crowd(true));
}

/// The detector flips the first headings. The track flips and drops forecasts of the old front.
#[test]
fn a_flipped_track_adopts_only_forecasts_of_its_new_front() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut run = Harness::new(options(Prior::Learned), 0);
    let (mut truth, mut made, mut late) = (Driven::START, Vec::new(), Vec::new());
    let (mut flipped, mut learned_since) = (None, 0);
    for tick in 0..150 {
        truth.tick([0.0; 2]);
        let mut detection = truth.detected(&mut rng, 0.05);
        if tick < 20 {
            detection.heading_rad =
                filters::wrapped(f64::from(detection.heading_rad) + std::f64::consts::PI) as f32;
        }
        // Forecasts arrive one tick later.
        let stamp_ns = run.stamp_ns - TICK_NS;
        let prior = (forecasts_header(stamp_ns, Vec::len(&late)), std::mem::replace(&mut late, made));
        run.prior = Some(prior);
        run.step(&[detection]);
        let track = run.published().first();
        made = track
            .map(|track| forecast(track, Steering::Bicycle, &[(1.0, [[0.0; 2]; HORIZON_LEN])]))
            .into_iter()
            .collect();
        let Some(track) = track else { continue };
        assert!(tick < 20 || truth.distance_m(track) < 0.5, "tick {tick}: {} m", truth.distance_m(track));
        if track.speed_mps > 0.0 && tick >= 20 {
            let first = *flipped.get_or_insert(tick);
            let learned = track.prior == Quality::Learned as u32;
            assert!(tick != first || !learned, "tick {tick}: the prior is a forecast of the old front");
            learned_since += usize::from(learned);
        }
    }
    assert!(flipped.is_some() && learned_since > 80, "{flipped:?}, {learned_since}");
}
