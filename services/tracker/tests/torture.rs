//! Ten thousand ticks at random: late, repeated, broken, empty and crowded frames, targets that teleport, clocks that jump.

#[path = "support/torture.rs"]
mod support;

use support::torture;
use tracker::{Association, Prior};

// One test only: another in this process would take memory as well.
#[test]
fn ten_thousand_random_ticks_leave_the_tracker_sound() {
    for (prior, association, ticks_len) in [
        (Prior::Kinematic, Association::Assignment, 2_500),
        (Prior::Kinematic, Association::Jpda, 2_500),
        (Prior::Learned, Association::Assignment, 2_500),
        (Prior::Learned, Association::Jpda, 2_500),
    ] {
        let survived = torture(prior, association, 7, ticks_len);
        println!("{prior:?}, {association:?}: {survived:?}");
        assert!(survived.late_len > 100, "{survived:?}");
        assert!(survived.published_len > 20_000 && survived.refused.len() >= 3, "{survived:?}");
        assert_eq!(survived.learned_len > 5_000, prior == Prior::Learned, "{survived:?}");
        // Hypotheses come and go with the tracks that hold them, 20 KiB each: a few hundred at once, but of all tracks that
        // ever were they would be hundreds of MiB. The last frames take their memory as larger ones come.
        if let [_, _, early, .., late] = survived.resident_kib[..] {
            assert!(late.saturating_sub(early) < 16 * 1_024, "{survived:?}");
        }
    }
}
