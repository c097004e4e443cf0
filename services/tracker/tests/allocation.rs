//! The memory of the tracker: steady steps do not allocate, and random ticks keep it bounded.

mod support {
    pub mod forecaster;
    pub mod torture;
}

use bytemuck::Zeroable;
use testing::{CountingAllocator, allocations};
use tracker::{Association, Prior, Tracker, TrackerOptions};
use wire::{AGENTS_MAX, AgentType, Detection, Forecast, Header, Steering, Track, detection_flags, flags};

use crate::support::forecaster::{HORIZON_LEN, forecast, forecasts_header};
use crate::support::torture::torture;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// A hundred agents of all types, 4 m apart, each on a separate small circle. Three sensors take turns.
fn detections(k: u32, missed: Option<u32>, out: &mut Vec<Detection>) {
    out.clear();
    for i in (0..100_u32).filter(|&i| missed != Some(i)) {
        let turn = f64::from(k) * 0.02 + f64::from(i);
        out.push(Detection {
            id: u64::from(i),
            x_m: (f64::from(i % 10) * 4.0 + turn.cos()) as f32,
            y_m: (f64::from(i / 10) * 4.0 + turn.sin()) as f32,
            heading_rad: ((turn + std::f64::consts::FRAC_PI_2).rem_euclid(std::f64::consts::TAU)) as f32,
            agent_type: i % 3,
            flags: detection_flags::HAS_ID | detection_flags::HAS_HEADING,
            sensor: ((i + k) % 3) as u8,
            ..Detection::zeroed()
        });
    }
}

// A single test: memory that another test in this process allocates would be counted, too.
#[test]
fn steady_steps_allocate_nothing_and_random_ticks_keep_memory() {
    steady_steps_allocate_nothing();
    random_ticks_keep_memory();
}

fn steady_steps_allocate_nothing() {
    for (identities, name) in
        [(flags::HAS_IDENTITIES, "by identity"), (0, "by position"), (flags::SEEN_FROM_EGO, "one missed")]
    {
        for prior in [Prior::Kinematic, Prior::Learned] {
            for association in [Association::Assignment, Association::Jpda] {
                assert_steady_steps_allocate_nothing(identities, prior, association, name);
            }
        }
    }
}

fn assert_steady_steps_allocate_nothing(identities: u32, prior: Prior, association: Association, name: &str) {
    let mut tracker = Tracker::new(TrackerOptions { prior, association, ..TrackerOptions::default() });
    let mut out = vec![Track::zeroed(); AGENTS_MAX];
    let mut frame = Vec::with_capacity(100);
    let mut made: Vec<Forecast> = Vec::with_capacity(AGENTS_MAX);
    let mut made_ns = 0;
    let mut late_count = 0;
    let mut step = |number: u32| {
        // One in ten frames arrives early.
        let k = match number % 10 {
            2 => number + 5,
            3..8 => number - 1,
            _ => number,
        };
        detections(k, (identities == flags::SEEN_FROM_EGO && k > 8).then_some(k % 100), &mut frame);
        let stamp_ns = i64::from(k) * 80_000_000;
        let observed_types =
            AgentType::Vehicle.bit() | AgentType::Cyclist.bit() | AgentType::Pedestrian.bit();
        let header = Header { flags: identities, observed_types, ..Header::new(1, u64::from(k), stamp_ns) };
        let of = forecasts_header(made_ns, made.len());
        let tracked = tracker.step(&header, &frame, Some((&of, &made)), &mut out).expect("a good frame");
        assert_eq!(tracked.refused_count, 0);
        if tracked.replayed_count > 0 {
            late_count += 1;
            return;
        }
        assert!(k < 8 || tracked.track_count == 100, "{name}, frame {k}: {tracked:?}");
        made_ns = stamp_ns;
        made.clear();
        made.extend(out[..tracked.track_count].iter().map(|track| {
            let steering = if track.agent_type == 0 { Steering::Bicycle } else { Steering::Displacement };
            forecast(track, steering, &[(0.5, [[0.1, 0.0]; HORIZON_LEN]), (0.5, [[0.0; 2]; HORIZON_LEN])])
        }));
    };
    (0..100).for_each(&mut step);
    assert_eq!(allocations(|| (100..1_100).for_each(&mut step)), 0, "{name}, {prior:?}");
    assert_eq!(late_count, 5 * 110, "{name}, {prior:?}");
    let learned = out.iter().filter(|track| track.prior_age_ns > 0).count();
    assert_eq!(learned > 50, prior == Prior::Learned, "{name}, {prior:?}: {learned} tracks by forecasts");
}

/// Random ticks: out-of-sequence, repeated, invalid, empty and crowded frames, targets that teleport, and
/// clocks that jump.
fn random_ticks_keep_memory() {
    for (prior, association) in [
        (Prior::Kinematic, Association::Assignment),
        (Prior::Kinematic, Association::Jpda),
        (Prior::Learned, Association::Assignment),
        (Prior::Learned, Association::Jpda),
    ] {
        let survived = torture(prior, association, 7, 10_000);
        println!("{prior:?}, {association:?}: {survived:?}");
        assert!(survived.out_of_sequence_count > 100, "{survived:?}");
        assert!(survived.published_count > 20_000 && survived.refused.len() >= 3, "{survived:?}");
        assert_eq!(survived.learned_count > 5_000, prior == Prior::Learned, "{survived:?}");
        // Hypotheses of 20 KiB live as long as their track, so a few hundred exist at once. The hypotheses of
        // all tracks ever would be hundreds of MiB. The last frames use memory as larger ones arrive.
        if let [_, _, early, .., late] = survived.resident_kib[..] {
            assert!(late.saturating_sub(early) < 24 * 1_024, "{survived:?}");
        }
    }
}
