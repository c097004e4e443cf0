//! Cost of the scene's inner loops: patches of both kinds of map and the interaction graph of a full frame.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use criterion::{Criterion, criterion_group, criterion_main};
use scene::{
    AgentType, Choice, Driving, EdgeRule, Gait, MapBuilder, Moment, NEIGHBOURS_MAX, OnlineMap, PatchOptions,
    PlaceMemory, Recall, State, Vertex,
};
use wire::HORIZON_MAX;

/// Points of a spiral around the origin, at most 60 m away, with velocities along it.
fn visits() -> impl Iterator<Item = ([f32; 2], [f32; 2])> {
    (0..20_000).map(|i| {
        let angle = i as f32 * 0.37;
        let radius_m = 60.0 * (i as f32 / 20_000.0);
        let (sin, cos) = angle.sin_cos();
        ([radius_m * cos, radius_m * sin], [-4.0 * sin, 4.0 * cos])
    })
}

fn patches(c: &mut Criterion) {
    let mut builder = MapBuilder::new([-64.0, -64.0], 128, 128).unwrap();
    visits().for_each(|(position_m, velocity_mps)| {
        builder.visit(position_m, velocity_mps);
    });
    let fixed = builder.build();
    let mut online = OnlineMap::new();
    online.observe([0.0, 0.0], visits());
    let state = State { position_m: [10.0, -7.0], velocity_mps: [3.0, 1.0], heading_rad: 0.4 };
    for side in [16, 32] {
        let options = PatchOptions { side, cell_m: 2.0, ahead_m: 0.0 };
        let mut out = vec![0.0; options.len()];
        c.bench_function(&format!("patch {side}, fixed map"), |b| {
            b.iter(|| fixed.patch(std::hint::black_box(&state), options, &mut out));
        });
        c.bench_function(&format!("patch {side}, online map"), |b| {
            b.iter(|| online.patch(std::hint::black_box(&state), options, &mut out));
        });
    }
}

fn graph(c: &mut Criterion) {
    let vertices: Vec<_> = (0..128)
        .map(|i| {
            let position_m = [(i % 12) as f32 * 6.0, (i / 12) as f32 * 5.0];
            Some(Vertex { position_m, agent_type: AgentType::Vehicle })
        })
        .collect();
    let mut edges = Vec::with_capacity(128 * 128);
    for neighbours_max in [NEIGHBOURS_MAX, usize::MAX] {
        let rule = EdgeRule { radius_m: 30.0, pedestrian_radius_m: 10.0, neighbours_max };
        c.bench_function(&format!("graph of 128 agents, at most {neighbours_max} neighbours"), |b| {
            b.iter(|| {
                edges.clear();
                rule.append(0, std::hint::black_box(&vertices), &mut edges);
            });
        });
    }
}

/// An agent that comes to a place where the memory is full of its likes, and what of them stands in for modes.
fn place(c: &mut Criterion) {
    let mut memory = PlaceMemory::new(HORIZON_MAX, 400_000_000);
    let moment = |of: u64| {
        let vary = |by: u64| (of * by % 97) as f32 / 97.0 - 0.5;
        Moment::Driving(Driving {
            position_m: [12.0 * vary(7), 12.0 * vary(11)],
            heading_rad: vary(13),
            speed_mps: 8.0 + 3.0 * vary(17),
            acceleration_mps2: vary(19),
            turn_rate_radps: 0.1 * vary(23),
        })
    };
    let path = |of: u64| -> [[f32; 2]; HORIZON_MAX] {
        std::array::from_fn(|step| [3.2 * step as f32, 0.01 * (of % 50) as f32 * (step * step) as f32])
    };
    let mut recall = Recall::default();
    for agent in 0..20_000 {
        for step in 0..=HORIZON_MAX as u64 {
            memory.advance(((agent * 20 + step) * 400_000_000).cast_signed());
            memory.observe(agent, if step == 0 { [0.0; 2] } else { path(agent)[step as usize - 1] });
            if step == 0 {
                memory.remember(agent, &moment(agent), &path(25), &recall);
            }
        }
    }
    let here = Moment::Driving(Driving { speed_mps: 8.0, ..Driving::default() });
    c.bench_function("recall among full buckets", |b| {
        b.iter(|| memory.recall(u64::MAX, std::hint::black_box(&here), &mut recall));
    });
    let mut choice = Choice::default();
    let paths: Vec<_> = (0..20 + recall.likes.len() as u64).map(path).collect();
    c.bench_function(&format!("choice among 20 modes and {} paths", recall.likes.len()), |b| {
        b.iter(|| {
            let weights = recall.likes.iter().map(|like| like.weight);
            choice.choose(Gait::Driving, std::hint::black_box(&paths), HORIZON_MAX, &[0.05; 20], weights);
        });
    });
}

criterion_group!(benches, patches, graph, place);
criterion_main!(benches);
