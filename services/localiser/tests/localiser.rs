//! Checks context frames of agents that drive in circles, tick by tick.

#![expect(clippy::unwrap_used, reason = "a broken fixture should fail at once")]

use bytemuck::Zeroable;
use localiser::{Localiser, LocaliserOptions, MapSource};
use scene::{MapBuilder, PatchOptions, State};
use wire::{Context, ContextMut, Header, HistoryState, Rejected, Row, Track, TrackStatus, context_rows};

const TICK_NS: i64 = 80_000_000;
const STEP_TICKS: i64 = 5;
const HISTORY_LEN: usize = 8;
const PATCH: PatchOptions = PatchOptions { side: 16, cell_m: 1.0, ahead_m: 0.0 };

fn online() -> Localiser {
    Localiser::new(LocaliserOptions { history_len: HISTORY_LEN, patch: PATCH, map: MapSource::Online })
}

fn header(tick: i64) -> Header {
    let mut header = Header::new(1, tick as u64, tick * TICK_NS);
    header.step_ns = (STEP_TICKS * TICK_NS) as u64;
    header.counts.history_len = HISTORY_LEN as u32;
    header
}

/// The state of agent `id` on its circle at a tick; `None` before tick 0, when it is first observed.
fn state(id: u64, tick: i64) -> Option<State> {
    let (radius_m, speed_mps) = (6.0 + id as f32, 5.0);
    let angle = speed_mps / radius_m * tick as f32 * 0.08 + id as f32;
    (tick >= 0).then(|| State {
        position_m: [radius_m * angle.cos(), radius_m * angle.sin()],
        velocity_mps: [-speed_mps * angle.sin(), speed_mps * angle.cos()],
        heading_rad: angle + std::f32::consts::FRAC_PI_2,
    })
}

fn track(id: u64, tick: i64) -> Track {
    let now = state(id, tick).unwrap();
    let mut track = Track { id, ..Track::zeroed() };
    ([track.x_m, track.y_m], [track.vx_mps, track.vy_mps]) = (now.position_m, now.velocity_mps);
    track.heading_rad = now.heading_rad;
    for (step, entry) in track.history.iter_mut().enumerate() {
        let back = (HISTORY_LEN - 1 - step) as i64 * STEP_TICKS;
        if let Some(state) = state(id, tick - back) {
            let ([x_m, y_m], [vx_mps, vy_mps]) = (state.position_m, state.velocity_mps);
            *entry = HistoryState { x_m, y_m, vx_mps, vy_mps, heading_rad: state.heading_rad, present: 1 };
        }
    }
    track
}

fn crowd(len: u64, tick: i64) -> Vec<Track> {
    (0..len).map(|id| track(id, tick)).collect()
}

/// The patches of a tick as \[agent, step, …\].
fn step(localiser: &mut Localiser, tick: i64, tracks: &[Track]) -> Vec<f32> {
    let shape = localiser.shape(tracks.len());
    let mut rows = vec![Row { values: [f32::NAN; 16] }; context_rows(&shape)];
    localiser.step(&header(tick), tracks, &mut ContextMut::over(&mut rows, shape).unwrap()).unwrap();
    let context = Context::read(&rows, shape).unwrap();
    assert_eq!(context.tracks, tracks);
    context.patches.to_vec()
}

fn patch(patches: &[f32], agent: usize, step: usize) -> &[f32] {
    patches.chunks_exact(PATCH.len()).nth(agent * HISTORY_LEN + step).unwrap()
}

#[test]
fn a_patch_stays_the_same_as_its_stamp_ages() {
    let mut localiser = online();
    let ticks: Vec<_> = (0..80).map(|tick| step(&mut localiser, tick, &crowd(5, tick))).collect();
    for tick in 0..80 {
        for agent in 0..5 {
            for back in 0..HISTORY_LEN {
                let then = tick as i64 - back as i64 * STEP_TICKS;
                let now = patch(&ticks[tick], agent, HISTORY_LEN - 1 - back);
                match usize::try_from(then) {
                    Ok(then) => assert_eq!(now, patch(&ticks[then], agent, HISTORY_LEN - 1)),
                    Err(_) => assert!(now.iter().all(|x| *x == 0.0), "absent: zeros"),
                }
            }
        }
    }
    assert!(ticks[0].iter().all(|x| *x == 0.0), "nothing was observed before the first tick");
    assert!(ticks[79].iter().any(|x| *x > 0.0));
}

#[test]
fn a_map_excludes_the_present_tick_and_coasting_tracks() {
    let run = |last: &dyn Fn() -> Vec<Track>, coasting: bool| {
        let mut localiser = online();
        for tick in 0..20 {
            let mut tracks = crowd(4, tick);
            if coasting {
                tracks.push(Track { status: TrackStatus::Coasting as u32, ..track(9, tick) });
            }
            step(&mut localiser, tick, &tracks);
        }
        let tracks = last();
        step(&mut localiser, 20, &tracks)[..HISTORY_LEN * PATCH.len()].to_vec()
    };
    let whole = run(&|| crowd(4, 20), false);
    assert_eq!(whole, run(&|| crowd(1, 20), false), "the others of the tick are not seen yet");
    assert_eq!(whole, run(&|| crowd(4, 20), true), "what coasts was not observed");
}

#[test]
fn a_fixed_map_gives_its_own_patches_and_no_map_zeros() {
    let mut builder = MapBuilder::new([-20.0, -20.0], 40, 40).unwrap();
    for tick in 0..200 {
        let state = state(2, tick).unwrap();
        builder.visit(state.position_m, state.velocity_mps);
    }
    let map = builder.build();
    let with = |map| Localiser::new(LocaliserOptions { history_len: HISTORY_LEN, patch: PATCH, map });
    let mut fixed = with(MapSource::Fixed(map.clone()));
    let mut expected = vec![0.0; PATCH.len()];
    for tick in 0..50 {
        let patches = step(&mut fixed, tick, &crowd(3, tick));
        for back in 0..HISTORY_LEN {
            let Some(state) = state(1, tick - back as i64 * STEP_TICKS) else { continue };
            map.patch(&state, PATCH, &mut expected);
            assert_eq!(patch(&patches, 1, HISTORY_LEN - 1 - back), expected);
        }
    }
    assert!(step(&mut with(MapSource::None), 30, &crowd(3, 30)).iter().all(|x| *x == 0.0));
}

#[test]
fn a_new_track_gets_patches_for_its_whole_history() {
    let mut localiser = online();
    (0..60).for_each(|tick| {
        step(&mut localiser, tick, &crowd(2, tick));
    });
    let mut tracks = crowd(2, 60);
    tracks.push(Track { id: 77, ..track(1, 60) });
    let patches = step(&mut localiser, 60, &tracks);
    for k in 0..HISTORY_LEN {
        assert!(patch(&patches, 2, k).iter().any(|x| *x > 0.0), "step {k} is cut from the map as it is now");
    }
}

#[test]
fn patches_of_stamps_before_a_track_is_confirmed_stay_the_same() {
    let mut localiser = online();
    (0..60).for_each(|tick| drop(step(&mut localiser, tick, &crowd(6, tick))));
    // Patches by stamp, as they were first cut.
    let mut first = std::collections::BTreeMap::new();
    for tick in 60..100_i64 {
        let tracks: Vec<Track> =
            crowd(6, tick).into_iter().chain([Track { id: 77, ..track(1, tick) }]).collect();
        let patches = step(&mut localiser, tick, &tracks);
        for back in 0..HISTORY_LEN {
            let now = patch(&patches, 6, HISTORY_LEN - 1 - back).to_vec();
            let known = first.entry(tick - back as i64 * STEP_TICKS).or_insert_with(|| now.clone());
            assert_eq!(*known, now, "tick {tick}, {back} steps back");
        }
    }
    let of_two: Vec<_> = [25, 30].map(|stamp| first[&stamp].clone()).into();
    assert_ne!(of_two[0], of_two[1], "the patches differ by stamp");
}

#[test]
fn new_tracks_evict_only_tracks_that_are_gone() {
    let mut localiser = online();
    let mut newest = Vec::new();
    for tick in 0..120_i64 {
        // Two tracks stay. A hundred others get new ids in each tick.
        let mut tracks = crowd(2, tick);
        tracks.extend((0..100).map(|i| Track { id: 1_000 + tick as u64 * 100 + i, ..track(i % 7, tick) }));
        tracks.rotate_left(tick as usize % 102);
        let stays = tracks.iter().position(|track| track.id == 1).unwrap();
        let patches = step(&mut localiser, tick, &tracks);
        newest.push(patch(&patches, stays, HISTORY_LEN - 1).to_vec());
        if let Some(then) = tick.checked_sub(STEP_TICKS).filter(|then| *then >= 0) {
            assert_eq!(patch(&patches, stays, HISTORY_LEN - 2), newest[then as usize]);
        }
    }
}

#[test]
fn impossible_frames_are_refused_and_change_nothing() {
    let mut localiser = online();
    let mut twin = online();
    for tick in 0..10 {
        step(&mut localiser, tick, &crowd(3, tick));
        step(&mut twin, tick, &crowd(3, tick));
    }
    let mut refused = |header: Header, tracks: &[Track]| {
        let shape = localiser.shape(tracks.len());
        let mut rows = vec![Row::zeroed(); context_rows(&shape)];
        localiser.step(&header, tracks, &mut ContextMut::over(&mut rows, shape).unwrap()).unwrap_err()
    };
    assert!(matches!(refused(header(9), &crowd(3, 9)), Rejected::NotNewer { .. }));
    let mut other = header(10);
    other.counts.history_len = 4;
    assert!(matches!(refused(other, &crowd(3, 10)), Rejected::Mismatch { found: 4, .. }));
    let mut broken = crowd(3, 10);
    broken[2].history[7].vx_mps = f32::NAN;
    assert!(matches!(refused(header(10), &broken), Rejected::NotFinite { .. }));
    let mut broken = crowd(3, 10);
    broken[0].x_m = 1e9;
    assert!(matches!(refused(header(10), &broken), Rejected::Impossible { .. }));
    assert!(matches!(refused(header(10), &crowd(129, 10)), Rejected::TooMany { .. }));
    assert_eq!(step(&mut localiser, 10, &crowd(3, 10)), step(&mut twin, 10, &crowd(3, 10)));
}
