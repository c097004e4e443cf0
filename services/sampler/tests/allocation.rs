//! A step in steady state allocates nothing.

mod road;

use std::sync::Arc;

use bytemuck::Zeroable;
use retrieval::RetrievalMemory;
use sampler::journal::{Identity, Journal};
use sampler::{Propagation, Sampler, SamplerOptions};
use testing::{CountingAllocator, allocations};
use wire::{AgentControls, Cause, ControlGaussian, Forecast, Header, HistoryState, Track};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// 32 agents of all types; one in eight is new at every tick.
fn write_tick(tick: u64, tracks: &mut [Track], controls: &mut [AgentControls]) {
    for (i, (track, controls)) in tracks.iter_mut().zip(controls).enumerate() {
        let (i, agent_type) = (i as u64, i as u32 % 3);
        let id = if i.is_multiple_of(8) { i + tick * 64 } else { i };
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
    let kinds = [
        (Propagation::Linearised, false, false, false, 1),
        (Propagation::MonteCarlo { particles: 4 }, false, false, false, 1),
        (Propagation::Linearised, true, false, false, 1),
        (Propagation::Linearised, true, true, false, 1),
        (Propagation::Linearised, true, true, true, 1),
        (Propagation::Linearised, true, true, true, 3),
    ];
    for (propagation, retrieval, evidence, guided, workers) in kinds {
        let options = SamplerOptions { propagation, retrieval, evidence, ..SamplerOptions::default() };
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
            write_tick(tick, &mut tracks, &mut controls);
            let mut header = Header::new(1, tick, tick as i64 * 80_000_000);
            header.step_ns = 400_000_000;
            let written = match tick % 4 {
                3 => sampler.fallback(&header, &tracks, Cause::Late, &mut out),
                _ => sampler.learned(&header, &tracks, &controls[..30], &mut out),
            };
            written.expect("a good frame");
            if let Some(journal) = &mut journal {
                sampler.commit(tick + 1, journal).expect("room was set aside");
            }
            assert!(out.iter().all(|forecast| forecast.modes_len > 0));
        };
        (0..50).for_each(&mut step);
        assert_eq!(
            allocations(|| (50..1_050).for_each(&mut step)),
            0,
            "{propagation:?} {retrieval} {evidence} {guided} {workers}"
        );
        let stored = sampler.memory().map_or(0, RetrievalMemory::entries_len);
        assert!(stored > 6000 || !retrieval, "{stored} entries");
    }
}
