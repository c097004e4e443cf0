use hdrhistogram::Histogram;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::report::Percentiles;

/// Longest time that is resolved. Longer times count as this one.
const LONGEST_NS: u64 = 60_000_000_000;
/// Smallest number of values for a 99.9th percentile, so that at least ten values are above it.
const P999_LEAST_LEN: u64 = 10_000;

/// Histogram of times, to three significant digits and in bounded memory.
#[derive(Clone, Debug)]
pub(crate) struct Distribution {
    histogram: Histogram<u32>,
    least_ns: u64,
    most_ns: u64,
    sum_ns: u64,
}

impl Default for Distribution {
    fn default() -> Self {
        let histogram = Histogram::new_with_bounds(1, LONGEST_NS, 3)
            .expect("the bounds are constants that hdrhistogram takes");
        Self { histogram, least_ns: u64::MAX, most_ns: 0, sum_ns: 0 }
    }
}

/// A distribution as stored in a file: values with their counts.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Kept {
    values: Vec<(u64, u32)>,
    least_ns: u64,
    most_ns: u64,
    #[serde(default)]
    sum_ns: u64,
}

impl From<&Distribution> for Kept {
    fn from(distribution: &Distribution) -> Self {
        let recorded = distribution.histogram.iter_recorded();
        let values = recorded.map(|step| (step.value_iterated_to(), step.count_at_value())).collect();
        let Distribution { least_ns, most_ns, sum_ns, .. } = *distribution;
        Self { values, least_ns, most_ns, sum_ns }
    }
}

impl From<Kept> for Distribution {
    fn from(kept: Kept) -> Self {
        let mut distribution = Self::default();
        for (value, count) in kept.values {
            // Only values beyond the bounds are refused, and no such value was recorded.
            let _ = distribution.histogram.record_n(value.min(LONGEST_NS), count);
        }
        let Kept { least_ns, most_ns, sum_ns, .. } = kept;
        Self { least_ns, most_ns, sum_ns, ..distribution }
    }
}

impl Serialize for Distribution {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Kept::from(self).serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Distribution {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Kept::deserialize(deserializer).map(Self::from)
    }
}

impl Distribution {
    pub fn record(&mut self, time_ns: u64) {
        self.histogram.saturating_record(time_ns);
        self.least_ns = self.least_ns.min(time_ns);
        self.most_ns = self.most_ns.max(time_ns);
        self.sum_ns = self.sum_ns.saturating_add(time_ns);
    }

    /// Median; 0 if nothing was recorded.
    pub fn median_ns(&self) -> u64 {
        self.histogram.value_at_quantile(0.5).min(self.most_ns)
    }

    /// Sum of all times.
    pub const fn sum_ns(&self) -> u64 {
        self.sum_ns
    }

    /// For each of the increasing `bounds_ns`, the number of times up to it, to the histogram's three digits.
    pub fn counts_up_to<const N: usize>(&self, bounds_ns: &[u64; N]) -> [u64; N] {
        let mut counts = [0; N];
        for step in self.histogram.iter_recorded() {
            let place = bounds_ns.partition_point(|&bound_ns| bound_ns < step.value_iterated_to());
            if let Some(count) = counts.get_mut(place) {
                *count += u64::from(step.count_at_value());
            }
        }
        for place in 1..N {
            counts[place] += counts[place - 1];
        }
        counts
    }

    /// Number of recorded times.
    pub fn len(&self) -> u64 {
        self.histogram.len()
    }

    pub fn is_empty(&self) -> bool {
        self.histogram.is_empty()
    }

    /// The percentiles in ms; all `None` if nothing was recorded.
    pub fn percentiles_ms(&self) -> Percentiles {
        if self.is_empty() {
            return Percentiles::default();
        }
        // The histogram returns the upper end of a bucket, which may be above the largest recorded value.
        let quantile_ms = |q| ms(self.histogram.value_at_quantile(q).clamp(self.least_ns, self.most_ns));
        Percentiles {
            p50: Some(quantile_ms(0.5)),
            p99: Some(quantile_ms(0.99)),
            p999: (self.histogram.len() >= P999_LEAST_LEN).then(|| quantile_ms(0.999)),
            max: Some(ms(self.most_ns)),
        }
    }
}

/// Converts to milliseconds, rounded to 0.1 µs. Clocks of different processes do not agree better.
pub(crate) fn ms(time_ns: u64) -> f64 {
    (time_ns as f64 / 100.0).round() / 10_000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(times_ns: impl IntoIterator<Item = u64>) -> Percentiles {
        let mut distribution = Distribution::default();
        times_ns.into_iter().for_each(|t| distribution.record(t));
        distribution.percentiles_ms()
    }

    #[test]
    fn without_values_all_percentiles_are_none() {
        assert_eq!(of([]), Percentiles::default());
    }

    #[test]
    fn percentiles_of_a_constant_are_exact() {
        let p = of([1_000_000; 7]);
        assert_eq!(p, Percentiles { p50: Some(1.0), p99: Some(1.0), p999: None, max: Some(1.0) });
    }

    #[test]
    fn percentiles_are_right_to_three_digits() {
        let p = of((1..=10_000).map(|i| i * 1_000));
        for (found, expected_ms) in [(p.p50, 5.0), (p.p99, 9.9), (p.p999, 9.99), (p.max, 10.0)] {
            let found_ms = found.expect("10,000 values give all percentiles");
            assert!((found_ms / expected_ms - 1.0).abs() < 1e-3, "{found_ms} ms, expected {expected_ms} ms");
        }
    }

    #[test]
    fn counts_up_to_bounds_add_up() {
        let mut distribution = Distribution::default();
        [1_000, 2_000_000, 2_000_000, 90_000_000].into_iter().for_each(|t| distribution.record(t));
        assert_eq!(distribution.counts_up_to(&[1_000_000, 10_000_000, 80_000_000]), [1, 3, 3]);
        assert_eq!(distribution.sum_ns(), 94_001_000);
        let kept = Distribution::from(Kept::from(&distribution));
        assert_eq!((kept.sum_ns(), kept.len(), kept.median_ns()), (94_001_000, 4, distribution.median_ns()));
    }

    #[test]
    fn one_value_short_of_ten_thousand_has_no_p999() {
        assert_eq!(of((1..10_000).map(|i| i * 1_000)).p999, None);
    }
}
