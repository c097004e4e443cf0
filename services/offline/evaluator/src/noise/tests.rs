use data::Frame;
use wire::AgentType;

use super::*;

const AGENTS: u64 = 40;
const FRAMES: i64 = 250;
const INTERVAL_NS: i64 = 100_000_000;

/// Agents that stand still, with heading and speed.
fn standing(name: &str) -> Recording {
    let all = detection_flags::HAS_ID | detection_flags::HAS_HEADING | detection_flags::HAS_SPEED;
    let detection = |id: u64| Detection {
        id,
        x_m: 10.0 * id as f32,
        y_m: -3.0,
        heading_rad: 3.1,
        speed_mps: 2.0,
        score: 1.0,
        agent_type: AgentType::Vehicle as u32,
        flags: all,
        ..Detection::default()
    };
    let frame = |number: i64| Frame {
        stamp_ns: number * INTERVAL_NS,
        observed_types: AgentType::Vehicle.bit(),
        detections: (1..=AGENTS).map(detection).collect(),
        ..Frame::default()
    };
    Recording {
        name: name.to_owned(),
        interval_ns: INTERVAL_NS.cast_unsigned(),
        has_identities: true,
        frames: (0..FRAMES).map(frame).collect(),
        ..Recording::default()
    }
}

/// The noise of the positions, by agent, in the order of frames.
fn errors_m(noise: &Noise) -> BTreeMap<u64, Vec<[f64; 2]>> {
    let clean = standing("a");
    let mut errors: BTreeMap<u64, Vec<[f64; 2]>> = BTreeMap::new();
    for (seen, truth) in noise.applied_to(&clean).frames.iter().zip(&clean.frames) {
        for (seen, truth) in seen.detections.iter().zip(&truth.detections) {
            let error_m = [seen.x_m - truth.x_m, seen.y_m - truth.y_m].map(f64::from);
            errors.entry(truth.id).or_default().push(error_m);
        }
    }
    errors
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, len) = values.fold((0.0, 0.0), |(sum, len), value| (sum + value, len + 1.0));
    sum / len
}

/// The correlation of the noise with itself `steps` frames later.
fn correlation(errors: &BTreeMap<u64, Vec<[f64; 2]>>, steps: usize) -> f64 {
    let pairs = errors.values().flat_map(|of| of.iter().zip(&of[steps..]));
    let product = mean(pairs.flat_map(|(a, b)| [a[0] * b[0], a[1] * b[1]]));
    product / mean(errors.values().flatten().flatten().map(|error_m| error_m * error_m))
}

#[test]
fn noise_has_its_standard_deviation_and_no_bias() {
    for lag_s in [0.0, 0.3] {
        let errors = errors_m(&Noise { sigma_m: 0.2, lag_s, ..Noise::default() });
        let all = || errors.values().flatten().flatten().copied();
        let sigma_m = mean(all().map(|error_m| error_m * error_m)).sqrt();
        assert!((sigma_m - 0.2).abs() < 0.006, "lag {lag_s} s: {sigma_m} m");
        assert!(mean(all()).abs() < 0.01, "lag {lag_s} s: {} m", mean(all()));
        let both = mean(errors.values().flatten().map(|[x, y]| x * y));
        assert!(both.abs() < 0.002, "lag {lag_s} s: the axes correlate, {both} m²");
    }
}

#[test]
fn noise_is_white_without_a_lag_and_decays_with_it() {
    let white = errors_m(&Noise { sigma_m: 0.1, ..Noise::default() });
    assert!(correlation(&white, 1).abs() < 0.03, "{}", correlation(&white, 1));
    let lasting = errors_m(&Noise { sigma_m: 0.1, lag_s: 0.3, ..Noise::default() });
    for steps in [1, 3, 6] {
        let expected = (-0.1 * steps as f64 / 0.3).exp();
        let found = correlation(&lasting, steps);
        assert!((found - expected).abs() < 0.04, "{steps} frames: {found}, expected {expected}");
    }
}

#[test]
fn a_detection_has_the_same_noise_in_any_company() {
    let noise = Noise { sigma_m: 0.1, lag_s: 0.3, heading_rad: 0.1, seed: 7, ..Noise::default() };
    let clean = standing("a");
    let whole = noise.applied_to(&clean);
    assert_eq!(whole, noise.applied_to(&clean), "twice the same");
    let mut turned = clean.clone();
    for frame in &mut turned.frames {
        frame.detections.reverse();
        frame.detections.truncate(AGENTS as usize / 2);
    }
    for (part, whole) in noise.applied_to(&turned).frames.iter().zip(&whole.frames) {
        assert_eq!(part.detections.len(), AGENTS as usize / 2);
        assert!(part.detections.iter().all(|detection| whole.detections.contains(detection)));
    }
    let positions = |recording: &Recording| -> Vec<f32> {
        recording.frames.iter().flat_map(|frame| frame.detections.iter().map(|of| of.y_m)).collect()
    };
    let of_whole = positions(&whole);
    let other_seed = positions(&Noise { seed: 8, ..noise }.applied_to(&clean));
    let other_name = positions(&noise.applied_to(&standing("b")));
    for others in [other_seed, other_name] {
        assert!(of_whole.iter().zip(&others).filter(|(a, b)| a == b).count() < 20);
    }
}

#[test]
fn missed_detections_leave_the_noise_of_the_others() {
    let noise = Noise { sigma_m: 0.1, lag_s: 0.3, ..Noise::default() };
    let clean = standing("a");
    let whole = noise.applied_to(&clean);
    let dropped = Noise { drop_share: 0.1, ..noise }.applied_to(&clean);
    let mut kept = 0;
    for (dropped, whole) in dropped.frames.iter().zip(&whole.frames) {
        kept += dropped.detections.len();
        assert!(dropped.detections.iter().all(|detection| whole.detections.contains(detection)));
    }
    let share = 1.0 - kept as f64 / (AGENTS as i64 * FRAMES) as f64;
    assert!((share - 0.1).abs() < 0.01, "{share}");
}

#[test]
fn a_sensor_without_errors_changes_nothing() {
    let clean = standing("a");
    for noise in [Noise::default(), Noise { seed: 3, lag_s: 0.3, ..Noise::default() }] {
        assert!(noise.is_none());
        assert_eq!(noise.applied_to(&clean), clean);
    }
    let others = [
        Noise { sigma_m: 0.1, ..Noise::default() },
        Noise { heading_rad: 0.1, ..Noise::default() },
        Noise { drop_share: 0.1, ..Noise::default() },
        Noise { without_ids: true, ..Noise::default() },
        Noise { positions_only: true, ..Noise::default() },
    ];
    assert!(others.iter().all(|noise| !noise.is_none() && noise.applied_to(&clean) != clean));
}

#[test]
fn fields_are_reported_as_the_options_say() {
    let first = |noise: Noise| noise.applied_to(&standing("a")).frames[0].detections[0];
    let plain = first(Noise { sigma_m: 0.1, ..Noise::default() });
    assert_eq!((plain.id, plain.heading_rad, plain.sigma_m), (1, 3.1, 0.0));
    assert!(plain.speed_mps != 2.0 && (plain.speed_mps - 2.0).abs() < 0.6);
    let told = first(Noise { sigma_m: 0.1, reports_sigma: true, ..Noise::default() });
    assert_eq!(told, Detection { sigma_m: 0.1, ..plain });
    let bare = first(Noise { sigma_m: 0.1, positions_only: true, ..Noise::default() });
    assert_eq!(bare.flags, detection_flags::HAS_ID);
    assert_eq!([bare.x_m, bare.y_m], [plain.x_m, plain.y_m]);
    let anonymous = Noise { sigma_m: 0.1, without_ids: true, ..Noise::default() };
    assert_eq!((first(anonymous).id, first(anonymous).has(detection_flags::HAS_ID)), (0, false));
    assert!(!anonymous.applied_to(&standing("a")).has_identities);
}

#[test]
fn headings_stay_within_a_turn() {
    let noise = Noise { heading_rad: 0.2, ..Noise::default() };
    let seen = noise.applied_to(&standing("a"));
    let headings: Vec<f64> = seen
        .frames
        .iter()
        .flat_map(|frame| frame.detections.iter().map(|of| f64::from(of.heading_rad)))
        .collect();
    assert!(headings.iter().all(|heading_rad| heading_rad.abs() <= 3.15));
    assert!(headings.iter().any(|heading_rad| *heading_rad < -3.0), "3.1 rad and noise pass π");
    let squares = headings.iter().map(|heading_rad| wrapped(heading_rad - 3.1).powi(2));
    let sigma_rad = mean(squares).sqrt();
    assert!((sigma_rad - 0.2).abs() < 0.006, "{sigma_rad}");
}
