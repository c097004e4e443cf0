//! Ten thousand ticks at random: late, repeated, broken, empty and crowded frames, targets that teleport, clocks that jump.

#[path = "support/torture.rs"]
mod support;

use config::Prior;
use support::torture;

// One test only: another in this process would take memory as well.
#[test]
fn ten_thousand_random_ticks_leave_the_tracker_sound() {
    for prior in [Prior::Kinematic, Prior::Learned] {
        let survived = torture(prior, 7, 5_000);
        println!("{prior:?}: {survived:?}");
        assert!(survived.late_len > 200, "{survived:?}");
        assert!(survived.published_len > 40_000 && survived.refused.len() >= 3, "{survived:?}");
        assert_eq!(survived.learned_len > 10_000, prior == Prior::Learned, "{survived:?}");
        // Hypotheses come and go with the tracks that hold them, 20 KiB each: a few hundred at once, but of all tracks that
        // ever were they would be hundreds of MiB. The last frames take their memory as larger ones come.
        if let [_, _, early, .., late] = survived.resident_kib[..] {
            assert!(late.saturating_sub(early) < 8 * 1_024, "{survived:?}");
        }
    }
}
