//! Forecasts of the sampler for tracks with good, bad, late and missing controls.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use bytemuck::Zeroable;
use kinematics::{DisplacementKind, MotionKind, MotionOptions};
use proptest::prelude::*;
use sampler::{Degradation, Propagation, Sampler, SamplerOptions};
use wire::{
    AGENTS_MAX, AgentControls, AgentType, Cause, ControlGaussian, Expert, Forecast, Header, HistoryState,
    Quality, Rejected, Steering, Track,
};

const STEP_NS: u64 = 400_000_000;
const DT_S: f32 = 0.4;
const TYPES: [AgentType; 3] = [AgentType::Vehicle, AgentType::Cyclist, AgentType::Pedestrian];

/// The settings without evidence, because evidence would determine blend and widths.
pub fn without_evidence() -> SamplerOptions {
    SamplerOptions { evidence: false, ..SamplerOptions::default() }
}

pub fn header(stamp_ns: i64) -> Header {
    Header { step_ns: STEP_NS, ..Header::new(1, (stamp_ns / 80_000_000) as u64, stamp_ns) }
}

/// A track that has moved straight along `heading_rad` at `speed_mps` for its whole history.
fn track(id: u64, agent_type: AgentType, position_m: [f32; 2], heading_rad: f32, speed_mps: f32) -> Track {
    let (sin, cos) = heading_rad.sin_cos();
    let mut track = Track {
        id,
        source_id: id + 100,
        agent_type: agent_type as u32,
        forecastable: 1,
        x_m: position_m[0],
        y_m: position_m[1],
        heading_rad,
        speed_mps,
        vx_mps: speed_mps * cos,
        vy_mps: speed_mps * sin,
        length_m: 4.0,
        ..Track::zeroed()
    };
    for (step, entry) in track.history.iter_mut().enumerate() {
        let back_m = speed_mps * DT_S * (7 - step) as f32;
        *entry = HistoryState {
            x_m: position_m[0] - back_m * cos,
            y_m: position_m[1] - back_m * sin,
            vx_mps: track.vx_mps,
            vy_mps: track.vy_mps,
            heading_rad,
            present: 1,
        };
    }
    track
}

fn with_covariance(mut track: Track, state_len: usize, variance: f32) -> Track {
    track.state_len = state_len as u32;
    (0..state_len).for_each(|i| track.covariance[i * state_len + i] = variance);
    track
}

/// Modes that differ in the first control component. All steps of a mode are equal.
fn controls(id: u64, agent_type: AgentType, means: &[[f32; 2]], deviation: f32) -> AgentControls {
    let step = |mean| [ControlGaussian { mean, cholesky: [deviation, 0.2 * deviation, deviation] }; 12];
    let mut controls = AgentControls { id, agent_type: agent_type as u32, ..AgentControls::zeroed() };
    controls.modes_len = means.len() as u32;
    for (mode, mean) in means.iter().enumerate() {
        controls.probability[mode] = 1.0 / means.len() as f32;
        controls.modes[mode] = step(*mean);
    }
    controls.best = step(means[0]);
    controls
}

fn learned(
    sampler: &mut Sampler,
    stamp_ns: i64,
    tracks: &[Track],
    controls: &[AgentControls],
) -> Vec<Forecast> {
    let mut out = vec![Forecast::zeroed(); tracks.len()];
    sampler.step(&header(stamp_ns), tracks, Ok(controls), &mut out).unwrap();
    out.iter().for_each(|forecast| forecast.check().unwrap());
    out
}

fn fallback(sampler: &mut Sampler, stamp_ns: i64, tracks: &[Track]) -> Vec<Forecast> {
    let mut out = vec![Forecast::zeroed(); tracks.len()];
    sampler.step(&header(stamp_ns), tracks, Err(Cause::Late), &mut out).unwrap();
    out.iter().for_each(|forecast| forecast.check().unwrap());
    out
}

#[test]
fn agents_of_which_nothing_is_said_are_left_out_and_come_back() {
    const MS: u64 = 1_000_000;
    let degradation = Degradation { held_ns: 400 * MS, kinematic_ns: Some(400 * MS) };
    let mut sampler = Sampler::new(SamplerOptions { degradation, ..without_evidence() });
    let of = |id| track(id, AgentType::Pedestrian, [id as f32, 0.0], 0.0, 1.0);
    let controls_of = |id| controls(id, AgentType::Pedestrian, &[[0.0; 2]], 0.1);
    let tracks = [of(1), of(2)];
    learned(&mut sampler, 0, &tracks, &[controls_of(1), controls_of(2)]);
    // Only the second track continues to be learned.
    let mut written = Vec::new();
    for tick in 1..=12_i64 {
        let mut out = [Forecast::zeroed(); 2];
        let header = header(tick * 80 * MS as i64);
        let len = sampler.step(&header, &tracks, Ok(&[controls_of(2)]), &mut out).unwrap();
        written.push(out[..len].iter().map(|forecast| forecast.id).collect::<Vec<_>>());
    }
    assert!(written[..10].iter().all(|ids| ids == &[1, 2]), "{written:?}");
    assert!(written[10..].iter().all(|ids| ids == &[2]), "after 0.8 s: {written:?}");
    let again = learned(&mut sampler, 2_000 * MS as i64, &tracks, &[controls_of(1), controls_of(2)]);
    assert!(again.iter().all(|forecast| forecast.quality == Quality::Learned as u32));
}

/// A new agent takes the place of the oldest held forecast, whose agent is silent in the same tick.
#[test]
fn a_silent_agent_whose_forecast_is_displaced_stays_silent() {
    let degradation = Degradation { held_ns: 400_000_000, kinematic_ns: Some(400_000_000) };
    let mut sampler = Sampler::new(SamplerOptions { degradation, ..without_evidence() });
    let of = |id: u64| track(id, AgentType::Pedestrian, [id as f32, 0.0], 0.0, 1.0);
    let controls_of = |id| controls(id, AgentType::Pedestrian, &[[0.0; 2]], 0.1);
    let all: Vec<_> = (0..AGENTS_MAX as u64).map(of).collect();
    let all_controls: Vec<_> = (0..AGENTS_MAX as u64).map(controls_of).collect();
    learned(&mut sampler, 0, &all, &all_controls);
    let (tracks, controls) = ([of(1_000), of(0), of(1)], [controls_of(1_000), controls_of(1)]);
    let mut out = [Forecast::zeroed(); 3];
    let count = sampler.step(&header(2_000_000_000), &tracks, Ok(&controls), &mut out).unwrap();
    assert_eq!(out[..count].iter().map(|forecast| forecast.id).collect::<Vec<_>>(), [1_000, 1]);
}

#[test]
fn agents_that_were_shed_are_held_and_say_so_at_the_right_age() {
    let mut sampler = Sampler::new(without_evidence());
    let of = |id| track(id, AgentType::Pedestrian, [id as f32, 0.0], 0.0, 1.0);
    let controls_of = |id| controls(id, AgentType::Pedestrian, &[[0.0; 2]], 0.1);
    let mut young = of(5);
    young.forecastable = 0;
    let tracks = [of(1), of(2), of(3), of(4), young];
    learned(&mut sampler, 0, &tracks, &[controls_of(1), controls_of(2), controls_of(3)]);
    let mut header = header(160_000_000);
    [1, 3, 4].into_iter().for_each(|place| header.mark_shed(place));
    let mut out = vec![Forecast::zeroed(); tracks.len()];
    sampler.step(&header, &tracks, Ok(&[controls_of(1)]), &mut out).unwrap();
    let expected = [
        is(Quality::Learned, Cause::None),
        is(Quality::Held, Cause::Shed),
        is(Quality::Held, Cause::Missing),
        is(Quality::Kinematic, Cause::Shed),
        is(Quality::Kinematic, Cause::Young),
    ];
    assert_eq!(out.iter().map(quality_and_cause).collect::<Vec<_>>(), expected);
    assert_eq!(
        out.iter().map(|forecast| forecast.age_ns / 1_000_000).collect::<Vec<_>>(),
        [0, 160, 160, 0, 0]
    );
    assert_eq!(out[1].causes, Cause::Shed.bit());
}

fn quality_and_cause(forecast: &Forecast) -> (u32, u32) {
    (forecast.quality, forecast.cause)
}

fn is(quality: Quality, cause: Cause) -> (u32, u32) {
    (quality as u32, cause as u32)
}

fn assert_near(found: [f32; 2], expected: [f32; 2], tolerance_m: f32, what: &str) {
    let off = (found[0] - expected[0]).hypot(found[1] - expected[1]);
    assert!(off <= tolerance_m, "{what}: {found:?}, expected {expected:?}");
}

#[test]
fn displacements_are_in_the_agent_frame() {
    let heading_rad = std::f32::consts::FRAC_PI_2;
    for agent_type in TYPES {
        let options = SamplerOptions { vehicle_motion: MotionKind::Displacement, ..without_evidence() };
        let track = track(1, agent_type, [3.0, 4.0], heading_rad, 1.5);
        let controls = controls(1, agent_type, &[[0.1, 0.05], [0.0, 0.0]], 0.1);
        let residual = &learned(&mut Sampler::new(options), 0, &[track], &[controls])[0];
        assert_eq!(quality_and_cause(residual), is(Quality::Learned, Cause::None));
        assert_eq!((residual.modes_len, residual.age_ns, residual.source_id), (2, 0, 101));
        for step in 0..12 {
            let k = (step + 1) as f32;
            // Forwards is +y, leftwards is −x.
            let expected = [3.0 - 0.05 * k, 4.0 + (1.5 * DT_S + 0.1) * k];
            assert_near(residual.modes[0][step], expected, 1e-4, "mode 0");
            assert_near(residual.best[step], expected, 1e-4, "best");
            assert_near(residual.modes[1][step], [3.0, 4.0 + 1.5 * DT_S * k], 1e-4, "constant velocity");
            let mean = [0, 1].map(|a| (residual.modes[0][step][a] + residual.modes[1][step][a]) / 2.0);
            assert_near(residual.mean[step], mean, 1e-4, "mean of the mixture");
            // Within: k displacements of variance (across) 0.01; between: a quarter of the squared distance.
            let [xx, _, yy] = residual.covariance[step];
            assert!((xx - (0.0104 * k + (0.025 * k).powi(2))).abs() < 1e-4, "{xx}");
            assert!((yy - (0.01 * k + (0.05 * k).powi(2))).abs() < 1e-4, "{yy}");
        }
        let driving = fallback(&mut Sampler::new(without_evidence()), 0, &[track]);
        assert_eq!(fallback(&mut Sampler::new(options), 0, &[track]), driving, "without a model");
        let motion = MotionOptions { displacement: DisplacementKind::Absolute, ..options.motion };
        let options = SamplerOptions { motion, ..options };
        let absolute = &learned(&mut Sampler::new(options), 0, &[track], &[controls])[0];
        assert_near(absolute.best[11], [3.0 - 0.6, 4.0 + 1.2], 1e-4, "absolute");
    }
}

#[test]
fn vehicles_obey_their_controls_within_limits() {
    let track = track(1, AgentType::Vehicle, [0.0, 0.0], 0.0, 10.0);
    let controls = controls(1, AgentType::Vehicle, &[[-0.5, 0.0], [500.0, 0.0], [0.0, 0.05]], 0.05);
    let forecast = &learned(&mut Sampler::new(without_evidence()), 0, &[track], &[controls])[0];
    let (time_s, accel_mps2) = (12.0 * DT_S, -6.0 * (0.5_f32 / 6.0).tanh());
    assert_near(
        forecast.modes[0][11],
        [10.0 * time_s + accel_mps2 * time_s * time_s / 2.0, 0.0],
        1e-2,
        "braking",
    );
    assert_near(forecast.modes[1][11], [10.0 * time_s + 6.0 * time_s * time_s / 2.0, 0.0], 1e-2, "saturated");
    assert!(forecast.modes[2][11][1] > 3.0, "slip to the left turns left: {:?}", forecast.modes[2][11]);
}

#[test]
fn a_turning_vehicle_begins_with_the_slip_of_its_turn() {
    let (speed_mps, turn_rate) = (8.0_f32, 0.4_f32);
    let radius_m = speed_mps / turn_rate;
    let mut turning = track(1, AgentType::Vehicle, [0.0, 0.0], 0.0, speed_mps);
    for (step, entry) in turning.history.iter_mut().enumerate() {
        entry.heading_rad = -turn_rate * DT_S * (7 - step) as f32;
    }
    // A circle to the left whose first direction is `course_rad`.
    let on_circle = |step: usize, course_rad: f32| {
        let angle = turn_rate * DT_S * (step + 1) as f32;
        let (x, y) = (radius_m * angle.sin(), radius_m * (1.0 - angle.cos()));
        let (sin, cos) = course_rad.sin_cos();
        [cos * x - sin * y, sin * x + cos * y]
    };
    let controls = controls(1, AgentType::Vehicle, &[[0.0, 0.0]], 0.01);
    let mut sampler = Sampler::new(without_evidence());
    let kinematic = fallback(&mut sampler, 0, &[turning])[0];
    let learned_one = learned(&mut sampler, 0, &[turning], &[controls])[0];
    let slip_rad = (0.26 * turning.length_m * turn_rate / speed_mps).asin();
    for step in 0..12 {
        assert_near(
            kinematic.best[step],
            on_circle(step, 0.0),
            0.05,
            "kinematic: the course is the observed one",
        );
        assert_near(learned_one.best[step], on_circle(step, slip_rad), 0.05, "learned: the heading is");
    }
    let motion = MotionOptions { initial_slip: false, ..MotionOptions::default() };
    let straight = SamplerOptions { motion, ..without_evidence() };
    let forecast = &learned(&mut Sampler::new(straight), 0, &[turning], &[controls])[0];
    assert_near(forecast.best[11], [speed_mps * 12.0 * DT_S, 0.0], 1e-2, "straight on");
}

#[test]
fn reversing_vehicles_go_backwards() {
    let mut reversing = track(1, AgentType::Vehicle, [0.0, 0.0], 0.0, -2.0);
    (reversing.vx_mps, reversing.vy_mps) = (-2.0, 0.0);
    let controls = controls(1, AgentType::Vehicle, &[[0.0, 0.0]], 0.01);
    let forecast = &learned(&mut Sampler::new(without_evidence()), 0, &[reversing], &[controls])[0];
    assert_near(forecast.best[11], [-2.0 * 12.0 * DT_S, 0.0], 1e-3, "backwards");
}

#[test]
fn a_forecasts_covariance_begins_at_the_tracks() {
    let certain = SamplerOptions { initial_covariance: false, ..without_evidence() };
    for agent_type in TYPES {
        for state_len in [4, 5] {
            let track = with_covariance(track(1, agent_type, [0.0; 2], 0.3, 6.0), state_len, 0.04);
            let controls = controls(1, agent_type, &[[0.0, 0.0]], 0.01);
            let trace = |options| {
                let forecast = &learned(&mut Sampler::new(options), 0, &[track], &[controls])[0];
                forecast.covariance.map(|[xx, _, yy]| xx + yy)
            };
            let (with, without) = (trace(without_evidence()), trace(certain));
            for step in 0..12 {
                assert!(
                    with[step] > without[step] + 0.08 - 1e-4,
                    "{agent_type:?} {state_len} {with:?} {without:?}"
                );
                assert!(step == 0 || with[step] > with[step - 1], "it grows: {with:?}");
            }
            // Position 2 × 0.04; the speed's 0.04 after 4.8 s, at least.
            assert!(
                with[11] - without[11] > 0.08 + 0.04 * 4.8 * 4.8 - 1e-2,
                "{agent_type:?} {state_len}: {with:?}"
            );
        }
    }
}

#[test]
fn particles_agree_with_gaussians_and_are_reproducible() {
    let tracks: Vec<_> = TYPES
        .into_iter()
        .enumerate()
        .map(|(i, t)| with_covariance(track(i as u64, t, [10.0 * i as f32, 0.0], 0.3, 5.0), 5, 0.0))
        .collect();
    let controls: Vec<_> = TYPES
        .into_iter()
        .enumerate()
        .map(|(i, t)| controls(i as u64, t, &[[0.05, 0.0]; 20], if i == 0 { 0.004 } else { 0.1 }))
        .collect();
    let run = |propagation, seed| {
        let options = SamplerOptions { propagation, seed, ..without_evidence() };
        learned(&mut Sampler::new(options), 800_000_000, &tracks, &controls)
    };
    let particles = Propagation::MonteCarlo { particles: 32 };
    let (gaussian, drawn) = (run(Propagation::Linearised, 3), run(particles, 3));
    assert_eq!(drawn, run(particles, 3));
    assert_ne!(drawn, run(particles, 4));
    for (g, d) in gaussian.iter().zip(&drawn) {
        assert_eq!(g.best, d.best);
        let scale = g.covariance[11][0] + g.covariance[11][2];
        assert_near(d.mean[11], g.mean[11], 0.2 * scale.sqrt(), "mean of 640 particles");
        for entry in 0..3 {
            let off = (g.covariance[11][entry] - d.covariance[11][entry]).abs();
            assert!(off < 0.15 * scale, "{:?} {:?}", g.covariance[11], d.covariance[11]);
        }
    }
}

#[test]
fn a_held_forecast_begins_at_the_agents_present_position() {
    let mut sampler = Sampler::new(without_evidence());
    let start = track(1, AgentType::Pedestrian, [0.0, 0.0], 0.0, 1.0);
    let controls = controls(1, AgentType::Pedestrian, &[[0.1, 0.0], [0.0, 0.1]], 0.05);
    let first = learned(&mut sampler, 0, &[start], &[controls])[0];
    let within = first.covariance[0][2] - 0.05_f32.powi(2);
    // 0.6 s later: one and a half steps; the agent is 0.2 m left of where the first mode predicted it.
    let later = track(1, AgentType::Pedestrian, [0.75, 0.2], 0.0, 1.0);
    let held = fallback(&mut sampler, 600_000_000, &[later])[0];
    assert_eq!((quality_and_cause(&held), held.age_ns), (is(Quality::Held, Cause::Late), 600_000_000));
    assert_eq!((held.modes_len, held.probability), (2, first.probability));
    assert_eq!((held.x_m, held.y_m), (0.75, 0.2));
    for step in 0..12 {
        // The modes move at constant speed, so beyond the horizon as well: 0.5 and 0.4 m a step.
        let k = (step + 1) as f32;
        assert_near(held.modes[0][step], [0.75 + 0.5 * k, 0.2], 1e-4, "first mode");
        assert_near(held.modes[1][step], [0.75 + 0.4 * k, 0.2 + 0.1 * k], 1e-4, "second mode");
        assert_near(held.best[step], held.modes[0][step], 1e-6, "best");
        let between = (0.05 * k).powi(2);
        let least = within * (k + 1.5).min(12.0) + between - 1e-4;
        assert!(held.covariance[step][2] >= least, "{step}: {:?}", held.covariance[step]);
    }
    // Without any age it is the same forecast.
    let same = fallback(&mut sampler, 0, &[start])[0];
    for step in 0..12 {
        assert_near(same.modes[1][step], first.modes[1][step], 1e-5, "same");
        assert!((same.covariance[step][0] - first.covariance[step][0]).abs() < 1e-5);
    }
}

#[test]
fn a_forecast_too_old_is_replaced_by_the_kinematic_one() {
    let mut sampler = Sampler::new(without_evidence());
    let pedestrian = track(1, AgentType::Pedestrian, [0.0, 0.0], 0.0, 1.0);
    learned(&mut sampler, 0, &[pedestrian], &[controls(1, AgentType::Pedestrian, &[[0.1, 0.0]], 0.05)]);
    let last = fallback(&mut sampler, 1_600_000_000, &[pedestrian])[0];
    assert_eq!(quality_and_cause(&last), is(Quality::Held, Cause::Late));
    let gone = fallback(&mut sampler, 1_680_000_000, &[pedestrian])[0];
    assert_eq!(
        (quality_and_cause(&gone), gone.age_ns, gone.modes_len),
        (is(Quality::Kinematic, Cause::Late), 0, 1)
    );
    // Late controls renew the held forecast, but never replace a newer one.
    learned(
        &mut sampler,
        800_000_000,
        &[pedestrian],
        &[controls(1, AgentType::Pedestrian, &[[0.2, 0.0]], 0.05)],
    );
    learned(
        &mut sampler,
        400_000_000,
        &[pedestrian],
        &[controls(1, AgentType::Pedestrian, &[[0.9, 0.0]], 0.05)],
    );
    let renewed = fallback(&mut sampler, 1_680_000_000, &[pedestrian])[0];
    assert_eq!((quality_and_cause(&renewed), renewed.age_ns), (is(Quality::Held, Cause::Late), 880_000_000));
    assert_near(renewed.best[0], [0.6, 0.0], 1e-4, "the newer one");
}

#[test]
fn kinematic_forecasts_go_straight_on_with_growing_covariance() {
    let mut sampler = Sampler::new(without_evidence());
    for agent_type in TYPES {
        let young = Track { forecastable: 0, ..track(1, agent_type, [5.0, -3.0], 2.0, 4.0) };
        let forecast = fallback(&mut sampler, 0, &[young])[0];
        assert_eq!(quality_and_cause(&forecast), is(Quality::Kinematic, Cause::Young));
        assert_eq!((forecast.modes_len, forecast.probability[0]), (1, 1.0));
        for step in 0..12 {
            let travelled_m = 4.0 * DT_S * (step + 1) as f32;
            let expected = [5.0 + travelled_m * 2.0_f32.cos(), -3.0 + travelled_m * 2.0_f32.sin()];
            assert_near(forecast.mean[step], expected, 1e-3, "straight");
            assert_eq!(
                (forecast.mean[step], forecast.best[step]),
                (forecast.modes[0][step], forecast.modes[0][step])
            );
            let trace = |step: usize| forecast.covariance[step][0] + forecast.covariance[step][2];
            assert!(step == 0 || trace(step) > trace(step - 1), "{agent_type:?} at {step}");
        }
    }
}

#[test]
fn one_agents_bad_controls_leave_the_others_alone() {
    let tracks: Vec<_> =
        (0..6).map(|id| track(id, TYPES[id as usize % 3], [10.0 * id as f32, 0.0], 0.0, 2.0)).collect();
    let good: Vec<_> =
        (0..6).map(|id| controls(id, TYPES[id as usize % 3], &[[0.1, 0.0]; 20], 0.05)).collect();
    let expected = learned(&mut Sampler::new(without_evidence()), 0, &tracks, &good);
    let mut bad = good.clone();
    bad[0].modes[19][11].mean[1] = f32::NAN;
    bad[1].modes[0][0].cholesky[0] = f32::INFINITY;
    bad[2].probability = [-0.05; 20];
    bad[4].modes[3] = [ControlGaussian { mean: [1e6, 0.0], cholesky: [0.0; 3] }; 12];
    bad.remove(3);
    bad.reverse();
    bad.push(controls(99, AgentType::Vehicle, &[[0.0, 0.0]], 0.1));
    let mut sampler = Sampler::new(without_evidence());
    let found = learned(&mut sampler, 0, &tracks, &bad);
    let causes: Vec<_> = found.iter().map(quality_and_cause).collect();
    let refused = is(Quality::Kinematic, Cause::Rejected);
    let missing = is(Quality::Kinematic, Cause::Missing);
    let fine = is(Quality::Learned, Cause::None);
    assert_eq!(causes, [refused, refused, refused, missing, refused, fine]);
    assert_eq!(found[5], expected[5]);
    // Once there is a learned forecast, it is held for the refused ones.
    learned(&mut sampler, 80_000_000, &tracks, &good);
    let found = learned(&mut sampler, 160_000_000, &tracks, &bad);
    assert_eq!(quality_and_cause(&found[0]), is(Quality::Held, Cause::Rejected));
    assert_eq!(quality_and_cause(&found[3]), is(Quality::Held, Cause::Missing));
}

#[test]
fn what_is_out_of_the_world_teaches_evidence_nothing() {
    let options = SamplerOptions { evidence: true, retrieval: false, ..SamplerOptions::default() };
    let of = AgentType::Pedestrian;
    let tracks: Vec<_> = (0..3).map(|id| track(id, of, [10.0 * id as f32, 0.0], 0.0, 1.2)).collect();
    let good: Vec<_> = (0..3).map(|id| controls(id, of, &[[0.1, 0.0]; 20], 0.05)).collect();
    let mut bad = good.clone();
    bad[0].best = [ControlGaussian { mean: [1e6, 0.0], cholesky: [0.0; 3] }; 12];
    let missing = good[1..].to_vec();
    let [after_bad, after_missing] = [bad, missing].map(|early| {
        let mut sampler = Sampler::new(options);
        let tick = |tick: i64| if tick < 20 { &early } else { &good };
        let forecasts =
            (0..100).map(|number| learned(&mut sampler, 80_000_000 * number, &tracks, tick(number)));
        forecasts.last().unwrap()
    });
    assert_eq!(after_bad[1..], after_missing[1..]);
}

#[test]
fn impossible_frames_are_refused_whole() {
    let mut sampler = Sampler::new(without_evidence());
    let good = track(1, AgentType::Vehicle, [0.0; 2], 0.0, 2.0);
    let mut refused = |header: Header, track: Track| {
        let mut out = [Forecast { id: 7, ..Forecast::zeroed() }];
        let error = sampler.step(&header, &[track], Err(Cause::Late), &mut out).unwrap_err();
        assert_eq!(out[0].id, 7, "nothing was written");
        error
    };
    assert!(matches!(refused(Header { schema: 9, ..header(0) }, good), Rejected::Schema { .. }));
    assert!(matches!(refused(Header { step_ns: 0, ..header(0) }, good), Rejected::Impossible { .. }));
    assert!(matches!(refused(header(0), Track { x_m: f32::NAN, ..good }), Rejected::NotFinite { .. }));
    assert!(matches!(refused(header(0), Track { vx_mps: 1e9, ..good }), Rejected::Impossible { .. }));
    assert!(matches!(refused(header(0), Track { agent_type: 3, ..good }), Rejected::Impossible { .. }));
    let mut out = vec![Forecast::zeroed(); AGENTS_MAX + 1];
    let error = sampler.step(&header(0), &vec![good; AGENTS_MAX + 1], Err(Cause::Late), &mut out);
    assert!(matches!(error, Err(Rejected::TooMany { .. })));
}

#[test]
fn many_more_tracks_than_places_keep_the_newest_held() {
    let mut sampler = Sampler::new(without_evidence());
    for tick in 0..5_i64 {
        let ids = tick as u64 * 128..(tick as u64 + 1) * 128;
        let tracks: Vec<_> =
            ids.clone().map(|id| track(id, AgentType::Pedestrian, [id as f32, 0.0], 0.0, 1.0)).collect();
        let controls: Vec<_> =
            ids.map(|id| controls(id, AgentType::Pedestrian, &[[0.1, 0.0]], 0.05)).collect();
        learned(&mut sampler, tick * 80_000_000, &tracks, &controls);
        let held = fallback(&mut sampler, tick * 80_000_000 + 40_000_000, &tracks);
        assert!(held.iter().all(|forecast| forecast.quality == Quality::Held as u32));
    }
}

proptest! {
    #[test]
    fn any_finite_input_gives_a_forecast_within_the_world(
        kind in 0_usize..3,
        position_m in [-32_768.0_f32..32_768.0, -32_768.0_f32..32_768.0],
        heading_rad in -10.0_f32..10.0, speed_mps in -80.0_f32..80.0,
        mean in [-1e3_f32..1e3, -1e3_f32..1e3], deviation in 0.0_f32..10.0,
        state_len in 0_usize..7, variance in prop_oneof![-1.0_f32..100.0, Just(f32::MAX)],
        particles in prop::option::of(1_usize..=32), age_ns in 0_i64..3_000_000_000,
    ) {
        let agent_type = TYPES[kind];
        let mut track = track(1, agent_type, position_m, heading_rad, speed_mps);
        track.state_len = state_len as u32;
        track.covariance = [variance; 25];
        prop_assume!(track.check().is_ok());
        let propagation = particles.map_or(Propagation::Linearised, |particles| Propagation::MonteCarlo { particles });
        let mut sampler = Sampler::new(SamplerOptions { propagation, ..without_evidence() });
        let controls = controls(1, agent_type, &[mean, [0.0, 0.0]], deviation);
        for forecast in [
            learned(&mut sampler, 0, &[track], &[controls])[0],
            fallback(&mut sampler, age_ns, &[track])[0],
        ] {
            let points = forecast.modes.as_flattened().iter().chain(&forecast.best).chain(&forecast.mean);
            prop_assert!(points.flatten().all(|x| x.abs() <= wire::POSITION_MAX_M * 1.0001));
            let sum: f32 = forecast.probability[..forecast.modes_len as usize].iter().sum();
            prop_assert!((sum - 1.0).abs() < 1e-3);
            for [xx, xy, yy] in forecast.covariance {
                let slack = 1e-3 * (xx + yy);
                prop_assert!(xx >= -slack && yy >= -slack && xy * xy <= xx * yy + slack * slack + slack, "{xx} {xy} {yy}");
            }
        }
    }
}

/// Published controls, which are saturated already, lead to the positions of their modes.
#[test]
fn published_controls_reproduce_the_modes() {
    let track = track(1, AgentType::Vehicle, [3.0, 4.0], 0.4, 8.0);
    let decoded = controls(1, AgentType::Vehicle, &[[9.0, 0.4], [-2.0, -0.1]], 0.1);
    let published = &learned(&mut Sampler::new(without_evidence()), 0, &[track], &[decoded])[0];
    assert_eq!((published.steering, published.frame_heading_rad), (Steering::Bicycle as u32, 0.4));
    let bicycle = kinematics::Bicycle {
        rear_axle_m: 0.26 * track.length_m,
        slip_limit_rad: Some(0.5),
        integrator: kinematics::Integrator::Midpoint,
    };
    for (mode, controls) in published.controls[..2].iter().enumerate() {
        let mut state = kinematics::BicycleState::new(3.0, 4.0, 0.4, 8.0, 0.0);
        for (step, control) in controls.iter().enumerate() {
            assert!(control.mean[0] < 6.0 && control.cholesky[0] < 0.1, "{control:?}");
            state = bicycle.step(&state, &control.mean.into(), DT_S);
            assert_near([state[0], state[1]], published.modes[mode][step], 1e-3, "mode");
        }
    }
    let held = &fallback(&mut Sampler::new(without_evidence()), 0, &[track])[0];
    assert_eq!((held.steering, held.controls), (Steering::None as u32, Forecast::zeroed().controls));
}

#[test]
fn held_forecasts_keep_controls_relative_to_the_velocity() {
    let motion = MotionOptions { displacement: DisplacementKind::Absolute, ..MotionOptions::default() };
    let mut sampler = Sampler::new(SamplerOptions { motion, ..without_evidence() });
    let pedestrian = track(1, AgentType::Pedestrian, [0.0; 2], 1.2, 1.5);
    let whole = controls(1, AgentType::Pedestrian, &[[1.5 * DT_S + 0.1, 0.05]], 0.1);
    let fresh = learned(&mut sampler, 0, &[pedestrian], &[whole])[0];
    assert_eq!(fresh.steering, Steering::Displacement as u32);
    assert!((fresh.frame_heading_rad - 1.2).abs() < 1e-6);
    for control in &fresh.controls[0] {
        assert_near(control.mean, [0.1, 0.05], 1e-5, "beyond the velocity");
        assert_eq!(control.cholesky, whole.modes[0][0].cholesky);
    }
    let held = fallback(&mut sampler, 160_000_000, &[pedestrian])[0];
    assert_eq!((held.quality, held.age_ns), (Quality::Held as u32, 160_000_000));
    assert_eq!((held.controls, held.steering), (fresh.controls, fresh.steering));
    assert_eq!(held.frame_heading_rad, fresh.frame_heading_rad);
}

/// The forecast for a vehicle at x = 0 after others, forecast at a steady 8 m/s, have braked from there at 1
/// m/s².
fn after_others_braked(retrieval: bool, others: u64) -> Forecast {
    let mut sampler = Sampler::new(SamplerOptions { retrieval, ..without_evidence() });
    let steady = |id| controls(id, AgentType::Vehicle, &[[0.0; 2], [0.5, 0.0]], 0.1);
    let mut now_ns = 0;
    for id in 1..=others {
        for tick in 0..70 {
            let t_s = 0.08 * tick as f32;
            let x_m = 8.0 * t_s - 0.5 * t_s * t_s;
            let braking = track(id, AgentType::Vehicle, [x_m, 0.0], 0.0, 8.0 - t_s);
            learned(&mut sampler, now_ns, &[braking], &[steady(id)]);
            now_ns += 80_000_000;
        }
        now_ns += 5_000_000_000;
    }
    let next = track(99, AgentType::Vehicle, [0.0, 0.2], 0.0, 8.0);
    learned(&mut sampler, now_ns, &[next], &[steady(99)]).remove(0)
}

/// After vehicles that braked against their forecasts, the next forecast brakes, and so do its controls.
#[test]
fn retrieval_corrects_forecasts_unless_it_is_off() {
    let without = after_others_braked(false, 30);
    assert_eq!(without, after_others_braked(true, 0), "nothing to retrieve");
    let with = after_others_braked(true, 30);
    let (without_m, with_m) = (without.best[11][0], with.best[11][0]);
    let driven_m = 8.0 * 4.8 - 0.5 * 4.8 * 4.8;
    assert!(with_m < 0.4 * without_m + 0.6 * driven_m, "{with_m} m of {without_m} m, {driven_m} m driven");
    let brakes = |mode: &usize| (with.modes[*mode][11][0] - driven_m).abs() < 1.5;
    let end_m = |mode: &usize| with.modes[*mode][11][0];
    let mode =
        (0..2).filter(brakes).min_by(|a, b| end_m(a).total_cmp(&end_m(b))).expect("a mode that brakes");
    let control = with.controls[mode][5];
    assert!(control.mean[0] < -0.8, "{control:?}");
    assert_eq!(without.mode_expert, [Expert::Network as u8; 20]);
    assert_eq!(with.mode_expert[mode], Expert::Retrieval as u8);
    assert!((with.probability.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{:?}", with.probability);
    assert!(with.best.iter().all(|[_, y]| (y - 0.2).abs() < 0.05), "{:?}", with.best);
}

/// After pedestrians that went left against their forecasts, the best forecast and one of the modes go left.
#[test]
fn retrieval_corrects_forecasts_of_pedestrians() {
    let mut sampler = Sampler::new(without_evidence());
    let ahead = |id| controls(id, AgentType::Pedestrian, &[[0.0; 2], [0.05, 0.0]], 0.1);
    let mut now_ns = 0;
    for id in 1..=40 {
        for tick in 0..70 {
            let t_s = 0.08 * tick as f32;
            let left_mps = if tick == 0 { 0.0 } else { 1.0 };
            let mut pedestrian = track(id, AgentType::Pedestrian, [1.25 * t_s, t_s], 0.0, 1.25);
            (pedestrian.vy_mps, pedestrian.history[7].vy_mps) = (left_mps, left_mps);
            learned(&mut sampler, now_ns, &[pedestrian], &[ahead(id)]);
            now_ns += 80_000_000;
        }
        now_ns += 5_000_000_000;
    }
    let next = track(99, AgentType::Pedestrian, [0.1, 0.0], 0.0, 1.25);
    let forecast = learned(&mut sampler, now_ns, &[next], &[ahead(99)]).remove(0);
    let left_m = 4.8;
    assert!(forecast.best[11][1] > 0.6 * left_m, "{:?}", forecast.best);
    assert!(
        forecast.modes.iter().take(2).any(|mode| (mode[11][1] - left_m).abs() < 0.4),
        "{:?}",
        forecast.modes
    );
}

/// At 30 m/s, the slip rate of a turn at a street corner would exceed the grip of the tyres.
#[test]
fn vehicles_turn_no_harder_than_tyres_hold() {
    let options = SamplerOptions { evidence: true, retrieval: false, ..SamplerOptions::default() };
    for speed_mps in [4.0, 15.0, 30.0, 45.0] {
        let track = track(1, AgentType::Vehicle, [3.0, 4.0], 0.4, speed_mps);
        let decoded = controls(1, AgentType::Vehicle, &[[0.0, 0.8], [-5.0, -0.8]], 0.1);
        let forecast = learned(&mut Sampler::new(options), 0, &[track], &[decoded])[0];
        for (mode, controls) in forecast.modes[..2].iter().zip(&forecast.controls) {
            let speeds_mps = controls[..12].iter().scan(speed_mps, |speed_mps, control| {
                *speed_mps += control.mean[0] * DT_S;
                Some(*speed_mps)
            });
            let least_mps = speeds_mps.fold(f32::INFINITY, f32::min);
            assert!(least_mps > -2.01, "back at {least_mps} m/s from {speed_mps} m/s");
            let velocity = |step: usize| {
                let before = if step == 0 { [3.0, 4.0] } else { mode[step - 1] };
                [0, 1].map(|axis| (mode[step][axis] - before[axis]) / DT_S)
            };
            for step in 1..12 {
                let (from, to) = (velocity(step - 1), velocity(step));
                let across = (from[0] * to[1] - from[1] * to[0]) / from[0].hypot(from[1]).max(0.1) / DT_S;
                // The limit holds in each step. A chord spans two steps and the later one is slower, so that
                // it measures up to 6 % more.
                assert!(across.abs() < 8.5, "{across} m/s² at {speed_mps} m/s");
            }
        }
    }
}

/// Two cars that approach each other, and a third far away. The controls of one are late.
#[test]
fn conflicts_change_nothing_else_of_a_forecast() {
    let tracks = [
        track(1, AgentType::Vehicle, [0.0, 0.0], 0.0, 5.0),
        track(2, AgentType::Vehicle, [30.0, 0.5], std::f32::consts::PI, 5.0),
        track(3, AgentType::Vehicle, [0.0, 50.0], 0.0, 5.0),
    ];
    let controls = [1, 3].map(|id| controls(id, AgentType::Vehicle, &[[0.0; 2]], 0.1));
    let forecasts = |conflicts| {
        let options = SamplerOptions { conflicts, ..without_evidence() };
        learned(&mut Sampler::new(options), 0, &tracks, &controls)
    };
    let (with, without) = (forecasts(true), forecasts(false));
    assert_eq!(with.iter().map(|of| of.conflicts_len).collect::<Vec<_>>(), [1, 1, 0]);
    assert_eq!((with[0].conflicts[0].other_id, with[1].conflicts[0].other_id), (2, 1));
    // 26 m between the bumpers, and 10 m/s.
    assert!((2.3..2.9).contains(&with[0].conflicts[0].in_s), "{:?}", with[0].conflicts);
    for (mut with, without) in with.into_iter().zip(without) {
        (with.conflicts_len, with.conflicts) = (0, Default::default());
        assert_eq!(with, without);
    }
}
