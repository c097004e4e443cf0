use std::thread;
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;

/// If two ticks are further apart than this, the replay does not wait: the run was at rest, or its clock was
/// set.
const GAP_MAX: Duration = Duration::from_secs(10);
/// Longest computation that is resolved; longer ones count as this long.
const LONGEST_US: u64 = 60_000_000;

/// How long a replay in the rhythm of its stamps took.
#[derive(Debug)]
pub struct OwnTime {
    /// Ticks that began late, because the previous tick took longer to compute than the recording's interval.
    pub late_ticks: u64,
    computed_us: Histogram<u32>,
}

impl OwnTime {
    /// The time within which a share of the ticks was computed, in ms.
    pub fn computed_ms(&self, share: f64) -> f64 {
        self.computed_us.value_at_quantile(share) as f64 / 1e3
    }
}

/// Releases ticks in the rhythm of their stamps.
#[derive(Debug)]
pub(super) struct Pace {
    /// When the last tick was due, and its stamp.
    due: Option<(Instant, i64)>,
    took: OwnTime,
}

impl Pace {
    pub(super) fn new() -> Self {
        let computed_us = Histogram::new_with_bounds(1, LONGEST_US, 3)
            .expect("the bounds are constants that hdrhistogram takes");
        Self { due: None, took: OwnTime { late_ticks: 0, computed_us } }
    }

    /// Waits until the tick of a stamp is due.
    pub(super) fn wait(&mut self, stamp_ns: i64) {
        let now = Instant::now();
        let due = self.due.map_or(now, |(due, before_ns)| due_at(now, due, stamp_ns - before_ns));
        self.took.late_ticks += u64::from(due < now);
        thread::sleep(due.saturating_duration_since(now));
        self.due = Some((due, stamp_ns));
    }

    pub(super) fn computed(&mut self, since: Instant) {
        let took_us = u64::try_from(since.elapsed().as_micros()).unwrap_or(LONGEST_US);
        self.took.computed_us.saturating_record(took_us.max(1));
    }

    pub(super) fn finish(self) -> OwnTime {
        self.took
    }
}

/// Returns the time at which a tick is due, `step_ns` after the tick that was due at `due`. The tick is due
/// at once after a gap or if stamps go backwards.
fn due_at(now: Instant, due: Instant, step_ns: i64) -> Instant {
    let step = u64::try_from(step_ns).map(Duration::from_nanos);
    step.ok().filter(|step| *step <= GAP_MAX).map_or(now, |step| due + step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_due_in_the_rhythm_of_their_stamps() {
        let due = Instant::now();
        let now = due + Duration::from_millis(20);
        assert_eq!(due_at(now, due, 80_000_000), due + Duration::from_millis(80));
        assert_eq!(
            due_at(now, due, 10_000_000),
            due + Duration::from_millis(10),
            "late, and the next is not later"
        );
    }

    #[test]
    fn gaps_and_clocks_that_go_back_are_not_waited_for() {
        let due = Instant::now();
        let now = due + Duration::from_millis(20);
        assert_eq!(due_at(now, due, 3_600_000_000_000), now);
        assert_eq!(due_at(now, due, -80_000_000), now);
    }

    #[test]
    fn ticks_that_are_computed_too_long_make_the_next_late() {
        let mut pace = Pace::new();
        pace.wait(0);
        let began = Instant::now();
        thread::sleep(Duration::from_millis(3));
        pace.computed(began);
        pace.wait(1_000_000);
        pace.wait(1_000_000 + GAP_MAX.as_nanos() as i64 + 1);
        let took = pace.finish();
        assert_eq!(took.late_ticks, 1);
        assert!(took.computed_ms(0.5) >= 3.0, "{took:?}");
    }
}
