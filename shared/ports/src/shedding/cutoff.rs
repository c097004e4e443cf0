use wire::Header;

/// Number of ticks whose sampling time counts. The longest one is ignored.
const TICKS: usize = 16;
/// Time from the sampler's end until the forecasts reach their readers: publishing and a wake-up, on a busy
/// machine.
const ON_THE_WAY_NS: u64 = 2_000_000;

/// Computes the time until which a stage may begin to serve agents. The cutoff follows from the budgets. It
/// is earlier if the sampler needs more than the rest of the tick.
#[derive(Clone, Debug)]
pub struct Cutoff {
    budgets_ns: u64,
    left_ns: u64,
    /// The sampler's times in the newest ticks.
    sampling_ns: [u32; TICKS],
    next: usize,
}

impl Cutoff {
    /// The cutoff of a stage that must end `budgets_ns` after a tick's release. `left_ns` is the part of the
    /// tick after the decoder's budget.
    #[must_use]
    pub const fn new(budgets_ns: u64, left_ns: u64) -> Self {
        Self { budgets_ns, left_ns, sampling_ns: [0; TICKS], next: 0 }
    }

    /// Returns the cutoff of a tick, on the clock of its release. Also adds the sampler's time from the
    /// tick's header.
    pub fn until_ns(&mut self, header: &Header) -> u64 {
        self.sampling_ns[self.next] = header.sampling_ns;
        self.next = (self.next + 1) % TICKS;
        let mut sorted = self.sampling_ns;
        sorted.sort_unstable();
        let wanted_ns = u64::from(sorted[TICKS - 2]) + ON_THE_WAY_NS;
        let earlier_ns = wanted_ns.saturating_sub(self.left_ns);
        header.released_ns.saturating_add(self.budgets_ns.saturating_sub(earlier_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn tick(sampling_ms: u64) -> Header {
        Header { released_ns: 1_000 * MS, sampling_ns: (sampling_ms * MS) as u32, ..Header::default() }
    }

    #[test]
    fn budgets_hold_while_the_sampler_keeps_to_what_is_left() {
        let mut cutoff = Cutoff::new(66 * MS, 14 * MS);
        assert!((0..=12).all(|sampling_ms| cutoff.until_ns(&tick(sampling_ms)) == 1_066 * MS));
    }

    #[test]
    fn a_sampler_that_takes_longer_is_given_the_time_and_one_long_tick_changes_nothing() {
        let mut cutoff = Cutoff::new(66 * MS, 14 * MS);
        assert_eq!(cutoff.until_ns(&tick(40)), 1_066 * MS);
        let until: Vec<u64> = (0..20).map(|_| cutoff.until_ns(&tick(17)) / MS).collect();
        assert!(until.iter().all(|until_ms| *until_ms == 1_061), "{until:?}");
        let after: Vec<u64> = (0..20).map(|_| cutoff.until_ns(&tick(3)) / MS).collect();
        assert_eq!((after[0], after[19]), (1_061, 1_066), "{after:?}");
        assert!(after.is_sorted());
    }

    #[test]
    fn no_time_at_all_is_no_time_before_the_release() {
        let mut cutoff = Cutoff::new(MS, 0);
        let until: Vec<u64> = (0..3).map(|_| cutoff.until_ns(&tick(4_000))).collect();
        assert_eq!(until[2], 1_000 * MS);
    }
}
