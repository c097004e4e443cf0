//! Cost of a tick: 32 agents of a type, 20 modes and the best, 12 steps.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use bytemuck::Zeroable;
use criterion::{Criterion, criterion_group, criterion_main};
use sampler::{Propagation, Sampler, SamplerOptions};
use wire::{AgentControls, AgentType, Cause, ControlGaussian, Forecast, Header, Track};

const AGENTS: usize = 32;

fn fixture(agent_type: AgentType) -> (Header, Vec<Track>, Vec<AgentControls>) {
    let mut header = Header::new(1, 7, 560_000_000);
    header.step_ns = 400_000_000;
    let track = |i: usize| Track {
        id: i as u64,
        agent_type: agent_type as u32,
        forecastable: 1,
        x_m: i as f32,
        vx_mps: 4.0,
        speed_mps: 4.0,
        ..Track::zeroed()
    };
    let control = ControlGaussian { mean: [0.3, 0.02], cholesky: [0.2, 0.01, 0.1] };
    let controls = |i: usize| AgentControls {
        id: i as u64,
        agent_type: agent_type as u32,
        modes_len: 20,
        probability: [0.05; 20],
        modes: [[control; 12]; 20],
        best: [control; 12],
        ..AgentControls::zeroed()
    };
    (header, (0..AGENTS).map(track).collect(), (0..AGENTS).map(controls).collect())
}

fn tick(c: &mut Criterion) {
    for agent_type in [AgentType::Vehicle, AgentType::Pedestrian] {
        let name = format!("{}s", agent_type.name());
        let (header, tracks, controls) = fixture(agent_type);
        let mut out = vec![Forecast::zeroed(); AGENTS];
        for propagation in [Propagation::Linearised, Propagation::MonteCarlo { particles: 32 }] {
            let mut sampler = Sampler::new(SamplerOptions { propagation, ..SamplerOptions::default() });
            c.bench_function(&format!("{AGENTS} {name}, {propagation:?}"), |b| {
                b.iter(|| {
                    let controls = std::hint::black_box(&controls);
                    sampler.learned(&header, &tracks, controls, &mut out).unwrap();
                });
            });
            if propagation == Propagation::Linearised {
                c.bench_function(&format!("{AGENTS} {name}, held"), |b| {
                    b.iter(|| sampler.fallback(&header, &tracks, Cause::Late, &mut out).unwrap());
                });
            }
        }
    }
}

criterion_group!(benches, tick);
criterion_main!(benches);
