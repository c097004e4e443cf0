//! Speed of reading recordings and cutting windows: INTERACTION's format, 60 vehicles for 60 s.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use data::{Format, Input, Role, WindowOptions, parse, windows};

fn vehicles() -> Input {
    let mut text = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n".to_owned();
    for id in 0..60 {
        for frame in 1..=600 {
            let x_m = 900.0 + f64::from(frame) * 0.4;
            text += &format!("{id},{frame},{frame}00,car,{x_m:.3},{id}.125,4.000,0.000,0.000,4.50,1.80\n");
        }
    }
    Input::new(Role::Vehicles, "vehicle_tracks_000.csv", text)
}

fn readers(criterion: &mut Criterion) {
    let inputs = [vehicles()];
    let mut group = criterion.benchmark_group("recording");
    group.sample_size(20);
    group.throughput(Throughput::Bytes(inputs[0].bytes.len() as u64));
    group.bench_function("read", |bencher| bencher.iter(|| parse(Format::Interaction, &inputs)));
    let Ok(recording) = parse(Format::Interaction, &inputs) else { return };
    let options = WindowOptions::new(8, 12, 400_000_000);
    group.throughput(Throughput::Elements(windows(&recording, &options).len() as u64));
    group.bench_function("windows", |bencher| bencher.iter(|| windows(&recording, &options)));
    group.finish();
}

criterion_group!(benches, readers);
criterion_main!(benches);
