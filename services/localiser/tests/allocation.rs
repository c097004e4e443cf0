//! A steady step allocates nothing.

use bytemuck::Zeroable;
use localiser::{Localiser, LocaliserOptions, MapSource};
use scene::PatchOptions;
use testing::{CountingAllocator, allocations};
use wire::{ContextMut, Header, HistoryState, Row, Track, context_rows};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// 32 agents that drive away from the first ego position for kilometres. One agent in eight is new in each
/// tick.
fn write_tracks(tick: u64, tracks: &mut [Track]) {
    for (i, track) in tracks.iter_mut().enumerate() {
        let i = i as u64;
        let x_m = |tick: f32| tick * 0.8 + i as f32;
        *track = Track { id: if i.is_multiple_of(8) { i + tick * 64 } else { i }, ..Track::zeroed() };
        (track.x_m, track.y_m, track.vx_mps) = (x_m(tick as f32), (i % 6) as f32 * 3.0, 10.0);
        for (step, entry) in track.history.iter_mut().enumerate() {
            let then = tick as f32 - (7 - step) as f32 * 5.0;
            *entry = HistoryState {
                x_m: x_m(then),
                y_m: track.y_m,
                vx_mps: 10.0,
                present: 1,
                ..HistoryState::default()
            };
        }
    }
}

// This file has only one test: allocations of another test in this process would be counted too.
#[test]
fn a_thousand_steady_steps_allocate_nothing() {
    let patch = PatchOptions { side: 16, cell_m: 2.0, ahead_m: 0.0 };
    let mut localiser = Localiser::new(LocaliserOptions { history_len: 8, patch, map: MapSource::Online });
    let mut tracks = [Track::zeroed(); 32];
    let shape = localiser.shape(tracks.len());
    let mut rows = vec![Row::zeroed(); context_rows(&shape)];
    let mut step = |tick: u64| {
        write_tracks(tick, &mut tracks);
        let mut header = Header::new(1, tick, tick as i64 * 80_000_000);
        header.step_ns = 400_000_000;
        header.counts.history_len = 8;
        header.ego_m = [tracks[1].x_m, 0.0];
        let mut out = ContextMut::over(&mut rows, shape).expect("rows of the shape");
        localiser.step(&header, &tracks, &mut out).expect("a good frame");
        assert!(tick == 0 || out.patches.iter().any(|x| *x > 0.0));
    };
    (0..50).for_each(&mut step);
    assert_eq!(allocations(|| (50..1_050).for_each(&mut step)), 0);
}
