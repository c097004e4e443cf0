//! Cost of retrieval for one agent if the memory is full of similar entries.

use criterion::{Criterion, criterion_group, criterion_main};
use kinematics::MotionKind;
use retrieval::{BicycleKey, Key, ModeSelection, Query, RetrievalMemory, Retrieved};
use wire::HORIZON_MAX;

const STEP_NS: u64 = 400_000_000;

/// The key of an agent near the origin.
fn key(of: u64) -> Key {
    let vary = |by: u64| (of * by % 97) as f32 / 97.0 - 0.5;
    Key::Bicycle(BicycleKey {
        position_m: [12.0 * vary(7), 12.0 * vary(11)],
        heading_rad: vary(13),
        speed_mps: 8.0 + 3.0 * vary(17),
        acceleration_mps2: vary(19),
        turn_rate_radps: 0.1 * vary(23),
    })
}

fn path(of: u64) -> [[f32; 2]; HORIZON_MAX] {
    std::array::from_fn(|step| [3.2 * step as f32, 0.01 * (of % 50) as f32 * (step * step) as f32])
}

/// A memory of 20,000 agents.
fn full() -> RetrievalMemory {
    let mut memory = RetrievalMemory::new(HORIZON_MAX, STEP_NS);
    let mut retrieved = Retrieved::default();
    for agent in 0..20_000 {
        for step in 0..=HORIZON_MAX as u64 {
            let stamp_ns = ((agent * 20 + step) * STEP_NS).cast_signed();
            let position_m = if step == 0 { [0.0; 2] } else { path(agent)[step as usize - 1] };
            memory.observe(stamp_ns, [(agent, position_m)]);
            if step == 0 {
                let query = Query { stamp_ns, agent, key: key(agent) };
                memory.retrieve_and_store(&query, &path(25), &mut retrieved);
            }
        }
    }
    memory
}

fn retrieval(c: &mut Criterion) {
    let memory = full();
    let here = Key::Bicycle(BicycleKey { speed_mps: 8.0, ..BicycleKey::default() });
    let mut retrieved = Retrieved::default();
    c.bench_function("retrieval from full buckets", |b| {
        b.iter(|| memory.retrieve(u64::MAX, std::hint::black_box(&here), &mut retrieved));
    });
    let mut selection = ModeSelection::default();
    let neighbour_count = retrieved.neighbours.len();
    let paths: Vec<_> = (0..20 + neighbour_count as u64).map(path).collect();
    c.bench_function(&format!("selection among 20 modes and {neighbour_count} neighbours"), |b| {
        b.iter(|| {
            let weights = retrieved.neighbours.iter().map(|neighbour| neighbour.weight);
            let paths = std::hint::black_box(&paths);
            selection.select(MotionKind::Bicycle, paths, HORIZON_MAX, &[0.05; 20], weights);
        });
    });
}

criterion_group!(benches, retrieval);
criterion_main!(benches);
