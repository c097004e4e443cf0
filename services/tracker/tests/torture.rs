//! Ten thousand ticks at random: late, repeated, broken, empty and crowded frames, targets that teleport, clocks that jump.

#[path = "support/torture.rs"]
mod frames;

use bytemuck::Zeroable;
use config::Prior;
use frames::{Torture, fault};
use std::collections::BTreeMap;
use tracker::{Tracker, TrackerOptions};
use wire::{AGENTS_MAX, Quality, Track};

/// Memory of this process in KiB, where the system tells.
fn resident_kib() -> Option<usize> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    line.split_ascii_whitespace().nth(1)?.parse().ok()
}

// One test only: another in this process would take memory as well.
#[test]
fn ten_thousand_random_ticks_leave_the_tracker_sound() {
    let mut resident = Vec::new();
    for (prior, ticks_len) in [(Prior::Kinematic, 5_000), (Prior::Learned, 5_000)] {
        let mut frames = Torture::new(7);
        let mut tracker = Tracker::new(TrackerOptions { prior, ..TrackerOptions::default() });
        let mut out = vec![Track::zeroed(); AGENTS_MAX];
        let (mut tracks_len, mut last_id, mut published_len) = (0, 0, 0);
        let mut refused: BTreeMap<String, usize> = BTreeMap::new();
        let (mut faults_len, mut learned_len) = (0, 0);
        for tick in 0..ticks_len {
            if tick % 1_000 == 0 {
                resident.extend(resident_kib());
            }
            let forecast = frames.forecast(&out[..tracks_len]);
            let header = frames.frame();
            let given = Some((&forecast, &frames.forecasts[..]));
            let tracked = match tracker.step(&header, &frames.detections, given, &mut out) {
                Ok(tracked) => tracked,
                Err(rejected) => {
                    let reason = format!("{rejected:?}");
                    *refused
                        .entry(reason.split([' ', '{']).next().unwrap_or_default().into())
                        .or_default() += 1;
                    continue;
                }
            };
            tracks_len = tracked.tracks_len;
            faults_len += tracked.faults_len;
            published_len += tracks_len;
            assert!(tracked.held_len <= TrackerOptions::default().tracks_max);
            for track in &out[..tracks_len] {
                learned_len += usize::from(track.prior == Quality::Learned as u32);
                assert_eq!(track.check(), Ok(()), "{prior:?}, tick {tick}: {track:?}");
                assert_eq!(fault(track), None, "{prior:?}, tick {tick}: {track:?}");
            }
            last_id = out[..tracks_len].iter().map(|track| track.id).max().unwrap_or(last_id);
        }
        println!(
            "{prior:?}: {published_len} states, {learned_len} of them learned, ids to {last_id}, {faults_len} faults, refused {refused:?}"
        );
        assert_eq!(learned_len > 10_000, prior == Prior::Learned, "{learned_len}");
        assert!(published_len > 40_000 && refused.len() >= 3, "{published_len} {refused:?}");
    }
    println!("resident: {resident:?} KiB");
    for of_tracker in resident.chunks_exact(5) {
        assert!(of_tracker[4].saturating_sub(of_tracker[2]) < 512, "{resident:?}");
    }
}
