//! Workers share a tick without changing a bit of its forecasts.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use std::sync::Arc;

use bytemuck::{Zeroable, bytes_of, cast_slice};
use sampler::{Propagation, Sampler, SamplerOptions};
use wire::{AgentControls, ControlGaussian, Forecast, HISTORY_MAX, Header, HistoryState, Quality, Track};

use crate::road::road;

const AGENTS: u64 = 23;
const TICK_S: f32 = 0.08;
const STEP_S: f32 = 0.4;

/// Agents of all types that follow one another along a road, brake at its bend, and repeat the drive under
/// another number. The behaviour of one agent is therefore expected of the next.
fn agent(number: u64, seq: u64) -> (Track, AgentControls) {
    let position_m = |time_s: f32| {
        let along_m = 3.0 * time_s + 7.0 * number as f32;
        let round_m = along_m.rem_euclid(160.0);
        [round_m - 0.002 * (round_m - 80.0).max(0.0).powi(2), 0.1 * number as f32]
    };
    let time_s = seq as f32 * TICK_S;
    let rounds = (3.0 * time_s + 7.0 * number as f32) / 160.0;
    let id = number + 100 * rounds.floor() as u64;
    let state = |time_s: f32| {
        let (now, next) = (position_m(time_s), position_m(time_s + 0.01));
        (now, (next[0] - now[0]).clamp(-0.1, 0.1) / 0.01)
    };
    let ([x_m, y_m], speed_mps) = state(time_s);
    let mut track = Track {
        id,
        agent_type: (number % 3) as u32,
        forecastable: 1,
        state_len: 5,
        x_m,
        y_m,
        vx_mps: speed_mps,
        speed_mps,
        length_m: 4.0,
        ..Track::zeroed()
    };
    for (back, entry) in track.history.iter_mut().rev().enumerate().take(HISTORY_MAX) {
        let ([x_m, y_m], vx_mps) = state(time_s - STEP_S * back as f32);
        *entry = HistoryState { x_m, y_m, vx_mps, present: 1, ..HistoryState::zeroed() };
    }
    let control = |mode: usize| ControlGaussian {
        mean: [0.1 * (mode % 5) as f32 - 0.2, 0.004 * (mode / 5) as f32 - 0.008],
        cholesky: [0.1, 0.01, 0.1],
    };
    let controls = AgentControls {
        id,
        agent_type: track.agent_type,
        modes_len: 20,
        probability: [0.05; 20],
        modes: std::array::from_fn(|mode| [control(mode); 12]),
        best: [control(2); 12],
        ..AgentControls::zeroed()
    };
    (track, controls)
}

/// The forecasts of 300 ticks, in which some agents have no controls, and one has impossible controls.
fn forecasts(options: SamplerOptions, workers: usize, is_guided: bool) -> (Vec<u8>, [usize; 2]) {
    let mut sampler = Sampler::with_workers(options, workers).unwrap();
    if is_guided {
        sampler.guide_along(&Arc::new(road()));
    }
    let (mut bytes, mut seen) = (Vec::new(), [0; 2]);
    for seq in 0..300 {
        let (tracks, mut controls): (Vec<_>, Vec<_>) = (0..AGENTS).map(|number| agent(number, seq)).unzip();
        controls.remove((seq % AGENTS) as usize);
        controls[3].probability[0] = if seq % 7 == 0 { f32::NAN } else { 0.05 };
        let mut header = Header::new(1, seq, (seq as f32 * TICK_S * 1e9) as i64);
        header.step_ns = 400_000_000;
        let mut out = vec![Forecast::zeroed(); tracks.len()];
        sampler.step(&header, &tracks, Ok(&controls), &mut out).unwrap();
        let learned = out.iter().filter(|forecast| forecast.quality == Quality::Learned as u32).count();
        let retrieved = out.iter().flat_map(|forecast| forecast.mode_expert).filter(|&of| of != 0).count();
        seen = [seen[0] + learned, seen[1] + retrieved];
        bytes.extend_from_slice(cast_slice(&out));
    }
    let memory = sampler.memory().map(|memory| bytes_of(&memory.state()).to_vec());
    bytes.extend(memory.unwrap_or_default());
    (bytes, seen)
}

#[test]
fn forecasts_are_the_same_bytes_with_any_number_of_workers() {
    let plain = SamplerOptions { evidence: true, ..SamplerOptions::default() };
    let particles = Propagation::MonteCarlo { particles: 4 };
    let kinds = [
        (plain, false),
        (plain, true),
        (SamplerOptions { evidence: false, ..plain }, false),
        (SamplerOptions { propagation: particles, evidence: false, ..plain }, false),
    ];
    for (options, is_guided) in kinds {
        let (alone, [learned, of_others]) = forecasts(options, 1, is_guided);
        assert!(
            learned > 2_500 && of_others > 2_500,
            "{learned} learned, {of_others} modes not the network's"
        );
        for workers in [2, 4] {
            let (shared, _) = forecasts(options, workers, is_guided);
            assert!(alone == shared, "{workers} workers, {options:?}, guided: {is_guided}");
        }
    }
}
