/// Schedules ticks at the recording's own rate. Each tick has an absolute time, so errors do not add up.
///
/// A delay of more than one interval shifts all later ticks. Otherwise they would go out in a burst and push
/// each other out of the queues.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    start_ns: u64,
    interval_ns: u64,
}

impl Pace {
    /// A schedule whose first tick goes out at `start_ns`.
    #[must_use]
    pub(crate) const fn new(start_ns: u64, interval_ns: u64) -> Self {
        Self { start_ns, interval_ns }
    }

    /// The time of the first tick, shifted by later delays.
    pub(crate) const fn start_ns(&self) -> u64 {
        self.start_ns
    }

    /// Returns the time at which a tick goes out that is due `due_ns` after the first. `now_ns` is the
    /// current time.
    #[must_use]
    pub(crate) const fn release_ns(&mut self, due_ns: u64, now_ns: u64) -> u64 {
        let planned_ns = self.start_ns + due_ns;
        let late_ns = now_ns.saturating_sub(planned_ns);
        if late_ns <= self.interval_ns {
            return planned_ns;
        }
        self.start_ns += late_ns;
        now_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_delays_do_not_add_up_and_a_stall_shifts_the_rest() {
        let mut pace = Pace::new(1_000, 80);
        assert_eq!(pace.release_ns(0, 900), 1_000);
        assert_eq!(pace.release_ns(80, 1_100), 1_080, "20 late: the plan stands");
        assert_eq!(pace.release_ns(160, 1_000), 1_160);
        assert_eq!(pace.release_ns(240, 2_000), 2_000, "760 late: goes out at once");
        assert_eq!(pace.release_ns(320, 2_005), 2_080, "and the next an interval later, not in a burst");
    }
}
