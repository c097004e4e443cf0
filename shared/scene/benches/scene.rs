//! Cost of the scene's inner loops: patches of both kinds of map, and the interaction graph of a full frame.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use criterion::{Criterion, criterion_group, criterion_main};
use scene::{AgentType, EdgeRule, MapBuilder, NEIGHBOURS_MAX, OnlineMap, PatchOptions, State, Vertex};

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

criterion_group!(benches, patches, graph);
criterion_main!(benches);
