/// Minimum number of agents that a tick serves, however late it is. If a tick served none, their cost could
/// not be measured.
pub const SERVED_MIN: usize = 8;
/// Number of ticks in a median. Up to four disturbed ticks do not affect it.
const TICKS: usize = 9;

/// The number of agents that a stage, or a chain of stages, can serve in a given time. Learned from earlier
/// ticks.
#[derive(Clone, Debug, Default)]
pub struct Capacity {
    /// Cost of a tick that does not depend on the number of agents.
    fixed: Median,
    /// Cost of each agent.
    each: Median,
}

impl Capacity {
    /// Adds the part of a tick's time that does not depend on the number of agents.
    pub fn took_fixed(&mut self, time_ns: u64) {
        self.fixed.push(time_ns);
    }

    /// Adds the total time of `agents_len` agents. Does nothing if there were none.
    pub fn took(&mut self, time_ns: u64, agents_len: usize) {
        if agents_len > 0 && time_ns > 0 {
            self.each.push(time_ns / agents_len as u64);
        }
    }

    /// Returns the number of agents that can be served in `left_ns`, at least [`SERVED_MIN`]. There is no
    /// limit before a cost is known.
    #[must_use]
    pub fn fit(&self, left_ns: u64) -> usize {
        let Some(each_ns) = self.each.value() else { return usize::MAX };
        let left_ns = left_ns.saturating_sub(self.fixed.value().unwrap_or(0));
        ((left_ns / each_ns.max(1)) as usize).max(SERVED_MIN)
    }
}

/// The median of the newest [`TICKS`] values.
#[derive(Clone, Debug, Default)]
struct Median {
    newest: [u64; TICKS],
    len: usize,
    next: usize,
}

impl Median {
    fn push(&mut self, value: u64) {
        self.newest[self.next] = value;
        self.next = (self.next + 1) % TICKS;
        self.len = (self.len + 1).min(TICKS);
    }

    fn value(&self) -> Option<u64> {
        let mut sorted = self.newest;
        let sorted = &mut sorted[..self.len];
        sorted.sort_unstable();
        sorted.get(self.len.checked_sub(1)? / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn nothing_is_shed_before_a_cost_is_known() {
        let mut capacity = Capacity::default();
        assert_eq!(capacity.fit(0), usize::MAX);
        capacity.took_fixed(5 * MS);
        capacity.took(MS, 0);
        assert_eq!(capacity.fit(0), usize::MAX, "nobody was served: no cost of one is known");
    }

    #[test]
    fn some_are_served_however_late_it_is() {
        let mut capacity = Capacity::default();
        capacity.took(80 * MS, 1);
        assert_eq!(capacity.fit(0), SERVED_MIN);
    }

    #[test]
    fn a_few_slow_ticks_change_nothing() {
        let mut capacity = Capacity::default();
        for tick in 0..100 {
            let slow = if tick % 9 < 4 { 50 } else { 1 };
            capacity.took_fixed(4 * MS * slow);
            capacity.took(10 * MS * slow, 20);
        }
        assert_eq!(capacity.fit(44 * MS), 80);
    }

    proptest! {
        /// The number of served agents settles for any fixed and proportional cost, and from any initial
        /// number.
        #[test]
        fn the_number_served_settles_at_what_fits(
            anyway_ns in 0..20 * MS,
            each_ns in MS / 20..2 * MS,
            agents_len in 9_usize..=128,
            left_ns in 30 * MS..60 * MS,
        ) {
            let mut capacity = Capacity::default();
            let mut served_count = agents_len;
            for _ in 0..200 {
                capacity.took(anyway_ns + each_ns * served_count as u64, served_count);
                served_count = capacity.fit(left_ns).min(agents_len);
            }
            let took_ns = anyway_ns + each_ns * served_count as u64;
            let slack_ns = 2 * each_ns + anyway_ns / served_count as u64;
            prop_assert!(took_ns <= left_ns + slack_ns || served_count == SERVED_MIN);
            let one_more_fits = took_ns + slack_ns < left_ns;
            prop_assert!(served_count == agents_len || !one_more_fits, "{served_count} served in {took_ns} ns");
        }
    }
}
