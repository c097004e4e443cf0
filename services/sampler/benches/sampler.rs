//! Cost of a tick: 32 agents of a type, 20 modes and the best forecast, 12 steps.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use bytemuck::Zeroable;
use criterion::{Criterion, criterion_group, criterion_main};
use sampler::journal::{Identity, Journal};
use sampler::{Propagation, Sampler, SamplerOptions};
use wire::{AgentControls, AgentType, Cause, ControlGaussian, Forecast, Header, HistoryState, Track};

const AGENTS: usize = 32;

/// The settings without evidence, because evidence would determine blend and widths.
fn without_evidence() -> SamplerOptions {
    SamplerOptions { evidence: false, ..SamplerOptions::default() }
}

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
            let mut sampler = Sampler::new(SamplerOptions { propagation, ..without_evidence() });
            c.bench_function(&format!("{AGENTS} {name}, {propagation:?}"), |b| {
                b.iter(|| {
                    let controls = std::hint::black_box(&controls);
                    sampler.step(&header, &tracks, Ok(controls), &mut out).unwrap();
                });
            });
            if propagation == Propagation::Linearised {
                c.bench_function(&format!("{AGENTS} {name}, held"), |b| {
                    b.iter(|| sampler.step(&header, &tracks, Err(Cause::Late), &mut out).unwrap());
                });
            }
        }
    }
}

/// A tick of pedestrians who walk along the paths of earlier pedestrians, distributed over workers. Retrieval
/// is most of the work.
fn retrieving(c: &mut Criterion) {
    let (header, tracks, controls) = fixture(AgentType::Pedestrian);
    for workers in [1, 2] {
        let options = SamplerOptions { evidence: true, ..SamplerOptions::default() };
        let mut sampler = Sampler::with_workers(options, workers).unwrap();
        let (mut header, mut tracks, mut out) = (header, tracks.clone(), vec![Forecast::zeroed(); AGENTS]);
        let mut tick = |seq: u64| {
            (header.seq, header.stamp_ns) = (seq, seq as i64 * 80_000_000);
            for (i, track) in tracks.iter_mut().enumerate() {
                // Each agent walks its 12 m in 12 s repeatedly, each time as a new agent.
                let (round, along) = (seq / 150, (seq % 150) as f32 * 0.08);
                (track.id, track.x_m, track.y_m) = (i as u64 + 1_000 * round, along, i as f32 * 0.5);
                (track.vx_mps, track.speed_mps) = (1.0, 1.0);
                let state = HistoryState {
                    x_m: track.x_m,
                    y_m: track.y_m,
                    vx_mps: track.vx_mps,
                    present: 1,
                    ..HistoryState::zeroed()
                };
                track.history = [state; wire::HISTORY_MAX];
            }
            let mut controls = controls.clone();
            controls.iter_mut().zip(&tracks).for_each(|(controls, track)| controls.id = track.id);
            sampler.step(&header, &tracks, Ok(&controls), &mut out).unwrap();
        };
        (0..3_000).for_each(&mut tick);
        let mut seq = 3_000;
        c.bench_function(&format!("{AGENTS} pedestrians who retrieve, {workers} workers"), |b| {
            b.iter(|| {
                seq += 1;
                tick(seq);
            });
        });
    }
}

/// The work after a tick with walking agents. Per tick, one memory entry changes for each agent that
/// completes a step.
fn commit(c: &mut Criterion) {
    let options = SamplerOptions { evidence: true, ..SamplerOptions::default() };
    let (mut header, mut tracks, controls) = fixture(AgentType::Pedestrian);
    let mut out = vec![Forecast::zeroed(); AGENTS];
    let mut sampler = Sampler::new(options);
    // With one tick every 80 ms, all agents complete their steps in the same tick: the most data to copy.
    for seq in 0..101_u64 {
        (header.seq, header.stamp_ns) = (seq, seq as i64 * 80_000_000);
        tracks.iter_mut().for_each(|track| {
            track.x_m += 0.3;
            let state =
                HistoryState { x_m: track.x_m, vx_mps: track.vx_mps, present: 1, ..HistoryState::zeroed() };
            track.history = [state; wire::HISTORY_MAX];
        });
        sampler.step(&header, &tracks, Ok(&controls), &mut out).unwrap();
    }
    let identity = Identity::of(1, &options).unwrap();
    let mut journal = Journal::over(Vec::new(), identity);
    journal.clear().unwrap();
    let mut ticks = 0;
    let changed = sampler.memory().unwrap().changed().count();
    c.bench_function(&format!("{AGENTS} pedestrians, commit, {changed} entries changed"), |b| {
        b.iter(|| {
            ticks += 1;
            sampler.commit(ticks, &mut journal).unwrap();
        });
    });
}

criterion_group!(benches, tick, retrieving, commit);
criterion_main!(benches);
