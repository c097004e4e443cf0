//! A step in steady state allocates nothing.

mod road;

use std::sync::Arc;

use bytemuck::Zeroable;
use kinematics::MotionKind;
use retrieval::RetrievalMemory;
use sampler::journal::{Identity, Journal};
use sampler::{Degradation, Propagation, Sampler, SamplerOptions};
use testing::{CountingAllocator, allocations};
use wire::{AgentControls, Cause, ControlGaussian, Forecast, Header, HistoryState, Track};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// 32 agents of all types. If `agents_change`, one in eight is new at every tick.
fn write_tick(tick: u64, agents_change: bool, tracks: &mut [Track], controls: &mut [AgentControls]) {
    for (i, (track, controls)) in tracks.iter_mut().zip(controls).enumerate() {
        let (i, agent_type) = (i as u64, i as u32 % 3);
        let id = if agents_change && i.is_multiple_of(8) { i + tick * 64 } else { i };
        *track = Track { id, agent_type, forecastable: 1, state_len: 5, ..Track::zeroed() };
        let x_m = i as f32 + tick as f32 * 0.08;
        (track.x_m, track.vx_mps, track.speed_mps) = (x_m, 1.0, 1.0);
        for (step, entry) in track.history.iter_mut().rev().enumerate() {
            *entry = HistoryState {
                x_m: x_m - 0.4 * step as f32,
                vx_mps: 1.0,
                present: 1,
                ..HistoryState::zeroed()
            };
        }
        let control = ControlGaussian { mean: [0.1, 0.01], cholesky: [0.1, 0.0, 0.1] };
        *controls = AgentControls { id, agent_type, modes_len: 20, ..AgentControls::zeroed() };
        (controls.probability, controls.modes, controls.best) =
            ([0.05; 20], [[control; 12]; 20], [control; 12]);
    }
}

// The only test in this process, because allocations of another test would be counted as well.
#[test]
fn a_thousand_steady_steps_allocate_nothing() {
    let plain = SamplerOptions { retrieval: false, evidence: false, ..SamplerOptions::default() };
    let full = SamplerOptions::default();
    let silent = Degradation { held_ns: 160_000_000, kinematic_ns: Some(160_000_000) };
    let kinds = [
        (plain, false, 1),
        (SamplerOptions { propagation: Propagation::MonteCarlo { particles: 4 }, ..plain }, false, 1),
        (SamplerOptions { initial_covariance: false, ..plain }, false, 1),
        (SamplerOptions { vehicle_motion: MotionKind::Displacement, ..plain }, false, 1),
        (SamplerOptions { retrieval: true, ..plain }, false, 1),
        (SamplerOptions { evidence: true, ..plain }, false, 1),
        (full, false, 1),
        (full, true, 1),
        (full, true, 3),
        (SamplerOptions { conflicts: true, ..full }, true, 3),
        (SamplerOptions { degradation: silent, ..plain }, false, 1),
        (SamplerOptions { degradation: silent, ..full }, true, 3),
    ];
    for (options, guided, workers) in kinds {
        let mut sampler = Sampler::with_workers(options, workers).expect("threads");
        let mut journal =
            Identity::of(1, &options).map(|identity| Journal::over(Vec::with_capacity(1 << 19), identity));
        journal.iter_mut().for_each(|journal| journal.clear().expect("memory"));
        if guided {
            sampler.guide_along(&Arc::new(road::road()));
        }
        let mut tracks = vec![Track::zeroed(); 32];
        let mut controls = vec![AgentControls::zeroed(); 32];
        let mut out = vec![Forecast::zeroed(); 32];
        let mut step = |tick: u64| {
            // New agents displace the held forecasts of silent ones, which then count as new.
            write_tick(tick, options.degradation != silent, &mut tracks, &mut controls);
            let mut header = Header::new(1, tick, tick as i64 * 80_000_000);
            header.step_ns = 400_000_000;
            // Every fourth tick has no controls. The last two tracks have some only at first.
            let controlled = if tick < 4 { 32 } else { 30 };
            let controls = if tick % 4 == 3 { Err(Cause::Late) } else { Ok(&controls[..controlled]) };
            let count = sampler.step(&header, &tracks, controls, &mut out).expect("a good frame");
            let are_silent = options.degradation == silent && tick > 6;
            assert_eq!(count, if are_silent { 30 } else { 32 }, "tick {tick}");
            if let Some(journal) = &mut journal {
                sampler.commit(tick + 1, journal).expect("room was set aside");
            }
            assert!(out[..count].iter().all(|forecast| forecast.modes_len > 0));
        };
        (0..50).for_each(&mut step);
        assert_eq!(allocations(|| (50..1_050).for_each(&mut step)), 0, "{options:?} {guided} {workers}");
        let stored = sampler.memory().map_or(0, RetrievalMemory::entry_count);
        assert!(stored > 6000 || !options.retrieval || options.degradation == silent, "{stored} entries");
    }
}
