//! The time from a sensor's stamp until DDS has taken the forecasts, over all messages.

use hdrhistogram::Histogram;

/// Greatest time that counts. A greater one means that the stamps have another clock.
const LONGEST_NS: i64 = 10_000_000_000;

/// Histogram of the times, in microseconds.
#[derive(Debug)]
pub struct SinceStamp(Histogram<u32>);

impl Default for SinceStamp {
    fn default() -> Self {
        let longest_us = LONGEST_NS as u64 / 1_000;
        Self(
            Histogram::new_with_bounds(1, longest_us, 3)
                .expect("the bounds are constants that hdrhistogram takes"),
        )
    }
}

/// Percentiles of the times, in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Times {
    /// Median.
    pub p50_us: u64,
    /// 99th percentile.
    pub p99_us: u64,
    /// Maximum.
    pub max_us: u64,
}

impl Times {
    /// Median, 99th percentile and maximum.
    #[must_use]
    pub const fn us(self) -> [u64; 3] {
        [self.p50_us, self.p99_us, self.max_us]
    }
}

impl SinceStamp {
    /// Records a message with this stamp that DDS has taken now, by the clock of the stamps.
    pub fn record(&mut self, stamp_ns: i64, now_ns: i64) {
        let since_ns = now_ns.saturating_sub(stamp_ns);
        if (0..=LONGEST_NS).contains(&since_ns) {
            self.0.saturating_record(since_ns as u64 / 1_000);
        }
    }

    /// The percentiles; `None` if no time was recorded.
    #[must_use]
    pub fn times(&self) -> Option<Times> {
        let Self(times) = self;
        let at = |quantile| times.value_at_quantile(quantile);
        (!times.is_empty()).then(|| Times { p50_us: at(0.5), p99_us: at(0.99), max_us: times.max() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_stamps_of_the_same_clock_count() {
        let mut since = SinceStamp::default();
        let stamp_ns = 1_700_000_000_000_000_000;
        // Another clock: ahead, or long ago.
        since.record(stamp_ns, stamp_ns - 1);
        since.record(0, stamp_ns);
        since.record(i64::MIN, i64::MAX);
        assert_eq!(since.times(), None);
        (1..=100).for_each(|time_ms| since.record(stamp_ns, stamp_ns + time_ms * 1_000_000));
        let times = since.times().unwrap();
        assert!(times.p50_us.abs_diff(50_000) < 100 && times.p99_us.abs_diff(99_000) < 100, "{times:?}");
        assert!(times.max_us.abs_diff(100_000) < 100, "{times:?}");
    }
}
