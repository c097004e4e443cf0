//! The covariances of each mode and of the mixture, and the reported modes and causes.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use std::sync::Arc;

use sampler::{Propagation, Sampler, SamplerOptions};
use wire::{
    AGENT_TYPES, AgentControls, AgentType, Cause, ControlGaussian, Expert, Forecast, Header, Quality, Track,
};

use crate::sampler::{header, without_evidence};

const MODES: usize = 3;

fn track(agent_type: AgentType) -> Track {
    let mut track = Track {
        id: 7,
        agent_type: agent_type as u32,
        forecastable: 1,
        state_len: 5,
        vx_mps: 3.0,
        speed_mps: 3.0,
        length_m: 4.0,
        ..Track::default()
    };
    for (step, state) in track.history.iter_mut().enumerate() {
        (state.x_m, state.vx_mps, state.present) = (1.2 * (step as f32 - 7.0), 3.0, 1);
    }
    track
}

/// Modes with different means, deviations and probabilities.
fn controls(agent_type: AgentType) -> AgentControls {
    let step = |mode: usize| {
        let (deviation, mean) = (0.02 * (mode + 1) as f32, [0.1 - 0.05 * mode as f32, 0.003 * mode as f32]);
        [ControlGaussian { mean, cholesky: [deviation, 0.2 * deviation, 0.3 * deviation] }; 12]
    };
    let mut controls = AgentControls {
        id: 7,
        agent_type: agent_type as u32,
        modes_len: MODES as u32,
        best: step(0),
        ..AgentControls::default()
    };
    controls.probability[..MODES].copy_from_slice(&[0.5, 0.3, 0.2]);
    (0..MODES).for_each(|mode| controls.modes[mode] = step(mode));
    controls
}

/// The learned forecast of a tick, and the forecast without controls `age_ns` later.
fn learned_and_held(agent_type: AgentType, propagation: Propagation, age_ns: i64) -> [Forecast; 2] {
    let mut sampler = Sampler::new(SamplerOptions { propagation, ..without_evidence() });
    let (tracks, mut out) = ([track(agent_type)], [Forecast::default(); 2]);
    sampler.step(&header(0), &tracks, Ok(&[controls(agent_type)]), &mut out[..1]).unwrap();
    sampler.step(&header(age_ns), &tracks, Err(Cause::Late), &mut out[1..]).unwrap();
    out.iter().for_each(|forecast| forecast.check().unwrap());
    out
}

#[test]
fn a_sampler_that_follows_another_holds_its_forecasts_to_the_bit() {
    let [learned, held] = learned_and_held(AgentType::Vehicle, Propagation::Linearised, 400_000_000);
    let mut spare = Sampler::new(without_evidence());
    let void = Header { flags: wire::flags::VOID, ..header(0) };
    spare.follow(&void, &[learned]);
    let hold = |spare: &mut Sampler| {
        let mut out = [Forecast::default()];
        spare.step(&header(400_000_000), &[track(AgentType::Vehicle)], Err(Cause::Late), &mut out).unwrap();
        out[0]
    };
    assert_eq!(hold(&mut spare).quality, Quality::Kinematic as u32, "nothing is taken from a VOID frame");
    spare.follow(&header(0), &[learned]);
    // A forecast that is itself held must not be held again.
    spare.follow(&header(80_000_000), &[Forecast { quality: Quality::Held as u32, ..learned }]);
    assert_eq!(hold(&mut spare), held);
    // A learned forecast is held even if constant velocity was known to be more accurate.
    let (quality, cause) = (Quality::Kinematic as u32, Cause::Outdone as u32);
    let mut spare = Sampler::new(without_evidence());
    spare.follow(&header(0), &[Forecast { quality, cause, causes: Cause::Outdone.bit(), ..learned }]);
    assert_eq!(hold(&mut spare).quality, Quality::Held as u32);
}

/// The covariance of the mixture of the published modes, by the law of total covariance.
fn total(forecast: &Forecast, step: usize) -> [f32; 3] {
    let mut total = [0.0; 3];
    for mode in 0..MODES {
        let [dx, dy] = [0, 1].map(|axis| forecast.modes[mode][step][axis] - forecast.mean[step][axis]);
        for (entry, between) in [dx * dx, dx * dy, dy * dy].into_iter().enumerate() {
            total[entry] +=
                forecast.probability[mode] * (forecast.mode_covariance[mode][step][entry] + between);
        }
    }
    total
}

#[test]
fn the_mixture_has_the_moments_of_its_modes() {
    for agent_type in AGENT_TYPES {
        for propagation in [Propagation::Linearised, Propagation::MonteCarlo { particles: 32 }] {
            for forecast in learned_and_held(agent_type, propagation, 560_000_000) {
                for step in 0..12 {
                    let (expected, found) = (total(&forecast, step), forecast.covariance[step]);
                    let scale = found[0] + found[2];
                    let off = (0..3).map(|entry| (expected[entry] - found[entry]).abs());
                    assert!(
                        off.fold(0.0, f32::max) < 1e-4 * scale,
                        "{agent_type:?} {step}: {expected:?} {found:?}"
                    );
                    let traces = [0, 1, 2].map(|mode| {
                        let [xx, _, yy] = forecast.mode_covariance[mode][step];
                        xx + yy
                    });
                    assert!(traces.is_sorted(), "wider controls, wider modes: {traces:?}");
                }
                assert_eq!(forecast.mode_covariance[MODES..], [[[0.0; 3]; 12]; 20 - MODES]);
                assert_eq!(forecast.mode_expert, [Expert::Network as u8; 20]);
            }
        }
    }
}

#[test]
fn held_modes_have_the_covariance_predicted_for_the_time() {
    for agent_type in AGENT_TYPES {
        // Two steps and a half later.
        let [fresh, held] = learned_and_held(agent_type, Propagation::Linearised, 1_000_000_000);
        assert_eq!(held.quality, Quality::Held as u32);
        for (fresh, held) in fresh.mode_covariance.iter().zip(&held.mode_covariance).take(MODES) {
            for entry in 0..3 {
                for (step, held) in held.iter().enumerate().take(9) {
                    let between = (fresh[step + 2][entry] + fresh[step + 3][entry]) / 2.0;
                    assert!((held[entry] - between).abs() <= 1e-5 * between.abs(), "{agent_type:?} {step}");
                }
                let growth = (14.5_f32 / 12.0).powi(2);
                assert!((held[11][entry] - fresh[11][entry] * growth).abs() <= 1e-5 * held[11][entry].abs());
            }
        }
    }
}

#[test]
fn causes_are_bits_and_the_process_model_is_an_expert() {
    let [learned, held] = learned_and_held(AgentType::Pedestrian, Propagation::Linearised, 80_000_000);
    assert_eq!((learned.cause, learned.causes), (0, 0));
    assert_eq!((held.cause, held.causes), (Cause::Late as u32, 1 << Cause::Late as u32));
    assert_eq!(learned.expert_weights, [0.0; 8], "reserved");
    let mut kinematic = [Forecast::default()];
    let young = Track { forecastable: 0, ..track(AgentType::Vehicle) };
    let mut sampler = Sampler::new(without_evidence());
    sampler.step(&header(0), &[young], Err(Cause::Late), &mut kinematic).unwrap();
    let [kinematic] = kinematic;
    assert_eq!((kinematic.cause, kinematic.causes), (Cause::Young as u32, Cause::Young.bit()));
    assert_eq!(kinematic.mode_expert[0], Expert::ProcessModel as u8);
    assert_eq!(kinematic.mode_covariance[0], kinematic.covariance);
    assert_eq!(kinematic.mode_covariance[1..], [[[0.0; 3]; 12]; 19]);
}

#[test]
fn vehicles_are_guided_along_a_lane_and_pedestrians_are_not() {
    let forecast = |agent_type: AgentType, guided: bool| {
        let mut sampler = Sampler::new(without_evidence());
        if guided {
            sampler.guide_along(&Arc::new(crate::road::road()));
        }
        let (tracks, mut out) = ([track(agent_type)], [Forecast::default()]);
        sampler.step(&header(0), &tracks, Ok(&[turning(agent_type)]), &mut out).unwrap();
        out[0].check().unwrap();
        out[0]
    };
    let [free, guided] = [false, true].map(|guided| forecast(AgentType::Vehicle, guided));
    let off_lane_m = |forecast: &Forecast| (forecast.best[11][1] - 0.5).abs();
    assert!(off_lane_m(&free) > 3.0, "{:?}", free.best);
    assert!(off_lane_m(&guided) < 0.6 * off_lane_m(&free), "{:?}", guided.best);
    assert!((guided.best[0][1] - free.best[0][1]).abs() < 0.2, "the next moment is the agent's own");
    for mode in 0..MODES {
        assert!((guided.modes[mode][11][1] - 0.5).abs() < (free.modes[mode][11][1] - 0.5).abs());
    }
    assert_eq!(guided.probability, free.probability);
    assert_eq!(forecast(AgentType::Vehicle, true), guided, "the same each time");
    let [free, guided] = [false, true].map(|guided| forecast(AgentType::Pedestrian, guided));
    assert_eq!(free, guided);
}

/// Controls of a steady turn to the left.
fn turning(agent_type: AgentType) -> AgentControls {
    let mut controls = controls(agent_type);
    let step = ControlGaussian { mean: [0.0, 0.02], cholesky: [0.05, 0.0, 0.01] };
    controls.best = [step; 12];
    (0..MODES).for_each(|mode| controls.modes[mode] = [step; 12]);
    controls
}
